"""The way down when the loop itself has failed."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.daemon.machine import ENABLED, Machine
from tsa_ctrl.daemon.descent import descend

CONSTANT = ('kind = "sine"  ', 'kind = "constant"\noffset = 0.5  ')


class BrokenError(RuntimeError):
    """What a mistake in the loop raises."""


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Machine]:
    made = Machine(tmp_path, CONSTANT)
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    monkeypatch.setattr(time, "monotonic", made.bus.clock)
    yield made
    made.close()


def fail() -> None:
    raise BrokenError


def test_fades_the_last_torque_to_zero(machine: Machine) -> None:
    """After an exception in a cycle the torque falls from what was last sent to 0, without the law being asked."""
    machine.drive.at_sync[800] = fail
    with pytest.raises(BrokenError):
        machine.run()
    before = len(machine.drive.commands)
    last = machine.drive.torques[-1]
    assert last > 300
    descend(machine.rig, machine.axes, 1e-3, 0.1)
    torques = machine.drive.torques[before:]
    assert torques == sorted(torques, reverse=True)
    assert last - 10 <= torques[0] <= last
    assert torques[-1] == 0
    assert len(torques) == 100


def test_enables_nothing(machine: Machine) -> None:
    """A failure before any torque leaves the drive disabled."""
    descend(machine.rig, machine.axes, 1e-3, 0.05)
    assert not any(machine.drive.torques)
    assert machine.drive.statusword != ENABLED
    assert all(word != 0x0F for word, _ in machine.drive.commands)


def test_stays_at_zero_in_a_fault(machine: Machine) -> None:
    """What the supervisor forbids is not sent on the way down either."""
    machine.drive.at_sync[800] = fail
    with pytest.raises(BrokenError):
        machine.run()
    before = len(machine.drive.commands)
    machine.drive.fail()
    descend(machine.rig, machine.axes, 1e-3, 0.1)
    assert not any(machine.drive.torques[before:])


def test_a_stop_time_below_one_period_is_one_command_of_zero(machine: Machine) -> None:
    """Nothing but the end of the ramp."""
    machine.drive.at_sync[800] = fail
    with pytest.raises(BrokenError):
        machine.run()
    before = len(machine.drive.commands)
    descend(machine.rig, machine.axes, 1e-3, 1e-4)
    assert machine.drive.torques[before:] == [0]


def test_an_axis_without_torque_is_not_enabled_on_the_way_down(machine: Machine) -> None:
    """Also one whose supervisor would take an enable now."""
    machine.drive.at_sync[3] = fail
    with pytest.raises(BrokenError):
        machine.run()
    descend(machine.rig, machine.axes, 1e-3, 0.05)
    assert all(word not in (0x07, 0x0F) for word, _ in machine.drive.commands)
