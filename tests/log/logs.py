"""Small logs for tests."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tsa_ctrl.cli import log_import, main
from tsa_ctrl.log.mcap_file import McapFile, Note
from tsa_ctrl.log.process import LogHeader
from tsa_ctrl.log.reader import LogFile
from tsa_ctrl.log.ring import RingWriter
from tsa_ctrl.signals import FIELD_NAMES, FIELDS

HEADER = LogHeader(
    axes=("hip", "knee"),
    rate=1000.0,
    files={"controller.toml": "rate = 1000\n"},
    codes={"state": {3: "operation_enabled", 8: "fault"}},
    started=1.7e9,
)


def records(count: int, first: int = 0, **columns: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Return `count` records at 1 kHz, (count, fields).

    All fields are NaN except t, cycle, state and `columns`.
    """
    block = np.full((count, len(FIELDS)), np.nan)
    number = np.arange(first, first + count)
    for name, values in {"t": number * 1e-3, "cycle": number, "state": 3.0, **columns}.items():
        block[:, FIELD_NAMES.index(name)] = values
    return block


def push(ring: RingWriter, count: int, first: int = 0) -> None:
    """Push `count` cycles of two axes into the ring."""
    for row in records(count, first).tolist():
        for axis in range(2):
            ring.push(axis, row)


def motion(count: int) -> dict[str, NDArray[np.float64]]:
    """Return the signals of a moving joint as columns of a log."""
    t = np.arange(count) * 1e-3
    return {"tau_m": 0.8 * np.cos(5.0 * t), "tau_j": np.cos(5.0 * t), "omega_j": np.sin(5.0 * t)}


def write_log(path: Path, chunks: int = 4, per_chunk: int = 100, header: LogHeader = HEADER) -> None:
    """Write a complete log. All axes have the same records except for tau_m, which is the index of the axis."""
    file = McapFile(path, header)
    for chunk in range(chunks):
        blocks = [
            records(per_chunk, chunk * per_chunk, tau_m=float(axis), omega_j=1.0) for axis in range(len(header.axes))
        ]
        file.write(blocks)
    file.finish()


def notes_of(log: LogFile) -> list[Note]:
    """Read all records of a log, and return its events."""
    for _ in log.blocks(()):
        pass
    return log.notes


def import_log(*line: str) -> int:
    """Run `tsa log import` with these arguments. Return its exit code."""
    with pytest.raises(SystemExit) as ended:
        main(["log", "import", *line])
    return int(ended.value.code or 0)


def understood(path: Path, *given: str, yes: bool = False, rate: float | None = None) -> log_import.Understood:
    """Return the columns that `tsa log import` takes from a file, with options --column `given`."""
    (done,), _ = log_import.understand_all([path], None, given, yes, rate)
    return done


def wait_for(condition: Callable[[], bool], seconds: float = 20.0) -> bool:
    """Poll until `condition` holds. Return False after `seconds`."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.01)
    return False


def kill_an_owner(path: Path) -> None:
    """Start a process that owns a ring and its log, pushes 700 cycles of two axes and kills itself."""
    code = f"""
        import os
        from pathlib import Path
        from tests.log.logs import HEADER, push
        from tsa_ctrl.log.process import LogProcess
        from tsa_ctrl.log.ring import RingWriter
        ring = RingWriter(axes=2)
        log = LogProcess(Path({str(path)!r}), ring, HEADER)
        push(ring, 700)
        os.kill(os.getpid(), 9)
    """
    owner = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], check=False)
    assert owner.returncode == -signal.SIGKILL
