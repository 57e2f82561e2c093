"""Run a command in a user-mode Linux guest that has a vcan; its streams, signals and exit status are the caller's.

The host's files are the guest's root file system, so the command finds everything where it was. The guest has its own
/dev/shm, its own processes and network (lo and the vcan) and one processor, and nothing of it remains.
"""

from __future__ import annotations

import ctypes
import fcntl
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from types import FrameType
from typing import IO

from kernel import Kernel, UnavailableError, cache_folder

BOOT_SECONDS = 120.0  # two on an idle machine
GRACE_SECONDS = 10.0  # between the caller's signal, or the time-out, and the end of the guest
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
TIMED_OUT = 124  # as timeout(1)
PR_SET_PDEATHSIG = 1
BLOCK = 1 << 16
LIBC = ctypes.CDLL(None)


@dataclass(frozen=True)
class Limits:
    memory: int  # bytes
    seconds: float | None


class Guest:
    """One boot; `status` is the command's, or 128 + the signal that ended the guest before the command."""

    def __init__(self, kernel: Kernel, command: list[str], environment: dict[str, str], limits: Limits) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="tsa-vcan-", dir="/tmp"))
        self._up = False
        self._ending: int | None = None  # exit status once a signal or the time-out asked for the end
        self._previous = {number: signal.signal(number, self._on_signal) for number in SIGNALS}
        self._previous[signal.SIGALRM] = signal.signal(signal.SIGALRM, self._on_alarm)
        # In the background a read of the terminal shall fail, not stop this process.
        self._previous[signal.SIGTTIN] = signal.signal(signal.SIGTTIN, signal.SIG_IGN)
        self._write_request(kernel, command, environment)
        self._processor, self._claim = _claim_processor()
        self._start(kernel, limits.memory)
        self._seconds = limits.seconds or 0

    def run(self) -> int:
        """Pass streams and signals until the guest has ended; raises UnavailableError if it did not come up."""
        try:
            self._wait_until_ready()
            signal.setitimer(signal.ITIMER_REAL, self._seconds)
            Thread(target=_feed, args=(self._keyboard,), daemon=True).start()
            for pump in self._pumps:
                pump.join()
            self._process.wait()
            return self._status()
        finally:
            self._kill()
            signal.setitimer(signal.ITIMER_REAL, 0)
            for number, handler in self._previous.items():
                signal.signal(number, handler)
            shutil.rmtree(self._folder, ignore_errors=True)
            self._claim.close()

    def _write_request(self, kernel: Kernel, command: list[str], environment: dict[str, str]) -> None:
        size = shutil.get_terminal_size()
        request = {
            "command": command,
            "directory": str(Path.cwd()),
            "environment": {**environment, "TMPDIR": "/dev/shm/tmp", "XDG_RUNTIME_DIR": "/dev/shm/run"},
            "interface": environment["TSA_VCAN"],
            "modules": str(kernel.modules),
            "terminals": [os.isatty(number) for number in range(3)],
            "size": [size.lines, size.columns],
        }
        (self._folder / "request.json").write_text(json.dumps(request))
        init = [sys.executable, "-BES", str(Path(__file__).with_name("init.py")), str(self._folder)]
        (self._folder / "init").write_text(f"#!/bin/sh\nexec {shlex.join(init)}\n")
        (self._folder / "init").chmod(0o755)

    def _start(self, kernel: Kernel, memory: int) -> None:
        (output, out), (errors, err), (keys, self._keyboard), (orders, self._control) = (os.pipe() for _ in range(4))
        with (self._folder / "console").open("wb") as console:
            self._process = subprocess.Popen(
                [
                    *(str(kernel.program), f"mem={memory >> 20}M", "seccomp=on", "quiet"),
                    *(
                        "root=/dev/root",
                        "rootfstype=hostfs",
                        "rootflags=/",
                        "rw",
                        f"init={self._folder}/init",
                    ),
                    *(f"uml_dir={self._folder}", "umid=guest", "con=null", "con0=null,fd:1", "ssl=null"),
                    *(
                        f"ssl0=null,fd:{out}",
                        f"ssl1=null,fd:{err}",
                        f"ssl2=fd:{keys},null",
                        f"ssl3=fd:{orders},null",
                    ),
                ],
                cwd=kernel.folder,
                env={
                    "LD_LIBRARY_PATH": "lib",
                    "PATH": os.defpath,
                    "TMPDIR": _memory_folder(memory, self._folder),
                },
                stdin=subprocess.DEVNULL,
                stdout=console,
                stderr=console,
                pass_fds=(out, err, keys, orders),
                start_new_session=True,  # the terminal's Ctrl-C is for this process, which passes it on
                preexec_fn=self._prepare,
            )
        for fd in (out, err, keys, orders):
            os.close(fd)
        self._pumps = [Thread(target=self._pump, args=streams) for streams in ((output, 1), (errors, 2))]
        for thread in self._pumps:
            thread.start()

    def _prepare(self) -> None:
        """In the guest's process: ends with this one, and stays on one processor, which nearly halves a round trip."""
        LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if self._processor is not None:
            os.sched_setaffinity(0, {self._processor})

    def _wait_until_ready(self) -> None:
        deadline = time.monotonic() + BOOT_SECONDS
        while self._ending is None and not (self._folder / "ready").exists():
            if self._process.poll() is not None:
                raise UnavailableError(f"the user-mode Linux guest ended while starting: {self._last_words()}")
            if time.monotonic() > deadline:
                raise UnavailableError(
                    f"the user-mode Linux guest was not up in {BOOT_SECONDS:.0f} s: {self._last_words()}"
                )
            time.sleep(0.02)
        self._up = True

    def _pump(self, source: int, target: int) -> None:
        try:
            while data := os.read(source, BLOCK):
                _write_all(target, data)
        except OSError:  # whoever read our output has gone
            self._ending = 128 + signal.SIGPIPE
            self._kill()

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        self._end(number, 128 + number)

    def _on_alarm(self, _number: int, _frame: FrameType | None) -> None:
        self._end(signal.SIGTERM, TIMED_OUT)

    def _end(self, number: int, status: int) -> None:
        """Pass the signal on and give the command time to end; the second call ends the guest at once."""
        if self._ending is not None or not self._up:
            self._ending = self._ending or status
            self._kill()
            return
        self._ending = status
        with suppress(OSError):
            os.write(self._control, b"%d\n" % number)
        signal.setitimer(signal.ITIMER_REAL, GRACE_SECONDS)

    def _kill(self) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)

    def _status(self) -> int:
        try:
            status = int((self._folder / "status").read_text())
        except (OSError, ValueError):
            if self._ending is None:
                raise SystemExit(f"tools/vcan: the user-mode Linux guest broke down: {self._last_words()}") from None
            return self._ending
        return TIMED_OUT if self._ending == TIMED_OUT else status

    def _last_words(self) -> str:
        lines = (self._folder / "console").read_text(errors="replace").split("\n")
        return " | ".join([line.strip() for line in lines if line.strip()][-3:]) or "it said nothing"


