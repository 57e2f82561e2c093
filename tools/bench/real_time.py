"""Real time against virtual time: what the loop delivers on a vcan, and what of its error the machine makes.

Usage: tools/vcan tools/run bench/real_time [--rate 1000] [--loads imposed held spring]
Plant and daemon as processes on the vcan; then the same files in virtual time with a loop that is awake when that was
and misses the answers that it missed; then in virtual time with nothing late. Printed for each load: the share of the
cycles that came in time, the RMS error of the delivered torque of the three (mN*m), and the first over the second:
what real time adds beside the machine's stalls. Exit code 1: more than `MOST` times.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from tests.virtual.real_time import LOADS, SECONDS, TIMES, files, in_real_time, in_time, torque_since_enable, woken_as
from tools import command
from tsa_ctrl.errors import BusError
from tsa_ctrl.virtual.simulation import simulate_loop

MOST = 1.3
AMPLITUDE, FREQUENCY = 1.0, 0.5  # N*m, Hz of the set-point in `files`


def error(truth: Any) -> float:
    """RMS of delivered less wanted torque, mN*m, from the end of the fade-in to the stop."""
    wanted = AMPLITUDE * np.sin(2.0 * np.pi * FREQUENCY * TIMES)
    return 1e3 * float(np.sqrt(np.mean(np.square(torque_since_enable(truth) - wanted))))


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--rate", type=float, default=1000.0, help="of the loop, Hz (default 1000)")
    parser.add_argument("--loads", nargs="+", choices=sorted(LOADS), default=list(LOADS))
    arguments = parser.parse_args()
    interface = os.environ.get("TSA_VCAN", "")
    if not interface:
        parser.error("no vcan: run it as tools/vcan tools/run bench/real_time")
    table = Table("load", "cycles in time", "on the vcan", "virtual, woken alike", "virtual", "first over second")
    worst = 0.0
    for load in arguments.loads:
        with tempfile.TemporaryDirectory(prefix="bench-real-time-") as name:
            paths = files(Path(name), interface, load, arguments.rate)
            try:
                truth, log = in_real_time(Path(name))
            except BusError as found:
                parser.error(f"the machine is too busy to start on the vcan: {found}")
            alike = error(woken_as(log, paths, arguments.rate).truth)
            undisturbed = error(simulate_loop(*paths, SECONDS).truth)
        real, kept = error(truth), in_time(log, arguments.rate)
        worst = max(worst, real / alike)
        table.add_row(load, f"{kept:.0%}", f"{real:.1f}", f"{alike:.1f}", f"{undisturbed:.1f}", f"{real / alike:.2f}")
    Console(width=100).print(table)
    return 0 if worst <= MOST else 1
