"""Build the wheel, check it as a package index would, and try it in a new environment without a checkout.

Usage: tools/run package/check [--out FOLDER] [--python PYTHON ...]

The command builds the source distribution and the wheel from the tracked files, and runs `twine check` on both. For
each PYTHON (default: 3.11 and 3.13 if installed) it creates a virtual environment, installs the wheel, and runs the
first commands of a new user. The exit status is 1 if a step failed. A package registry is required.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from tools import command

PYTHONS = ("3.11", "3.13")
TRIED: tuple[tuple[str, ...], ...] = (
    ("--version",),
    ("--help",),
    ("help", "rig"),
    ("init", "--rig", "rig"),
    ("init", "--desk", "desk"),
    ("run", "--check", "desk/controller.toml"),
    ("demo", "--virtual", "--seconds", "6", "--out", "demo"),
    ("simulate-loop", "desk/controller.toml", "desk/plant.toml", "--seconds", "2", "--out", "loop"),
    ("diagnose", "--example", "--out", "example"),
)


def source(folder: Path) -> Path:
    """Copy the files that git tracks to `folder`, so that the build contains no other files. Return the folder."""
    names = subprocess.run(
        ["git", "-C", str(command.ROOT), "ls-files", "-z"], capture_output=True, text=True, check=True
    ).stdout.split("\0")
    for name in filter(None, names):
        place = folder / name
        place.parent.mkdir(parents=True, exist_ok=True)
        if (command.ROOT / name).is_symlink() or (command.ROOT / name).is_file():
            shutil.copy2(command.ROOT / name, place, follow_symlinks=False)
    return folder


def build(out: Path) -> tuple[Path, Path]:
    """Build source distribution and wheel in `out`.

    Raises:
        CalledProcessError: The build failed. The error has its output.
    """
    with tempfile.TemporaryDirectory(prefix="tsa-build-") as folder:
        tree = source(Path(folder) / "tsa-ctrl")
        line = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(out), str(tree)]
        subprocess.run(line, capture_output=True, text=True, check=True)
    (archive,), (wheel,) = out.glob("*.tar.gz"), out.glob("*.whl")
    return archive, wheel


def twine(files: Sequence[Path]) -> str:
    """Return the output of `twine check --strict`.

    Raises:
        CalledProcessError: The check failed.
    """
    line = [sys.executable, "-m", "twine", "check", "--strict", *map(str, files)]
    return subprocess.run(line, capture_output=True, text=True, check=True).stdout


def tried(python: str, wheel: Path) -> list[tuple[str, int, float, str]]:
    """Install the wheel in a new environment and run the commands.

    Return command, exit status, duration (s) and last line of the output for each step.
    """
    rows = []
    with tempfile.TemporaryDirectory(prefix="tsa-bare-") as name:
        folder = Path(name)

        def step(said: str, line: Sequence[str]) -> bool:
            began = time.monotonic()
            done = subprocess.run(line, cwd=folder, capture_output=True, text=True, stdin=subprocess.DEVNULL)
            last = (done.stdout if done.returncode == 0 else done.stderr or done.stdout).strip().splitlines()[-1:]
            rows.append((said, done.returncode, time.monotonic() - began, "".join(last)))
            return done.returncode == 0

        if step("venv", [python, "-m", "venv", "bare"]) and step(
            "pip install", ["bare/bin/pip", "install", "--quiet", "--disable-pip-version-check", str(wheel)]
        ):
            for words in TRIED:
                step(f"tsa {' '.join(words)}", ["bare/bin/tsa", *words])
            step("environment after it all", ["du", "-sm", "bare"])
    return rows


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--out", type=Path, help="keep the distributions in this folder")
    parser.add_argument("--python", nargs="+", help="interpreters to try the wheel with")
    asked = parser.parse_args()
    failed = False
    with tempfile.TemporaryDirectory(prefix="tsa-dist-") as name:
        out = asked.out or Path(name)
        out.mkdir(parents=True, exist_ok=True)
        try:
            files = build(out)
            print(twine(files).strip())
        except subprocess.CalledProcessError as error:
            print(f"{error.stdout}{error.stderr}", file=sys.stderr)
            return 1
        for python in asked.python or PYTHONS:
            found = shutil.which(python if asked.python else f"python{python}")
            if found is None or subprocess.run([found, "-c", ""], capture_output=True).returncode:
                print(f"python {python}: is not here, skipped")
                continue
            for said, status, seconds, last in tried(found, files[1]):
                failed |= status != 0
                print(f"python {python:5s} {said:70s} {status} {seconds:6.1f} s  {last[:80]}")
    return int(failed)
