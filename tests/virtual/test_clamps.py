"""The clamps that a simulated drive holds after the start: its own torque and speed limit follow from the wearer."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tests.virtual.files import controller, plant, write
from tsa_ctrl.config import load_configuration
from tsa_ctrl.plant.process import check
from tsa_ctrl.virtual.simulation import Run


@pytest.mark.parametrize("speed", [4.0, 6.4])
@pytest.mark.parametrize("gear", [1.0, 5.0])
def test_the_drive_holds_the_limits_of_the_wearer(tmp_path: Path, speed: float, gear: float) -> None:
    """0x6072 is limits.torque in per mille, 0x6080 is r_J/r_M times the joint's over-speed in rpm of the motor."""
    tables = controller(
        drive={"gear_ratio": gear, "max_torque": 3.0}, limits={"torque": 0.75}, file={"safety": {"wearer_speed": speed}}
    )
    paths = write(tmp_path, tables, plant(drive={"gear_ratio": gear}))
    run = Run(load_configuration(paths[0]), check(paths[1]), 0.3)
    try:
        result = run.play([], [], lambda share: None)
        values = run.machine.axes[0].drive.values
    finally:
        run.close()
    assert not result.axes[0].faults
    assert values[0x6072, 0] == 750 // gear
    assert values[0x6080, 0] == math.floor(1.5625 * speed * 1.25 * gear * 30.0 / math.pi)
