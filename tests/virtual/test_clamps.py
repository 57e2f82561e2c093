"""Startup sets the clamps of a simulated drive by the wearer's limits, and class "worn" may reject its nodes."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tests.virtual.files import controller, plant, write
from tsa_ctrl.config import load_configuration
from tsa_ctrl.daemon.lifecycle import Lifecycle
from tsa_ctrl.errors import UsageError
from tsa_ctrl.plant.process import check
from tsa_ctrl.readiness import Nodes
from tsa_ctrl.virtual.simulation import Run, simulate_loop


@pytest.mark.parametrize("speed", [4.0, 6.4])
@pytest.mark.parametrize("gear", [1.0, 5.0])
def test_the_drive_holds_the_limits_of_the_wearer(tmp_path: Path, speed: float, gear: float) -> None:
    """0x6072 is limits.torque in per mille. 0x6080 is r_J/r_M times the joint's over-speed, in rpm of the motor."""
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


@pytest.mark.parametrize(("absent", "has_inputs"), [([], True), ([0x60FD], False)])
def test_what_a_bring_up_found_is_judged_before_any_drive_is_enabled(
    tmp_path: Path, absent: list[int], has_inputs: bool
) -> None:
    """The check covers the serial numbers of the nodes, and the digital inputs of a drive (0x60FD)."""
    paths = write(tmp_path, None, plant(drive={"serial_number": 7, "absent": absent}))
    run = Run(load_configuration(paths[0]), check(paths[1]), 0.3)
    seen: list[tuple[int, bool]] = []

    def admit(nodes: Nodes, inputs: bool) -> None:
        seen.append((nodes["knee"]["drive"].serial_number, inputs))
        raise UsageError("not ready")

    run.machine.start()
    lifecycle = Lifecycle(load_configuration(paths[0]), run.rig, run.axes, run.loop, simulated=True, admit=admit)
    try:
        with pytest.raises(UsageError, match="not ready"):
            lifecycle.run(0.3)
        assert seen == [(7, has_inputs)]
        assert not run.rig.has_commanded
    finally:
        run.close()


def test_a_simulated_run_reports_a_torque_limit_of_the_drive(tmp_path: Path) -> None:
    """The drive limits negative torque to 0. A bring-up of `tsa run` prints the same note."""
    paths = write(tmp_path, None, plant(drive={"objects": {"0x60E1:0": 0}}))
    notes = simulate_loop(*paths[:2], 0.1).notes
    assert any("negative torque limit (0x60E1) is 0 per mille" in note for note in notes)