def _feed(keyboard: int) -> None:
    """Our standard input in blocks with their length before them; a length of zero is its end."""
    with suppress(OSError):
        data = b"-"
        while data:
            try:
                data = os.read(0, BLOCK)
            except OSError:
                data = b""
            _write_all(keyboard, len(data).to_bytes(4, "big") + data)


def _write_all(fd: int, data: bytes) -> None:
    while data:
        data = data[os.write(fd, data) :]


def _claim_processor() -> tuple[int | None, IO[bytes]]:
    """A processor that no other guest has, and what holds the claim; None when all are taken."""
    for processor in sorted(os.sched_getaffinity(0), reverse=True):
        claim = (cache_folder() / f"processor-{processor}").open("wb")
        try:
            fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return processor, claim
        except BlockingIOError:
            claim.close()
    return None, claim


def _memory_folder(memory: int, otherwise: Path) -> str:
    """Where the guest's memory goes: /dev/shm if it has room (containers often have 64 MB), else `otherwise`."""
    shared = Path("/dev/shm")
    if shared.is_dir() and os.access(shared, os.W_OK):
        state = os.statvfs(shared)
        if state.f_bavail * state.f_frsize >= memory and not state.f_flag & os.ST_NOEXEC:
            return str(shared)
    return str(otherwise)
