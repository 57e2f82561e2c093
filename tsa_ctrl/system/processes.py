"""Plant and daemon as the processes that a user would start, watched, and ended whatever happens."""

from __future__ import annotations

import contextlib
import json
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from tsa_ctrl.errors import BusError
from tsa_ctrl.system.parent import environment
from tsa_ctrl.system.signals import postponed

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
