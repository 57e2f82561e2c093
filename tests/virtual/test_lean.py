"""Run axes with lean drives at 1 kHz on one bus of 1 Mbit/s in virtual time, in which frames take their time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.virtual.files import Tables, controller, merged, plant, write
from tests.virtual.test_two_axes import pair
from tsa_ctrl import simulate_loop
from tsa_ctrl.config import load_configuration
from tsa_ctrl.errors import UsageError
from tsa_ctrl.readiness import missing

LEAN: Tables = {"pdo": "lean", "serial_number": 1}


def two(torque_sensors: bool, **changes: object) -> Tables:
    tables = pair(controller(**merged({"drive": LEAN}, changes)))
    return tables if torque_sensors else tables | {"axis": [merged(a, {"torque_sensor": None}) for a in tables["axis"]]}


@pytest.mark.parametrize("torque_sensors", [False, True])
def test_two_axes_at_1_khz_on_one_bus(tmp_path: Path, torque_sensors: bool) -> None:
    files = write(tmp_path, two(torque_sensors), pair(plant()))
    result = simulate_loop(*files, 2.0)
    assert [event.text for event in result.summary.events if event.fault] == []
    assert (result.summary.skipped, result.summary.planned) == (0, result.summary.sent)
    # the loop does not wait for a sensor that does not answer each SYNC
    assert [(node.missed, node.repeated, node.late) for node in result.summary.nodes] == [(0, 0, 0)] * (
        6 if torque_sensors else 4
    )
    for axis in result.axes:
        log = axis.log
        steady = log["t"] > 1.0
        error = log["omega_m"][steady] - np.interp(
            log["t"][steady], axis.truth["clock"] - axis.start, axis.truth["omega_m"]
        )
        assert np.sqrt(np.mean(error**2)) < 0.1 * np.sqrt(np.mean(axis.truth["omega_m"] ** 2)) + 0.1


def test_one_lean_axis_follows_as_a_standard_one_with_the_same_filter_does(tmp_path: Path) -> None:
    errors = []
    for drive in ({"velocity_source": "position"}, {"pdo": "lean"}):
        files = write(tmp_path, controller(drive=drive), plant())
        (axis,) = simulate_loop(*files, 3.0).axes
        assert not axis.faults
        errors.append(float(np.sqrt(np.mean(axis.error**2))))
    assert errors[1] == pytest.approx(errors[0], rel=0.05)


@pytest.mark.parametrize("fault", ["repeated_tpdo", "missing_tpdo", "stuck_tpdo"])
def test_repeated_missing_and_stuck_frames_end_the_torque(tmp_path: Path, fault: str) -> None:
    """Each of them causes a fault within 0.1 s, and the drive is off 0.4 s later."""
    files = write(tmp_path, controller(drive={"pdo": "lean"}), plant())
    result = simulate_loop(*files, 1.5, faults=[f"{fault} duration=0.4@0.8"])
    first = next(event.t for event in result.summary.events if event.fault)
    assert 0.8 <= first < 0.9
    (axis,) = result.axes
    start = axis.truth["clock"] - axis.start
    assert axis.truth["enabled"][(start > first + 0.4) & (start < 1.5)].max() == 0.0


def test_two_axes_at_1_khz_need_lean_drives_which_class_worn_rejects(tmp_path: Path) -> None:
    path, _ = write(tmp_path, two(False, drive={"pdo": None}))
    with pytest.raises(UsageError, match='choose pdo = "lean"'):
        load_configuration(path)
    path, _ = write(tmp_path, controller(drive={"pdo": "lean"}, file={"safety": {"class": "worn"}}))
    assert any("0x606C with 0x6064" in line for line in missing(load_configuration(path)))
