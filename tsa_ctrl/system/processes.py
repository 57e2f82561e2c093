"""Plant and daemon as the processes that a user would start, watched, and ended whatever happens."""

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

# The process that workers are forked from, which loads what they need while this one does something else.

# Signals of a process: those that are not its concern, and those that shall wait.


def ignore(*numbers: signal.Signals) -> None:
    """These reach the whole group of a terminal; what they mean for this process is decided by another one."""
    for number in numbers:
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def unheard_by_children() -> Iterator[None]:
    """Ctrl-C never reaches a process that this thread starts in the block; its parent, which ends it, has it after it.

    By the mask, which a new program keeps from its first instruction: a handler of its own comes a second too late,
    and until then it would end with a traceback. The tracker of multiprocessing would undo the mask as it starts.
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
    """SIGINT and SIGTERM are handled when the block is left.

    By handlers: a mask is one thread's own, and a signal takes any thread that lets it through. Beside the main thread
    nothing is to be done, as Python runs handlers in that one alone.
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
    """What starts workers with `module` imported, from a process that imports it from now on; the first call counts.

    A fork of this process would take its threads' locks along. Linear algebra takes one thread in all of them, which
    would only get in each other's way.
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
OVERTIME = 30.0  # s beyond the asked duration until a daemon counts as hung


def tsa(*arguments: str) -> list[str]:
    """The command line of a verb, whatever is on PATH."""
    return [sys.executable, "-m", "tsa_ctrl", *arguments]


@contextlib.contextmanager
def plant(folder: Path, record: str | None = None) -> Iterator[subprocess.Popen[str]]:
    """`tsa plant plant.toml` in `folder`, ready; ended when the block is left."""
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
    """Run `tsa run controller-NAME.toml` in `folder` for `seconds` of torque; returns its summary.

    However this function is left, the daemon is asked to ramp its torque to 0 and to end, and is waited for. `tick` is
    called with the share of the time that has gone. Raises BusError with the daemon's last line when it fails.
    """
    command = tsa("run", f"controller-{name}.toml", "--seconds", f"{seconds:g}", "--json")
    process = None
    begin = time.monotonic()
    try:
        with postponed():  # no process may start that nobody knows of
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
