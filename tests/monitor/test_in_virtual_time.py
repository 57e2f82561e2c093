"""The monitor with the real loop and plant in virtual time."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.monitor.trials import AT, TRIALS, Trial, intruder
from tests.virtual.files import controller, plant, write
from tsa_ctrl import simulate_loop
from tsa_ctrl.virtual.script import Fault


@pytest.mark.parametrize(("name", "watchdogs"), [*((name, False) for name in TRIALS), ("loop killed", True)])
def test_the_torque_is_gone_although_loop_and_drive_do_nothing(name: str, watchdogs: bool, tmp_path: Path) -> None:
    """A drive without watchdogs also ignores NMT stop. The controlword by SDO disables it."""
    finding, spoil, within = TRIALS[name]
    found = Trial(tmp_path, spoil, drive={"watchdogs": watchdogs})
    assert found.stop is not None
    assert found.stop.id == finding, str(found.stop)
    assert 0.0 <= found.late <= within
    assert found.torque(found.late + (0.01 if watchdogs else 0.03)) < 1e-3
    assert found.monitor.report.confirmed


def test_a_motor_that_gives_more_than_it_reports_is_too_fast(tmp_path: Path) -> None:
    found = Trial(tmp_path, faults=(Fault("torque_gain value=3", AT),), load="free", acts=False)
    assert found.stop is not None
    assert found.stop.id in ("motor_speed", "joint_speed", "command_step")


def test_time_frames_are_noticed_and_nothing_is_done(tmp_path: Path) -> None:
    found = Trial(tmp_path, intruder((0x100, bytes(6)), (0x7E5, b"\x5e" + bytes(7))))
    assert found.stop is None
    assert [notice.split(":")[0] for notice in found.monitor.news()] == [
        "TIME frame of another master",
        "LSS frame of another master",
    ]


@pytest.mark.parametrize("load", ["imposed", "held", "free", "spring", "weight", "limb", "wearer"])
def test_a_healthy_rig_is_left_alone(load: str, tmp_path: Path) -> None:
    found = Trial(tmp_path, load=load)
    assert found.stop is None, str(found.stop)
    assert not found.monitor.news()
    assert not found.result.axes[0].faults


def test_a_monitor_that_stopped_is_latched_by_the_loop_and_a_recovery_starts_another(tmp_path: Path) -> None:
    files = write(tmp_path, controller(file={"monitor": {"enabled": True}}), plant(joint={"load": "limb"}))
    result = simulate_loop(*files, 2.4, faults=["repeated_tpdo duration=0.2@0.8"], changes=["recover=1@1.1"])
    (axis,) = result.axes
    assert axis.faults[0].startswith("stopped by the monitor: more than one frame per SYNC")
    assert not any("second master" in fault for fault in axis.faults)
    t, enabled = result.truth["clock"] - axis.start, result.truth["enabled"] > 0.0
    assert enabled[(t > 0.6) & (t < 0.8)].all()
    assert not enabled[(t > 0.85) & (t < 1.1)].any()
    assert enabled[(t > 2.2) & (t < 2.4)].all()
