"""Large arrays are returned to the system when they are deleted, even if other arrays remain above them."""

from __future__ import annotations

import subprocess
import sys

# Every second one of twelve arrays of 16 MB is deleted, after glibc has raised its threshold above this size.
# The remaining six need 101 MB. Without the call all twelve stay, with 201 MB, for most patterns of heap growth.
PROGRAM = """
import os
import numpy as np
from tsa_ctrl.cli.diagnose import give_back_large

def resident():
    return int(open("/proc/self/statm").read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6

give_back_large()
np.ones(31 << 17)
before = resident()
kept = [np.ones(1 << 21) for _ in range(12)][1::2]
print(resident() - before)
"""


def test_what_is_dropped_between_two_that_stay_is_given_back() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], check=True, capture_output=True, text=True)
    assert float(done.stdout) < 110.0  # MB
