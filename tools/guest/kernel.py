"""Fetch the user-mode Linux kernel of Debian unstable into a cache folder, without changes to the system.

The kernel is an ordinary program that needs a newer C library than Debian stable has. Therefore both packages are
fetched with apt and separate package lists, and the program is modified to load this library from its own folder.
"""

from __future__ import annotations

import fcntl
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

OLDEST = "7.2um1"  # earlier versions crash at startup on processors with a large register state
LOADER = b"/lib64/ld-linux-x86-64.so.2\0"
FETCH_SECONDS = 300
KEYRING = Path("/usr/share/keyrings/debian-archive-keyring.gpg")


class UnavailableError(Exception):
    """No guest can run on this machine. The message has the reason."""


@dataclass(frozen=True)
class Kernel:
    """A kernel that runs in the working directory `folder` with `LD_LIBRARY_PATH=lib`. The folder may be moved."""

    folder: Path

    @property
    def program(self) -> Path:
        return self.folder / "linux.uml"

    @property
    def modules(self) -> Path:
        return self.folder / "modules"


def cache_folder() -> Path:
    return Path(os.environ.get("TSA_CACHE") or Path(__file__).resolve().parents[2] / ".cache") / "vcan"


def cached() -> Kernel | None:
    kernel = Kernel(cache_folder() / "kernel")
    return kernel if kernel.program.exists() else None


def kernel() -> Kernel:
    """Return the kernel from the cache, or fetch it (about 40 MB).

    Raises:
        UnavailableError: The kernel cannot be fetched, or the processor is not x86_64.
    """
    if found := cached():
        return found
    if platform.machine() != "x86_64":
        raise UnavailableError(f"user-mode Linux runs on x86_64 only, this is {platform.machine()}")
    cache = cache_folder()
    try:
        cache.mkdir(parents=True, exist_ok=True)
        with _alone(cache / "lock"):
            if found := cached():
                return found
            print("tools/vcan: fetching a user-mode Linux kernel (once)", file=sys.stderr, flush=True)
            with tempfile.TemporaryDirectory(dir=cache) as work:
                _build(Path(work)).rename(cache / "kernel")
    except OSError as error:
        raise UnavailableError(f"no kernel in {cache}: {error} (TSA_CACHE names another folder)") from None
    return Kernel(cache / "kernel")


@contextmanager
def _alone(lock: Path) -> Iterator[None]:
    with lock.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _build(work: Path) -> Path:
    _download(work)
    for package in work.glob("*.deb"):
        _run("dpkg", "-x", str(package), str(work / "root"))
    usr, folder = work / "root/usr", work / "kernel"
    library, (release,) = usr / "lib/x86_64-linux-gnu", (usr / "lib/uml/modules").iterdir()
    (folder / "lib").mkdir(parents=True)
    for name in ("ld-linux-x86-64.so.2", "libc.so.6"):
        shutil.copy(library / name, folder / "lib")
    for module in ("net/can", "drivers/net/can"):
        shutil.copytree(release / "kernel" / module, folder / "modules" / module)
    _relink(usr / "bin/linux.uml", folder / "linux.uml")
    return folder


def _relink(source: Path, target: Path) -> None:
    """Copy a program, and change its loader to the loader in `lib` of its working directory."""
    program = source.read_bytes()
    if program.count(LOADER) != 1:
        raise UnavailableError(f"{source.name} names its loader in a way not known here")
    target.write_bytes(program.replace(LOADER, b"lib/ld-linux-x86-64.so.2".ljust(len(LOADER), b"\0")))
    target.chmod(0o755)


def _download(work: Path) -> None:
    """Download the packages to `work`. apt uses this machine's settings (proxy, certificates) but not its folders."""
    if not shutil.which("apt-get") or not shutil.which("dpkg"):
        raise UnavailableError("the user-mode Linux kernel comes from Debian, and this machine has no apt-get")
    for folder in ("etc", "lists/partial", "cache/archives/partial"):
        (work / folder).mkdir(parents=True)
    settings = _run("apt-config", "dump").splitlines()
    own = {
        "Dir::Etc::main": "/dev/null",
        "Dir::Etc::parts": "/dev/null",
        "Dir::Etc::sourcelist": str(work / "etc/sources.list"),
        "Dir::Etc::sourceparts": "/dev/null",
        "Dir::Etc::preferences": "/dev/null",
        "Dir::Etc::preferencesparts": "/dev/null",
        "Dir::State::lists": str(work / "lists"),
        "Dir::Cache": str(work / "cache"),
        "Debug::NoLocking": "1",
        "APT::Architecture": "amd64",
        "APT::Update::Error-Mode": "any",
        "APT::Sandbox::User": "",
        "Acquire::Languages": "none",
        # The signature is sufficient, even if the mirror is outdated or this machine's clock is wrong.
        "Acquire::Check-Valid-Until": "false",
        "Acquire::Check-Date": "false",
    }
    kept = [line for line in settings if not re.match(r"Dir\b|DPkg\b|APT::Update\b", line)]
    config = work / "etc/apt.conf"
    config.write_text("\n".join(kept + [f'{key} "{value}";' for key, value in own.items()]) + "\n")
    signed = f"[signed-by={KEYRING}] " if KEYRING.exists() else ""
    reason = "no Debian mirror is among the apt sources of this machine"
    for mirror in _mirrors():
        (work / "etc/sources.list").write_text(f"deb {signed}{mirror} unstable main\n")
        try:
            _apt(config, work, "update")
            _apt(config, work, "download", "user-mode-linux", "libc6")
            version = _run("dpkg-deb", "-f", *map(str, work.glob("user-mode-linux_*.deb")), "Version").strip()
            if subprocess.run(["dpkg", "--compare-versions", version, "ge", OLDEST]).returncode == 0:
                return
            reason = f"Debian unstable has user-mode-linux {version}, {OLDEST} or later is needed"
        except UnavailableError as error:
            reason = str(error)
        for package in work.glob("*.deb"):
            package.unlink()
    raise UnavailableError(reason)


def _apt(config: Path, work: Path, *command: str) -> None:
    _run("apt-get", "-q", *command, environment={"APT_CONFIG": str(config)}, folder=work)


def _mirrors() -> list[str]:
    """Return the mirrors in the machine's apt sources that have its Debian release, the most likely first."""
    release = platform.freedesktop_os_release()
    listing = _run("apt-get", "update", "--print-uris", "-o", "Debug::NoLocking=1")
    found = re.findall(r"^'(\S+?)/dists/(\S+?)/InRelease'", listing, re.MULTILINE)
    suites = {release.get("VERSION_CODENAME", "sid"), "stable", "testing", "unstable", "sid"}
    mirrors = [address for address, suite in found if suite in suites]
    with_updates = {address for address, suite in found if suite.endswith("-updates")}
    return sorted(dict.fromkeys(mirrors), key=lambda address: address not in with_updates)


def _run(*command: str, environment: dict[str, str] | None = None, folder: Path | None = None) -> str:
    what = " ".join(command[:3])
    try:
        done = subprocess.run(
            command,
            env={**os.environ, "LC_ALL": "C", **(environment or {})},
            cwd=folder,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=FETCH_SECONDS,
        )
    except subprocess.TimeoutExpired:
        raise UnavailableError(f"{what} took longer than {FETCH_SECONDS} s") from None
    if done.returncode:
        lines = (done.stderr + done.stdout).strip().splitlines() or ["no message"]
        reason = next((line for line in lines if line.startswith("E: ")), lines[-1])
        raise UnavailableError(f"{what} failed: {reason.removeprefix('E: ')}")
    return done.stdout
