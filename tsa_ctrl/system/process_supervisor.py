"""Start, supervise and always end child processes, and report the state of this process to the service manager.

Ways to run a child process:

* `Child`: `python -m MODULE`, bound to this process by a pipe to its stdin.
* `supervise`: a worker forked from a process with one thread, replaced when it fails or hangs. The worker periodically
  records a sign of life. A worker that hangs is killed, and the next one starts only after its end, so there are never
  two. `supervise` runs in a separate process, because a fork in the loop's process would cost the loop cycles.
* `worker_context`: workers of multiprocessing with a module that is already imported; each calls `begin_worker`.
* `plant`, `daemon`: the processes that a user would start.

`Notifier` implements sd_notify(3): it sends the states ready, alive and stopping as datagrams to the socket in
NOTIFY_SOCKET. The loop itself sends the sign of life, so that the manager detects a hanging loop. The loop never waits
for a datagram. By the time the manager kills a hanging process, the drive's own watchdog has removed the torque.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import queue
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from subprocess import Popen
from typing import TYPE_CHECKING, Any

from tsa_ctrl.errors import BusError

if TYPE_CHECKING:
    from multiprocessing.context import BaseContext


# A child process ends with its parent (Linux: prctl(2), PR_SET_PDEATHSIG), not on a signal from the terminal.
_PARENT = "TSA_PARENT"  # environment variable with the parent's process id
_PR_SET_PDEATHSIG = 1


def environment() -> dict[str, str]:
    """Return the environment for a child that must receive SIGTERM when this process ends for any reason."""
    return {**os.environ, _PARENT: str(os.getpid())}


@contextlib.contextmanager
def terminal_blocked() -> Iterator[None]:
    """Block SIGINT and SIGHUP, so that a process started in the block inherits the mask and ignores the terminal.

    Its parent must end that process. In this process, both signals are delivered at the end of the block. A handler in
    the child would be installed about a second later, and an earlier Ctrl-C would end the child with a traceback.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


READY = b"ready\n"  # the line by which a child reports that it has started


class Child(Popen[bytes]):
    """Run `python -m MODULE ARGUMENTS` with pipes to its stdin and from its stdout.

    The child must end when its stdin is closed, which also happens when this process ends. Create it before real-time
    scheduling is requested, so that the child does not inherit it.
    """

    def __init__(self, module: str, *arguments: object, reports: bool = True, fd: int | None = None) -> None:
        """Start the process.

        Args:
            module: module to run.
            arguments: its command line arguments.
            reports: False to discard its stdout.
            fd: file descriptor that the process inherits.
        """
        with terminal_blocked():
            super().__init__(
                [sys.executable, "-m", module, *map(str, arguments)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE if reports else subprocess.DEVNULL,
                pass_fds=() if fd is None else (fd,),
            )

    @property
    def alive(self) -> bool:
        """Return True while the process runs."""
        return self.poll() is None

    def send(self, line: bytes) -> None:
        """Write a line to its stdin. The line is lost if the child has ended."""
        assert self.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self.stdin.write(line + b"\n")
            self.stdin.flush()

    def receive(self) -> bytes:
        """Return the next line of its stdout, or empty bytes once it has ended."""
        assert self.stdout is not None
        return self.stdout.readline()

    def failure(self) -> str:
        """Wait until the child reports its start. Return an empty string for `READY`, and otherwise its message."""
        answer = self.receive()
        return (
            "" if answer == READY else answer.decode(errors="replace").strip() or "it ended at once; see its traceback"
        )

    def end(self, patience: float) -> None:
        """Close its stdin, and kill it if it has not ended after `patience` s. Repeated calls are permitted."""
        if self.stdin is not None:
            with contextlib.suppress(OSError):
                self.stdin.close()
        try:
            self.wait(patience)
        except subprocess.TimeoutExpired:
            self.kill()
            self.wait()


def follow() -> None:
    """Bind this process to the parent that started it, and exit immediately if that parent has already ended."""
    parent = os.environ.pop(_PARENT, "")
    if not parent or not sys.platform.startswith("linux"):
        return
    end_with_parent()
    if str(os.getppid()) != parent:
        sys.exit(1)


def end_with_parent(number: signal.Signals = signal.SIGTERM) -> None:
    """Request the signal `number` for this process when its parent ends for any reason."""
    with contextlib.suppress(OSError, AttributeError):  # not Linux
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number, 0, 0, 0)


LOOK = 0.1  # s between two checks of the worker
REST = 1.0  # s between two starts, so that a worker that fails immediately takes no processor time from the loop
LONGEST_REST = 10.0  # s; REST doubles up to this while workers fail, so that their starts take little processor time
MOST = 10  # replacements after the end of the supervisor's parent, because the worker must still store its data


