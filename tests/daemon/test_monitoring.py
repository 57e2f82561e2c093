"""Test that the loop latches a stop by its monitor and ramps the torque to zero if the monitor fails."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.daemon.machine import Machine
from tsa_ctrl.config import load_configuration
from tsa_ctrl.daemon.monitor_process import Report
from tsa_ctrl.daemon.monitoring import MonitorState, SecondChannel, monitor_line, watched_of
from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc.report import MONITOR
from tsa_ctrl.monitor.watched import Stop
from tsa_ctrl.safety.causes import Cause, Finding

CONFIG = Path(__file__).resolve().parents[2] / "config" / "controller.toml"
STOP = Stop("joint_speed", "joint too fast", "axis 'knee': 13.0 rad/s, the limit is 12 rad/s", 1.0)


class FakeMonitor:
    """A monitor that reports the findings set by the test."""

    def __init__(self) -> None:
        self.report = Report()
        self.failed: Finding | None = None
        self.closed = False

    def fault(self, now: float) -> Finding | None:
        return Finding(Cause.MONITOR_STOPPED, str(self.report.stop)) if self.report.stop else self.failed

    def news(self) -> list[str]:
        return []

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path, ("# stop_time = 0.3 ", "stop_time = 0.1 "))


def run(machine: Machine, act: Callable[[FakeMonitor], None]) -> FakeMonitor:
    """Run `act` on the monitor at SYNC 400 and stop the loop at SYNC 600."""
    monitor = FakeMonitor()
    machine.loop.attach(SecondChannel(lambda: monitor))
    machine.drive.at_sync[400] = lambda: act(monitor)
    machine.drive.at_sync[600] = lambda: machine.loop.stop("the test")
    machine.run()
    return monitor


def test_what_the_monitor_stopped_for_is_latched_and_takes_the_torque_at_once(machine: Machine) -> None:
    run(machine, lambda monitor: setattr(monitor, "report", Report(STOP)))
    assert machine.events.faults[0].text == f"stopped by the monitor: {STOP}"
    assert any(machine.drive.torques[380:400])
    assert not any(machine.drive.torques[403:])


def test_a_monitor_that_fails_ramps_the_torque_to_zero_and_latches(machine: Machine) -> None:
    run(machine, lambda monitor: setattr(monitor, "failed", Finding(Cause.MONITOR_ENDED, "x")))
    fault = machine.events.faults[0]
    assert (fault.text, fault.cause_id) == ("monitor ended: x", "monitor_ended")
    sizes = [abs(torque) for torque in machine.drive.torques]
    assert all(sizes[405:450])
    assert not any(sizes[510:])


def test_a_monitor_that_fails_before_the_torque_ends_the_start(machine: Machine) -> None:
    monitor = FakeMonitor()
    monitor.failed = Finding(Cause.MONITOR_SILENT, "no sign of life for 0.5 s")
    machine.loop.attach(SecondChannel(lambda: monitor))
    machine.run()
    assert machine.loop.cause is not None
    assert machine.loop.cause.startswith("fault: monitor silent: no sign of life")
    assert not any(machine.drive.torques)


def test_without_a_monitor_nothing_is_asked() -> None:
    channel = SecondChannel()
    found = (channel.state, channel.fault(0.0), channel.acted(0.0), channel.news())
    assert found == (MonitorState.OFF, None, False, [])
    assert tuple(state.name.lower() for state in MonitorState) == MONITOR


def test_the_limits_are_those_of_the_axis(tmp_path: Path) -> None:
    machine = Machine(tmp_path, ("# travel = [-2.0, 2.0]           # rad of", "travel = [-1.0, 1.2]  # rad of"))
    watched = watched_of(machine.configuration)
    (axis,) = watched.axes
    assert (axis.torque, axis.torque_rate, axis.over_speed, axis.motor_over_speed) == (2.0, 200.0, 12.0, 20.0)
    assert axis.travel == pytest.approx((-1.1, 1.3))
    assert (axis.silence, watched.host_silence, watched.nodes) == (0.02, 0.1, (1, 32, 64))


def test_the_start_reports_whether_a_monitor_runs(tmp_path: Path) -> None:
    assert monitor_line(load_configuration(CONFIG)).startswith("monitor: off; ")
    machine = Machine(tmp_path, ("# enabled = false ", "enabled = true "))
    assert monitor_line(machine.configuration).startswith("monitor: watches vcan0; it acts by NMT stop")


def test_an_unknown_key_of_the_section_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="output"):
        Machine(tmp_path, ("# output = {", 'output = { relay = "x" }  # {'))
