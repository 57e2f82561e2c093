"""A process that only sleeps to absolute deadlines and writes down how late it woke up.

Arguments: RATE FILE; runs until its stdin closes, then writes deadline and lateness (s) as .npy.
It does nothing else at the highest priority that it gets: when it is late, the machine was.
"""

from __future__ import annotations

import gc
import os
import select
import sys
import time

import numpy as np

from tsa_ctrl.system.sleep import sleep_until

PRIORITY = 95
CHECK = 400  # sleeps between looks at stdin
MOST = 2_000_000


def main() -> int:
    """Sleep and note until stdin closes."""
    rate, path = float(sys.argv[1]), sys.argv[2]
    deadlines, lateness = np.zeros(MOST), np.zeros(MOST)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        print("no real-time scheduling", file=sys.stderr)
    gc.collect()
    gc.freeze()
    gc.disable()
    os.write(1, b"ready\n")
    period = round(1e9 / rate)
    deadline = time.monotonic_ns() + period
    count = 0
    while count < MOST:
        sleep_until(deadline)
        now = time.monotonic_ns()
        deadlines[count], lateness[count] = deadline * 1e-9, (now - deadline) * 1e-9
        count += 1
        deadline += period * max(1, -(-(now - deadline) // period))
        if count % CHECK == 0 and select.select([0], [], [], 0.0)[0]:
            break
    np.save(path, np.stack([deadlines[:count], lateness[:count]]))
    return 0