def supervise(
    work: Callable[[int], int],
    alive: Callable[[], None],
    heard: Callable[[], float],
    hangs: float,
    replaced: Callable[[int], None],
) -> int:
    """Run `work` in a child process and start another one whenever it fails.

    Call this in a process with one thread. If this process ends, the worker ends as well. A failed worker is always
    replaced while the parent of this process lives.

    Args:
        work: worker function, which receives the number of earlier workers and returns an exit code.
        alive: function that records a sign of life, called before each start.
        heard: function that returns the time of the last sign of life, s on the monotonic clock.
        hangs: time without a sign of life after which the worker is killed, s.
        replaced: function called before each replacement with the number of earlier workers.

    Returns:
        0 if a worker ended with 0, or 1 after `MOST` replacements since the end of this process's parent.
    """
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGCHLD})  # `_watched` waits for it
    parent, number, orphaned, rest = os.getppid(), 0, 0, REST
    while orphaned <= MOST:
        if number:
            replaced(number)
        alive()
        begun = time.monotonic()
        worker = _start(work, number)
        if _watched(worker, heard, hangs) == 0:
            return 0
        worked = time.monotonic() - begun
        time.sleep(max(0.0, rest - worked))
        rest = REST if worked > LONGEST_REST else min(2.0 * rest, LONGEST_REST)
        number += 1
        orphaned += os.getppid() != parent or _is_hung_up()
    return 1


def _is_hung_up() -> bool:
    """Return True if stdin is a pipe whose other end is closed. This happens to a `Child` when its parent has ended.

    This also holds if the parent ended before `supervise` could read its process id.
    """
    poll = select.poll()
    poll.register(0, 0)
    return any(event & select.POLLHUP for _, event in poll.poll(0))


def _start(work: Callable[[int], int], number: int) -> int:
    supervisor = os.getpid()
    worker = os.fork()
    if worker:
        return worker
    code = 1
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGCHLD})
        end_with_parent(signal.SIGKILL)
        if os.getppid() == supervisor:
            code = work(number)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


