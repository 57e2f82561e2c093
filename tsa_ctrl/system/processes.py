"""Start plant and daemon as the processes that a user would start, and end them in every case."""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing import forkserver
from multiprocessing.context import BaseContext
from pathlib import Path
from typing import Any

from tsa_ctrl.errors import BusError
from tsa_ctrl.system.keeper import environment


def ignore(*numbers: signal.Signals) -> None:
    """Ignore signals that a terminal sends to its whole process group, because another process ends this one."""
    for number in numbers:
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def unheard_by_children() -> Iterator[None]:
    """Shield processes that this thread starts in the block from Ctrl-C.

    This process receives a pending Ctrl-C after the block and must end its children. The signal mask is used because a
    new program inherits it from its first instruction. A handler in the child would be installed about a second later,
    and a Ctrl-C before that would end the child with a traceback. The resource tracker of multiprocessing is started
    first because its start would reset the mask.
    """
    from multiprocessing import resource_tracker  # most processes have no children

    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def postponed() -> Iterator[None]:
    """Postpone SIGINT and SIGTERM to the end of the block.

    Handlers are used because a signal mask applies to one thread only, and another thread could receive the signal.
    Outside the main thread the block does nothing, because Python runs signal handlers in the main thread only.
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


LEAN = "tsa_ctrl.system.lean"


def loading(module: str) -> BaseContext:
    """Return the context that starts workers with `module` imported already.

    A server process imports `module` in the background and forks the workers; only the first call chooses the module.
    A fork of this process would copy locks that its threads hold. Linear algebra is limited to one thread per process,
    because the workers would compete for the processors otherwise.
    """
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([LEAN, module])
    with unheard_by_children():
        forkserver.ensure_running()
    return context


READY_TIME = 120.0  # s: the plant compiles its physics on the first start of a machine
END_TIME = 15.0  # s
OVERTIME = 30.0  # s beyond the requested duration after which the daemon counts as hung


def tsa(*arguments: str) -> list[str]:
    """Return the command line of a `tsa` command, independent of PATH."""
    return [sys.executable, "-m", "tsa_ctrl", *arguments]


@contextlib.contextmanager
def plant(folder: Path, record: str | None = None) -> Iterator[subprocess.Popen[str]]:
    """Run `tsa plant plant.toml` in `folder`, wait until it is ready, and end it when the block is left."""
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
        process.terminate()
        try:
            process.communicate(timeout=END_TIME)
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

    If this function is left early, the daemon receives SIGTERM, which ramps the torque to 0, and is waited for. `tick`
    is called with the elapsed share of the time. Raises BusError with the daemon's last line if it fails.
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
        if process is not None and process.poll() is None:
            process.terminate()
            try:
                process.wait(END_TIME)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
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
