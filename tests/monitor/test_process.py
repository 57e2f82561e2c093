"""The process of the monitor on its own bus, and its termination. tests/system tests its output."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest

from tests.monitor.healthy import HEARTBEAT, MOTION, RPDO, SYNC, watched
from tests.sensors.lines import wait_for
from tsa_ctrl.bus.settings import BusSettings
from tsa_ctrl.bus.wire.link import open_bus
from tsa_ctrl.daemon.monitor_process import Given, MonitorProcess
from tsa_ctrl.errors import UsageError
from tsa_ctrl.monitor.watched import Frame
from tsa_ctrl.safety.causes import Cause, Finding
from tsa_ctrl.system.torque_off import OutputSettings

pytestmark = pytest.mark.hil
GROUP = f"239.174.{os.getpid() >> 8 & 0xFF}.{os.getpid() & 0xFF}"
ON, OFF = bytes.fromhex("3712000000000000"), bytes.fromhex("3112000000000000")  # first TPDO of the drive
STOP, ASK = (0x000, b"\x02\x01"), (0x601, bytes.fromhex("4041600000000000"))


def given(output: OutputSettings | None = None, interface: str = "udp_multicast", channel: str = GROUP) -> Given:
    return Given(
        watched=watched(encoder_id=None, silence=1.0, nodes=(1,)),
        interface=interface,
        channel=channel,
        bitrate=1_000_000,
        options={},
        output=output,
        priority=1,
    )


class Bus:
    """The other end of the bus. The test sends the frames of a loop and a drive."""

    def __init__(self, interface: str, channel: str) -> None:
        self._bus = open_bus(BusSettings(interface=interface, channel=channel))
        self.heard: list[Frame] = []

    def send(self, *frames: Frame) -> None:
        for frame in frames:
            self._bus.send(*frame)

    def enable(self) -> None:
        """Send the frames of an enabled drive and a command."""
        self.send((HEARTBEAT, b"\x05"), (SYNC, b""), (MOTION, ON), (RPDO, b"\x0f\x00\x00\x00"))

    def until(self, condition: Callable[[], bool]) -> None:
        def listen() -> None:
            while (frame := self._bus.recv(0.001)) is not None:
                self.heard.append(frame)

        wait_for(condition, listen)

    def close(self) -> None:
        self._bus.close()


@pytest.fixture
def place(request: pytest.FixtureRequest) -> tuple[str, str]:
    """Return interface and channel of the bus."""
    return getattr(request, "param", ("udp_multicast", GROUP))


@pytest.fixture
def bus(place: tuple[str, str]) -> Iterator[Bus]:
    made = Bus(*place)
    yield made
    made.close()


@pytest.fixture
def monitor(place: tuple[str, str], tmp_path: Path) -> Iterator[MonitorProcess]:
    made = MonitorProcess(given(OutputSettings(command=("touch", str(tmp_path / "off"))), *place))
    yield made
    with contextlib.suppress(ProcessLookupError):
        os.kill(made.pid, signal.SIGCONT)
    made.close()


def faulty(monitor: MonitorProcess) -> Callable[[], bool]:
    return lambda: monitor.fault(time.monotonic()) is not None


@pytest.mark.parametrize(
    "place", [("udp_multicast", GROUP), ("datagram", f"monitor-{os.getpid()}")], ids=["network", "local"], indirect=True
)
def test_a_wrong_command_is_answered_until_the_drive_confirms(
    bus: Bus, monitor: MonitorProcess, tmp_path: Path
) -> None:
    bus.enable()
    bus.send((RPDO, b"\x0f\x00\x00\x0f"))
    bus.until(lambda: bus.heard.count(STOP) >= 2 and ASK in bus.heard)
    assert monitor.fault(time.monotonic()) == Finding(
        Cause.MONITOR_STOPPED, "commanded torque above the limit: axis 'knee': 3.84 N*m, the limit is 2 N*m"
    )
    assert not monitor.report.confirmed
    bus.send((0x581, bytes.fromhex("4b41600031120000")))
    bus.until(lambda: faulty(monitor)() and monitor.report.confirmed)
    assert bus.heard[0] == STOP
    assert (tmp_path / "off").exists()


def test_it_outlives_a_daemon_that_dies_until_the_torque_is_gone(bus: Bus, monitor: MonitorProcess) -> None:
    bus.enable()
    assert monitor._child.stdin is not None
    bus.until(lambda: _armed(bus, monitor))
    monitor._child.stdin.close()
    bus.until(lambda: STOP in bus.heard and ASK in bus.heard)
    assert monitor.fault(time.monotonic()) == Finding(
        Cause.MONITOR_STOPPED, "the daemon ended while torque was on: its pipe is closed"
    )
    assert monitor._child.poll() is None
    bus.send((0x581, bytes.fromhex("4b41600031120000")))
    wait_for(lambda: monitor._child.poll() == 0)


def _armed(bus: Bus, monitor: MonitorProcess) -> bool:
    """Send a frame that causes a notice while torque is on. Return True if there is one."""
    bus.send((0x100, bytes(6)))
    monitor.fault(time.monotonic())
    return bool(monitor.report.notices)


def test_it_ends_with_the_daemon_when_no_torque_is_on(bus: Bus, monitor: MonitorProcess) -> None:
    bus.send((MOTION, OFF))
    monitor.close()
    assert monitor._child.returncode == 0
    assert STOP not in bus.heard


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGTSTP])
def test_no_signal_of_a_terminal_or_a_service_manager_ends_it(number: signal.Signals, monitor: MonitorProcess) -> None:
    os.kill(monitor.pid, number)
    heard = monitor._board.heard
    wait_for(lambda: monitor._board.heard > heard)
    assert monitor.fault(time.monotonic()) is None


@pytest.mark.parametrize(
    ("number", "cause"), [(signal.SIGKILL, Cause.MONITOR_ENDED), (signal.SIGSTOP, Cause.MONITOR_SILENT)]
)
def test_a_monitor_that_is_gone_or_hangs_is_a_fault(
    number: signal.Signals, cause: Cause, monitor: MonitorProcess
) -> None:
    os.kill(monitor.pid, number)
    wait_for(faulty(monitor))
    found = monitor.fault(time.monotonic())
    assert found is not None
    assert found.cause is cause
    if number is signal.SIGSTOP:
        monitor.close()
        assert monitor._child.returncode == -signal.SIGKILL
    else:
        assert monitor._child.poll() == -signal.SIGKILL


def test_a_monitor_that_cannot_hear_its_bus_is_refused_in_one_line() -> None:
    with pytest.raises(UsageError, match=r"^\[monitor\] bus 'no_such_can': "):
        MonitorProcess(given(interface="socketcan", channel="no_such_can"))


def test_an_output_that_cannot_be_opened_is_refused_in_one_line() -> None:
    with pytest.raises(UsageError, match=r"\[monitor\] output: \"/dev/no_such_tty\" cannot be opened"):
        MonitorProcess(given(OutputSettings(serial="/dev/no_such_tty")))


def test_what_it_is_given_comes_through_the_pipe_unchanged() -> None:
    sent = given(OutputSettings(serial="/dev/ttyUSB0", line="rts"))
    assert msgspec.json.decode(msgspec.json.encode(sent), type=Given) == sent
