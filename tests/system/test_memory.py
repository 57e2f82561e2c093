"""Large arrays go back to the system when they are done with, whatever lies above them."""

from __future__ import annotations

import subprocess
import sys

# Twelve arrays of 16 MB of which every second one is dropped, once glibc has raised its threshold over their size.
PROGRAM = """
import os
import numpy as np
from tsa_ctrl.system.memory import give_back_large

def resident():
    return int(open("/proc/self/statm").read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6

if {given}:
    give_back_large()
np.ones(31 << 17)
before = resident()
kept = [np.ones(1 << 21) for _ in range(12)][1::2]
print(resident() - before)
"""


def _left(given: bool) -> float:
    """MB that are resident for 101 MB of arrays that are still needed."""
    line = [sys.executable, "-c", PROGRAM.format(given=given)]
    return float(subprocess.run(line, check=True, capture_output=True, text=True).stdout)


def test_what_is_dropped_between_two_that_stay_is_given_back() -> None:
    assert _left(given=True) < 110.0 < 180.0 < _left(given=False)
