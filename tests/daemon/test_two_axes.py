"""Two axes on one bus from one configuration file: each has its own everything, and they stop together."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

from tests.daemon.machine import BARE, CONSTANT, ENABLED, Drive, Machine
from tsa_ctrl.bus.wire.seam import Frame

RATE = ("rate = 1000.0", "rate = 500.0")
SECOND = (
    "[[axis]]",
    """[[axis]]
name = "hip"
model = "actuator.toml"
[axis.drive]
node_id = 2
max_torque = 3.0
[axis.encoder]
node_id = 33
[axis.torque_sensor]
node_id = 65
[axis.setpoint]
kind = "constant"
offset = -0.25
[axis.law]
compensation = 0.0
[axis.limits]
torque = 1.0
[[axis]]""",
)


class Pair(Drive):
    """The nodes of both axes: those of "knee" as ever, those of "hip" one identifier higher."""

    def __init__(self) -> None:
        super().__init__()
        self.hip = Drive()

    def __call__(self, frame: Frame) -> Iterable[Frame]:
        can_id, data = frame
        if can_id == 0x202:
            return self.hip((0x201, data))
        other = [(can + 1, answer) for can, answer in self.hip(frame)] if can_id == 0x080 else []
        return [*super().__call__(frame), *other]


@pytest.fixture
def machine(tmp_path: Path) -> Iterator[Machine]:
    made = Machine(tmp_path, CONSTANT, BARE, RATE, SECOND, drive=Pair())
    yield made
    made.close()


def test_each_axis_follows_its_own_set_point(machine: Machine) -> None:
    """Both enable, and each delivers what its own section of the file wants."""
    machine.run(seconds=1.0)
    pair = machine.drive
    assert isinstance(pair, Pair)
    assert max(pair.torques) == pytest.approx(400, abs=2)
    assert min(pair.hip.torques) == pytest.approx(-200, abs=2)
    assert not machine.events.faults


def test_fault_of_one_ramps_the_other_down(machine: Machine) -> None:
    """The drive that fails is at 0 at once; the other ramps to 0 within the stop time and is disabled."""
    pair = machine.drive
    assert isinstance(pair, Pair)
    pair.hip.at_sync[400] = pair.hip.fail
    machine.run(seconds=1.0)
    assert not any(pair.hip.torques[399:])
    after = [abs(torque) for torque in pair.torques[400:]]
    assert after == sorted(after, reverse=True)
    assert 100 < sum(torque > 0 for torque in after) <= 152
    assert pair.statusword != ENABLED
    assert machine.events.first_fault is not None
    assert machine.events.first_fault.axis == "hip"


def test_command_reaches_its_axis_alone(machine: Machine) -> None:
    """One command per axis and cycle, and the torques of one never appear at the other."""
    pair = machine.drive
    assert isinstance(pair, Pair)
    machine.run(seconds=0.5)
    assert len(pair.commands) == len(pair.hip.commands) == machine.loop.cycles
    assert min(pair.torques) == 0
    assert max(pair.hip.torques) == 0
