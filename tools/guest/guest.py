"""Run a command in a user-mode Linux guest that has a vcan, and pass its streams, signals and exit status.

The guest uses the root file system of the host, so all paths are the same. It has its own /dev/shm, processes and
network (lo and the vcan), and one processor. It leaves no files on the host.
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
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from types import FrameType

from tools.command import ROOT
from tools.guest.init import write_all
from tools.guest.kernel import Kernel, UnavailableError, cache_folder

BOOT_SECONDS = 120.0  # an idle machine needs 2 s
GRACE_SECONDS = 10.0  # from the caller's signal or the time-out to the end of the guest
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
TIMED_OUT = 124  # as timeout(1)
PR_SET_PDEATHSIG = 1
BLOCK = 1 << 16
INPUT_BLOCK = 2048  # half of a terminal's buffer
LIBC = ctypes.CDLL(None)


@dataclass(frozen=True)
class Limits:
    """The limits of a guest."""

    memory: int  # bytes
    seconds: float | None  # s, longest duration of the command


def run(kernel: Kernel, command: list[str], environment: dict[str, str], limits: Limits) -> int:
    """Run a command in a guest. Return its exit status, or 124 after the time-out.

    Raises:
        UnavailableError: The guest did not start.
    """
    with (
        tempfile.TemporaryDirectory(prefix="tsa-vcan-", dir="/tmp", ignore_cleanup_errors=True) as folder,
        _processor_claim() as processor,
    ):
        guest = Guest(kernel, command, environment, limits.memory, Path(folder), processor)
        try:
            return guest.run(limits.seconds)
        finally:
            guest.kill()


class Guest:
    """A running guest. From its creation on, it handles the signals and the alarm of this process."""

    def __init__(
        self,
        kernel: Kernel,
        command: list[str],
        environment: dict[str, str],
        memory: int,
        folder: Path,
        processor: int | None,
    ) -> None:
        self._folder = folder
        self._processor = processor
        self._ending: int | None = None  # exit status after a signal or the time-out
        _write_request(kernel, command, environment, folder)
        self._start(kernel, memory)
        for number in SIGNALS:
            signal.signal(number, self._on_signal)
        signal.signal(signal.SIGALRM, self._on_alarm)
        # Reading a terminal in the background must fail, not stop this process.
        signal.signal(signal.SIGTTIN, signal.SIG_IGN)

    def run(self, seconds: float | None) -> int:
        """Pass streams and signals until the guest has ended. Return the exit status."""
        self._wait_until_ready()
        signal.setitimer(signal.ITIMER_REAL, seconds or 0)
        Thread(target=_feed, args=(self._keyboard, self._acknowledged), daemon=True).start()
        self._process.wait()
        self.kill()
        for pump in self._pumps:
            pump.join()
        return self._status()

    def kill(self) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)

    def _start(self, kernel: Kernel, memory: int) -> None:
        (output, out), (errors, err), (self._acknowledged, ack) = (os.pipe() for _ in range(3))
        (keys, self._keyboard), (orders, self._control) = (os.pipe() for _ in range(2))
        passed = (out, err, keys, ack, orders)
        arguments = [
            f"mem={memory >> 20}M seccomp=on quiet root=/dev/root rootfstype=hostfs rootflags=/ rw",
            f"init={self._folder}/init uml_dir={self._folder} umid=guest con=null con0=null,fd:1 ssl=null",
            f"ssl0=null,fd:{out} ssl1=null,fd:{err} ssl2=fd:{keys},fd:{ack} ssl3=fd:{orders},null",
        ]
        memory_folder = _memory_folder(memory, self._folder)
        with (self._folder / "console").open("wb") as console:
            self._process = subprocess.Popen(
                [str(kernel.program), *" ".join(arguments).split()],
                cwd=kernel.folder,
                env={"LD_LIBRARY_PATH": "lib", "PATH": os.defpath, "TMPDIR": memory_folder},
                stdin=subprocess.DEVNULL,
                stdout=console,
                stderr=console,
                pass_fds=passed,
                start_new_session=True,  # Ctrl-C goes to this process, which passes it on
                preexec_fn=self._prepare,
            )
        for fd in passed:
            os.close(fd)
        self._pumps = [Thread(target=self._pump, args=streams) for streams in ((output, 1), (errors, 2))]
        for thread in self._pumps:
            thread.start()

    def _prepare(self) -> None:
        """End the guest's process with this one, and pin it to one processor, which nearly halves a round trip."""
        LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if self._processor is not None:
            os.sched_setaffinity(0, {self._processor})

    def _wait_until_ready(self) -> None:
        deadline = time.monotonic() + BOOT_SECONDS
        while self._ending is None and not self._is_up():
            if self._process.poll() is not None:
                raise UnavailableError(f"the user-mode Linux guest ended while starting: {self._last_words()}")
            if time.monotonic() > deadline:
                raise UnavailableError(
                    f"the user-mode Linux guest was not up in {BOOT_SECONDS:.0f} s: {self._last_words()}"
                )
            time.sleep(0.02)

    def _is_up(self) -> bool:
        return (self._folder / "ready").exists()

    def _pump(self, source: int, target: int) -> None:
        try:
            while data := os.read(source, BLOCK):
                write_all(target, data)
        except OSError:  # the reader of the output has closed it
            self._ending = 128 + signal.SIGPIPE
            self.kill()

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        self._end(number, 128 + number)

    def _on_alarm(self, _number: int, _frame: FrameType | None) -> None:
        self._end(signal.SIGTERM, TIMED_OUT)

    def _end(self, number: int, status: int) -> None:
        """Pass the signal to the command and start the grace period. A second call ends the guest immediately."""
        if self._ending is not None or not self._is_up():
            self._ending = self._ending or status
            self.kill()
            return
        self._ending = status
        with suppress(OSError):
            os.write(self._control, b"%d\n" % number)
        signal.setitimer(signal.ITIMER_REAL, GRACE_SECONDS)

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
        return " | ".join([line.strip() for line in lines if line.strip()][-3:]) or "no output"


