"""Measure when the monitor finds each fault and when the torque is zero, and the execution time of the monitor.

Usage: tools/run bench/monitor

Virtual time. Each trial runs on a limb, with a drive that reacts to NMT stop and with one that does not.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from tests.monitor.healthy import Sound, frames, watched
from tests.monitor.trials import TRIALS, Trial
from tools import command
from tsa_ctrl.monitor.watch import Monitor

LONGEST = 100  # ms after the finding, for which torque is looked for
NONE = 1e-3  # N*m


def cost() -> tuple[float, float]:
    """Return microseconds per frame and per cycle of one axis; the best of five."""
    given = list(frames(Sound(), 2.0))
    best = float("inf")
    for _ in range(5):
        monitor = Monitor(watched())
        begin = time.perf_counter()
        for frame, now in given:
            monitor.step(frame, now)
        best = min(best, time.perf_counter() - begin)
    return 1e6 * best / len(given), 1e6 * best / 2000


def gone(trial: Trial) -> str:
    """Return when the torque is gone, ms after the fault."""
    found = [ms for ms in range(LONGEST) if trial.torque(trial.late + 1e-3 * ms) < NONE]
    return f"{1e3 * trial.late + found[0]:.0f}" if found else "never"


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.parse_args()
    rows = []
    for name, (_, spoil, _) in TRIALS.items():
        found = []
        for watchdogs in (True, False):
            with tempfile.TemporaryDirectory(prefix="bench-monitor-") as folder:
                found.append(Trial(Path(folder), spoil, True, 1.2, drive={"watchdogs": watchdogs}))
        stop = found[0].stop
        row = ("", "") if stop is None else (stop.id, f"{1e3 * found[0].late:.1f}")
        rows.append((name, *row, *(gone(trial) for trial in found)))
    command.print_table(("fault", "found", "after (ms)", "torque gone (ms)", "drive without reaction (ms)"), rows)
    per_frame, per_cycle = cost()
    print(f"step: {per_frame:.1f} us per frame, {per_cycle:.0f} us per cycle of one axis")
    return 0
