"""Measure memory and time of `tsa diagnose` on one hour at 1 kHz, as a table (CSV) and as a log of the daemon (MCAP).

Usage: tools/run bench/hour [--seconds 3600] [--seed 0] [--kinds csv mcap]

The hour repeats a minute of the blind benchmark (tests/blind) between two moments with similar motion. The peak is the
sum of the proportional set sizes of all processes of the command (/proc/PID/smaps_rollup), sampled every 0.1 s.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tests.blind import case
from tools import command
from tsa_ctrl.log.convert import write_columns
from tsa_ctrl.log.mcap_file import McapFile
from tsa_ctrl.log.process import LogHeader
from tsa_ctrl.signals import FIELD_NAMES
from tsa_ctrl.system.process_supervisor import tsa

RATE = 1000  # Hz
CHUNK = 1000  # records in one chunk, as the daemon writes them
LOOK = 0.1  # s between two samples of the memory
SEAM = 0.2  # share of the minute at each end in which the two moments are searched
MOTION = ("q_j", "q_m", "omega_j", "omega_m")

Columns = dict[str, NDArray[np.float64]]


def repeated(columns: Columns, seconds: float) -> Columns:
    """Return the log extended to `seconds` by repeating the section between two moments with similar motion."""
    count = len(columns["t"])
    ends = round(SEAM * count)
    seen = np.column_stack([columns[name] / np.ptp(columns[name]) for name in MOTION if name in columns])
    distance, partner = (np.asarray(found) for found in cKDTree(seen[:ends]).query(seen[-ends:]))
    last = int(np.argmin(distance))
    first, end = int(partner[last]), count - ends + last
    rows = first + np.arange(round(seconds * RATE)) % (end - first)
    return {**{name: values[rows] for name, values in columns.items()}, "t": np.arange(len(rows)) / RATE}


def write_log(path: Path, columns: Columns) -> None:
    """Write the columns as one axis of the daemon's log."""
    file = McapFile(path, LogHeader(("joint",), float(RATE)))
    count = len(columns["t"])
    whole: Columns = {**columns, "cycle": np.arange(count, dtype=np.float64), "state": np.zeros(count)}
    nothing = np.full(CHUNK, np.nan)
    for start in range(0, count, CHUNK):
        rows = slice(start, min(start + CHUNK, count))
        parts = [whole[name][rows] if name in whole else nothing[: rows.stop - start] for name in FIELD_NAMES]
        file.write([np.column_stack(parts)])
    file.finish()


def made(log: Path, model: Path, seconds: float, seed: int) -> int:
    """Write the log (CSV or MCAP by its suffix) and the model file. Return the number of columns."""
    hidden = case("timing", "stribeck_friction", seed)
    columns = repeated(hidden.logs[0].columns, seconds)
    (write_columns if log.suffix == ".csv" else write_log)(log, columns)
    model.write_text(hidden.model)
    return len(columns)


def held(pid: int) -> float:
    """Return the proportional set size of a process in MB, or 0 if it has ended."""
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                return float(line.split()[1]) * 1024 / 1e6
    return 0.0


def diagnosed(log: Path, model: Path) -> tuple[str, float, float, float]:
    """Run `tsa diagnose`, and return the identified causes, wall time (s), processor time (s) and peak memory (MB)."""
    out = log.with_suffix("")
    verb = tsa("diagnose", str(log), "--model", str(model), "--out", str(out))
    began = time.perf_counter()
    peak = 0.0
    with subprocess.Popen(verb, stdout=subprocess.DEVNULL) as process:
        while True:
            pid, status, used = os.wait4(process.pid, os.WNOHANG)
            if pid:
                break
            peak = max(peak, sum(map(held, command.family(process.pid))))
            time.sleep(LOOK)
        process.returncode = os.waitstatus_to_exitcode(status)
    seconds = time.perf_counter() - began
    if process.returncode:
        raise SystemExit(f"tools/run bench/hour: tsa diagnose {log.name} ended with status {process.returncode}")
    causes = json.loads((out / "diagnosis.json").read_text())["causes"]
    named = ", ".join(cause["effect"] for cause in causes) or "nothing"
    return named, seconds, used.ru_utime + used.ru_stime, peak


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--seconds", type=float, default=3600.0, help="length of the log (default an hour)")
    parser.add_argument("--seed", type=int, default=0, help="of the case (default 0)")
    parser.add_argument("--kinds", nargs="+", choices=("csv", "mcap"), default=["csv", "mcap"], help="default both")
    arguments = parser.parse_args()
    for kind in arguments.kinds:
        with tempfile.TemporaryDirectory() as place:
            log, model = Path(place) / f"log.{kind}", Path(place) / "actuator.toml"
            with ProcessPoolExecutor(1) as pool:  # a child process inherits the peak memory of its parent
                count = pool.submit(made, log, model, arguments.seconds, arguments.seed).result()
            named, seconds, used, peak = diagnosed(log, model)
        print(
            f"{kind}: {arguments.seconds:.0f} s at {RATE} Hz, {count} columns, named {named}: peak {peak:.0f} "
            f"MB, {seconds:.1f} s, of which {used:.1f} s of one processor",
            flush=True,
        )
    return 0
