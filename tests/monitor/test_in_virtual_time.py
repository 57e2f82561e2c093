"""The monitor with the real loop and plant in virtual time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.virtual.files import controller, plant, write
from tsa_ctrl import simulate_loop
from tsa_ctrl.virtual.result import Simulation


def play(folder: Path, seconds: float, load: str = "limb", drive: dict[str, Any] | None = None, **script: Any) -> Any:
    """Run the loop on this load with a monitor."""
    files = write(folder, controller(file={"monitor": {"enabled": True}}), plant(joint={"load": load}, drive=drive))
    return simulate_loop(*files, seconds, **script)


def enabled(result: Simulation, begin: float, end: float) -> Any:
    """Return the rows of the plant's truth between two times of the log, True if the drive was enabled."""
    t = result.truth["clock"] - result.axes[0].start
    return result.truth["enabled"][(t > begin) & (t < end)] > 0.0


@pytest.mark.parametrize(("watchdogs", "within"), [(False, 0.052), (True, 0.022)])
def test_the_torque_is_gone_although_loop_and_drive_do_nothing(watchdogs: bool, within: float, tmp_path: Path) -> None:
    """The loop hangs. A drive without watchdogs also ignores NMT stop, and the controlword by SDO disables it."""
    result = play(tmp_path, 1.2, drive={"watchdogs": watchdogs}, faults=["slow_loop value=0.3@0.8"])
    assert result.axes[0].faults[0].startswith("stopped by the monitor: a frame is missing: axis 'knee'")
    assert enabled(result, 0.6, 0.8).all()
    assert not enabled(result, 0.8 + within, 1.1).any()


@pytest.mark.parametrize("load", ["imposed", "held", "free", "spring", "weight", "limb", "wearer"])
def test_a_healthy_rig_is_left_alone(load: str, tmp_path: Path) -> None:
    result = play(tmp_path, 1.2, load)
    assert not result.axes[0].faults
    assert not [event for event in result.summary.events if "monitor" in event.text]


def test_a_monitor_that_stopped_is_latched_by_the_loop_and_a_recovery_starts_another(tmp_path: Path) -> None:
    result = play(tmp_path, 2.4, faults=["repeated_tpdo duration=0.2@0.8"], changes=["recover=1@1.1"])
    (axis,) = result.axes
    assert axis.faults[0].startswith("stopped by the monitor: more than one frame per SYNC")
    assert not any("second master" in fault for fault in axis.faults)
    assert enabled(result, 0.6, 0.8).all()
    assert not enabled(result, 0.85, 1.1).any()
    assert enabled(result, 2.2, 2.4).all()