def _write_request(kernel: Kernel, command: list[str], environment: dict[str, str], folder: Path) -> None:
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
    (folder / "request.json").write_text(json.dumps(request))
    init = [sys.executable, "-BES", str(ROOT / "tools"), "guest/init", str(folder)]
    (folder / "init").write_text(f"#!/bin/sh\nexec {shlex.join(init)}\n")
    (folder / "init").chmod(0o755)


def _feed(keyboard: int, acknowledged: int) -> None:
    """Send the standard input in blocks, each after its length. The length 0 marks the end.

    A serial line of the guest may stall permanently once its buffer has been full. Therefore each block must be
    acknowledged before the next one is sent.
    """
    with suppress(OSError):
        data = b"-"
        while data:
            try:
                data = os.read(0, INPUT_BLOCK)
            except OSError:
                data = b""
            write_all(keyboard, len(data).to_bytes(2, "big") + data)
            os.read(acknowledged, 1)


@contextmanager
def _processor_claim() -> Iterator[int | None]:
    """Yield a processor that no other guest uses, or None if all are in use."""
    with ExitStack() as stack:
        for processor in sorted(os.sched_getaffinity(0), reverse=True):
            claim = stack.enter_context((cache_folder() / f"processor-{processor}").open("wb"))
            with suppress(BlockingIOError):
                fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
                yield processor
                return
        yield None


def _memory_folder(memory: int, otherwise: Path) -> str:
    """Return the folder for the guest's memory: /dev/shm if it is large enough, else `otherwise`.

    /dev/shm of a container often has only 64 MB.
    """
    shared = Path("/dev/shm")
    if shared.is_dir() and os.access(shared, os.W_OK):
        state = os.statvfs(shared)
        if state.f_bavail * state.f_frsize >= memory and not state.f_flag & os.ST_NOEXEC:
            return str(shared)
    return str(otherwise)