def _watched(worker: int, heard: Callable[[], float], hangs: float) -> int:
    """Wait for the worker's end and return its exit code, which is not 0 for a killed worker."""
    killed = False
    while True:
        done, status = os.waitpid(worker, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        if not killed and time.monotonic() - heard() > hangs:
            os.kill(worker, signal.SIGKILL)  # a worker blocked by a disk ends only when the disk responds
            killed = True
        signal.sigtimedwait({signal.SIGCHLD}, LOOK)  # returns as soon as the worker ends, so the run's end is not late


def ignore(*numbers: signal.Signals) -> None:
    """Ignore signals that a terminal sends to its process group, because another process ends this one."""
    for number in numbers:
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def postponed() -> Iterator[None]:
    """Postpone SIGINT and SIGTERM to the end of the block.

    The block uses handlers, because a signal mask applies to one thread only and another thread could receive the
    signal. Outside the main thread it does nothing, because Python runs signal handlers in the main thread only.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    caught: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, lambda got, _: caught.append(got)) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for waiting in dict.fromkeys(caught):
            signal.raise_signal(waiting)


def worker_context(module: str) -> BaseContext:
    """Return a context that starts workers with `module` already imported.

    A server process imports `module` in the background and forks the workers. Only the first call chooses the module.
    A fork of this process itself would copy locks that its threads hold. Linear algebra is limited to one thread per
    process, because the workers would otherwise compete for the processors.
    """
    # imported here, because most processes have no workers
    from multiprocessing import forkserver, get_context, resource_tracker

    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    context = get_context("forkserver")
    context.set_forkserver_preload([module])
    resource_tracker.ensure_running()  # before the signals are blocked, because its start would unblock them
    with terminal_blocked():
        forkserver.ensure_running()
    return context


def begin_worker() -> None:
    """Ignore SIGINT in a worker of multiprocessing, and end the worker when the process that started it ends.

    The parent of a worker is the server process, which stays as long as any worker has its pipes open. A thread
    therefore waits for the end of the starting process itself. If it has already ended, the worker ends at once.
    """
    from multiprocessing import parent_process

    ignore(signal.SIGINT)
    owner = parent_process()
    if owner is not None:
        threading.Thread(target=_end_after, args=(owner.sentinel,), daemon=True).start()


def _end_after(sentinel: int) -> None:
    """Wait until the process with this sentinel has ended, and then end this process."""
    from multiprocessing.connection import wait

    wait([sentinel])
    os._exit(1)


READY_TIME = 120.0  # s: the plant compiles its physics at the first use on a machine
END_TIME = 15.0  # s
OVERTIME = 30.0  # s beyond the requested duration after which the daemon counts as hung


def tsa(*arguments: str) -> list[str]:
    """Return the command line of a `tsa` command, independent of PATH."""
    return [sys.executable, "-m", "tsa_ctrl", *arguments]


@contextlib.contextmanager
def plant(folder: Path, record: str | None = None) -> Iterator[subprocess.Popen[str]]:
    """Run `tsa plant plant.toml` in `folder`, wait until it is ready, and end it when the block ends."""
    more = [] if record is None else ["--record", record]
    process = subprocess.Popen(
        tsa("plant", "plant.toml", *more),
        cwd=folder,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        _wait_ready(process)
        yield process
    finally:
        end_process(process)


def end_process(process: Popen[str] | Popen[bytes], patience: float = END_TIME) -> None:
    """Terminate a process, and kill it if it has not ended after `patience` s. An ended process is permitted."""
    process.terminate()
    try:
        process.communicate(timeout=patience)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()


def _wait_ready(process: subprocess.Popen[str]) -> None:
    lines: queue.Queue[str] = queue.Queue()

    def read() -> None:
        assert process.stdout is not None
        for line in process.stdout:
            lines.put(line)
        lines.put("")

    threading.Thread(target=read, daemon=True).start()
    end = time.monotonic() + READY_TIME
    while True:
        try:
            line = lines.get(timeout=max(0.0, end - time.monotonic()))
        except queue.Empty:
            raise BusError(f"the plant was not ready within {READY_TIME:g} s; the machine is too busy") from None
        if line.startswith("plant: ready"):
            return
        if not line:
            process.wait()
            assert process.stderr is not None
            raise BusError(f"the plant ended: {_last_line(process.stderr.read())}")


def daemon(folder: Path, name: str, seconds: float, tick: Callable[[float], None]) -> dict[str, Any]:
    """Run `tsa run controller-NAME.toml` in `folder` for `seconds` of torque, and return its summary.

    An exception sends SIGTERM to the daemon, which ramps the torque to 0, and waits for its end.

    Args:
        folder: folder of the files.
        name: NAME of the controller file.
        seconds: time with torque, s.
        tick: function called repeatedly with the elapsed share of the time, 0 to 1.

    Raises:
        BusError: The daemon failed (with its cause or last line), or did not end in time.
    """
    command = tsa("run", f"controller-{name}.toml", "--seconds", f"{seconds:g}", "--json")
    process = None
    begin = time.monotonic()
    try:
        with postponed():  # a signal between start and assignment would leave a process that is never ended
            process = subprocess.Popen(
                command, cwd=folder, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
            )
        while True:
            try:
                out, errors = process.communicate(timeout=0.2)
                break
            except subprocess.TimeoutExpired:
                gone = time.monotonic() - begin
                tick(min(1.0, gone / (seconds + 3.0)))
                if gone > seconds + OVERTIME:
                    raise BusError(f"the daemon did not end {OVERTIME:g} s after its time") from None
    finally:
        if process is not None:
            end_process(process)
    if process.returncode != 0:
        cause = _last_line(errors)
        with contextlib.suppress(json.JSONDecodeError):
            cause = str(json.loads(out)["cause"])
        raise BusError(f"the daemon ended with {process.returncode}: {cause}")
    summary: dict[str, Any] = json.loads(out)
    return summary


def _last_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else "no word from it"


PER_INTERVAL = 4  # signs of life within the manager's time-out
LONGEST = 60.0  # s that a new bring-up, or the end of a run, may take without a sign of life


class Notifier:
    """Notify the service manager of state changes. Without a service manager, do nothing."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._interval = _interval(environment)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) if address else None
        if self._socket is not None:
            self._socket.setblocking(False)
        self._due = 0.0
        self._ready = self._stopping = False

    def update(self, now: float, status: str, up: bool, ending: bool) -> None:
        """Notify the service manager. The loop calls this several times per second.

        Args:
            now: monotonic time, s.
            status: short text for the operator.
            up: True once startup is over.
            ending: True once the run is ending.
        """
        if self._socket is None:
            return
        if up and not self._ready:
            self._ready = True
            self._say(f"READY=1\nSTATUS={status}")
        if ending and not self._stopping:
            self._stopping = True
            self._say("STOPPING=1\nSTATUS=stopping")
            self._allow(LONGEST)
        if self._interval is not None and now >= self._due:
            self._due = now + self._interval / PER_INTERVAL
            self._say("WATCHDOG=1")

    @contextlib.contextmanager
    def no_loop(self) -> Iterator[None]:
        """Allow a longer silence in the block, because a bring-up takes longer than the manager's time-out."""
        self._allow(LONGEST)
        try:
            yield
        finally:
            self._allow(0.0)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _allow(self, seconds: float) -> None:
        """Request that the manager wait this long (s) for a sign of life, but never less than configured."""
        if self._interval is not None:
            self._say(f"WATCHDOG_USEC={round(1e6 * max(seconds, self._interval))}\nWATCHDOG=1")

    def _say(self, text: str) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):  # no receiver, or a full queue: the loop must not wait
                self._socket.sendto(text.encode(), self._address)


def _interval(environment: Mapping[str, str]) -> float | None:
    """Return WATCHDOG_USEC in s, or None if it is not meant for this process."""
    usec, pid = environment.get("WATCHDOG_USEC", ""), environment.get("WATCHDOG_PID", "")
    if not usec.isdecimal() or int(usec) == 0 or pid not in ("", str(os.getpid())):
        return None
    return int(usec) * 1e-6
