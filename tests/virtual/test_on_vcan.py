"""Virtual time against real time: the same files on a vcan and in lockstep, torques compared sample by sample.

What the processes on the bus delivered, the lockstep run must deliver that is woken when they were (`real_time`).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.virtual.real_time import TRIES, files, in_real_time, in_time, torque_since_enable, woken_as
from tsa_ctrl.errors import BusError

pytestmark = [pytest.mark.vcan, pytest.mark.hil, pytest.mark.slow]

RATE = 250.0  # Hz: the vcan of a guest shares one processor
KEPT = 0.98  # of the cycles in time; with more stalls it is run again: what is lost within a cycle is not replayed


@pytest.mark.parametrize("load", ["spring", pytest.param("imposed", marks=pytest.mark.soak)])
def test_real_time_agrees_with_virtual_time(tmp_path: Path, vcan: str, load: str) -> None:
    paths = files(tmp_path, vcan, load, RATE)
    for _ in range(TRIES):
        try:
            truth, log = in_real_time(tmp_path)
        except BusError as error:
            pytest.skip(f"the machine is too busy to start on the vcan: {error}")
        kept = in_time(log, RATE)
        if kept > KEPT:
            break
    real, virtual = torque_since_enable(truth), torque_since_enable(woken_as(log, paths, RATE).truth)
    difference = np.abs(real - virtual)
    rms = float(np.sqrt(np.mean(np.square(difference))))
    print(
        f"{load}: delivered {1e3 * real.std():.0f} mN*m RMS; real less virtual time: median "
        f"{1e3 * np.median(difference):.2f}, RMS {1e3 * rms:.2f} mN*m; {kept:.0%} of the cycles in time"
    )
    assert real.std() > 0.3
    assert np.median(difference) < 0.03 * real.std()
    assert rms < 0.1 * real.std()
