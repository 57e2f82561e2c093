"""Test the ramp to zero torque after an exception in the loop."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

from tests.bus.fake import FakeClock
from tests.daemon.machine import CONSTANT, Drive, Machine
from tsa_ctrl.bus.wire.bus import Frame
from tsa_ctrl.daemon.lifecycle import ramp_down


class BrokenError(RuntimeError):
    """An exception that represents a programming error in the loop."""


class TimedDrive(Drive):
    """A drive that records the time of each received frame by identifier."""

    def __init__(self) -> None:
        super().__init__()
        self.clock = FakeClock()
        self.times: dict[int, list[float]] = {}

    def __call__(self, frame: Frame) -> Iterable[Frame]:
        self.times.setdefault(frame[0], []).append(self.clock.now)
        return super().__call__(frame)


@pytest.fixture
def drive() -> TimedDrive:
    return TimedDrive()


@pytest.fixture
def machine(tmp_path: Path, drive: TimedDrive) -> Iterator[Machine]:
    made = Machine(tmp_path, CONSTANT, drive=drive)
    drive.clock = made.bus.clock
    yield made
    made.close()


def broken(machine: Machine, at: int = 400) -> float:
    """Make the loop fail in this cycle, in which there is torque, and return the start time of the ramp (s)."""
    machine.drive.at_sync[at] = fail
    with pytest.raises(BrokenError):
        machine.run()
    assert isinstance(machine.drive, TimedDrive)
    machine.drive.times.clear()
    return machine.bus.clock.now


def fail() -> None:
    raise BrokenError


def test_fades_the_last_torque_to_zero(machine: Machine) -> None:
    """After an exception in a cycle, the torque ramps from the last sent value to 0 without the control law."""
    broken(machine)
    before = len(machine.drive.commands)
    last = machine.drive.torques[-1]
    assert last > 300
    ramp_down(machine.rig, machine.axes, 1e-3, 0.1)
    torques = machine.drive.torques[before:]
    assert torques == sorted(torques, reverse=True)
    assert last - 10 <= torques[0] <= last
    assert torques[-1] == 0
    assert len(torques) == 100


def test_a_stop_time_below_one_period_is_one_command_of_zero(machine: Machine) -> None:
    broken(machine)
    before = len(machine.drive.commands)
    ramp_down(machine.rig, machine.axes, 1e-3, 1e-4)
    assert machine.drive.torques[before:] == [0]


def test_an_axis_without_torque_is_not_enabled_on_the_way_down(machine: Machine) -> None:
    """The loop fails before the drive is enabled, and the ramp does not enable it."""
    broken(machine, at=3)
    ramp_down(machine.rig, machine.axes, 1e-3, 0.05)
    assert all(word not in (0x07, 0x0F) for word, _ in machine.drive.commands)


def test_cycles_keep_their_period_and_the_whole_its_time(machine: Machine, drive: TimedDrive) -> None:
    """The ramp sends SYNC on a 1 ms grid. It waits 0.6 ms for a missing answer and tolerates a single one."""
    begin = broken(machine)
    drive.at_sync[drive.beats + 20] = lambda: drive.silent.add(0x181)
    drive.at_sync[drive.beats + 21] = drive.silent.clear
    ramp_down(machine.rig, machine.axes, 1e-3, 0.05)
    syncs, commands = drive.times[0x080], drive.times[0x201]
    assert syncs == pytest.approx([begin + 1e-3 * n for n in range(1, 51)], abs=1e-9)
    assert [round(1e6 * (b - a)) for a, b in zip(syncs, commands, strict=True)] == [0] * 19 + [600] + [0] * 30
    assert all(drive.torques[-50:-1])


def test_a_stall_is_not_slept_off(machine: Machine, drive: TimedDrive) -> None:
    """After a stall of 5.5 ms, the late cycles follow immediately, and the ramp ends at the original time."""
    begin = broken(machine)

    def stall() -> None:
        machine.bus.clock.now += 5.5e-3

    drive.at_sync[drive.beats + 20] = stall
    ramp_down(machine.rig, machine.axes, 1e-3, 0.05)
    assert drive.times[0x201][-1] == pytest.approx(begin + 0.05, abs=1e-9)


def test_a_fault_is_zero_on_the_bus_and_in_the_log(machine: Machine, drive: TimedDrive) -> None:
    """If torque is not permitted, the logged motor torque command is 0 as well."""
    broken(machine)
    before = len(drive.commands)
    drive.fail()
    kept: list[float] = []
    drive.at_sync[drive.beats + 2] = lambda: kept.append(machine.axis.terms.tau_m_cmd)
    assert machine.axis.terms.tau_m_cmd > 0.3
    ramp_down(machine.rig, machine.axes, 1e-3, 0.1)
    assert kept == [0.0]
    assert not any(drive.torques[before:])


def test_joint_that_runs_away_meanwhile_gets_no_torque(machine: Machine, drive: TimedDrive) -> None:
    """The over-speed check also latches during the ramp, and the torque stays 0."""
    broken(machine)
    before = len(drive.commands)

    def run_away() -> None:
        drive.velocity = 10_000_000  # mrpm: 1047 rad/s

    def rest() -> None:
        drive.velocity = 0

    drive.at_sync[drive.beats + 20] = run_away
    drive.at_sync[drive.beats + 22] = rest
    ramp_down(machine.rig, machine.axes, 1e-3, 0.05)
    torques = drive.torques[before:]
    assert all(torques[:18])
    assert not any(torques[20:])
