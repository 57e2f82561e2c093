"""Test python-can buses behind the package's bus interface."""

from __future__ import annotations

import os
import select
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import can
import pytest

from tsa_ctrl.bus.drive.session import Session
from tsa_ctrl.bus.settings import BusSettings
from tsa_ctrl.bus.wire import python_can
from tsa_ctrl.bus.wire.bus import BusFault
from tsa_ctrl.bus.wire.link import open_bus
from tsa_ctrl.bus.wire.python_can import PythonCan
from tsa_ctrl.errors import BusError, UsageError


@contextmanager
def opened(interface: str, *channels: str) -> Iterator[list[PythonCan]]:
    buses = [PythonCan(interface, channel, 1_000_000) for channel in channels]
    try:
        yield buses
    finally:
        for bus in buses:
            bus.close()


@pytest.fixture
def pair() -> Iterator[list[PythonCan]]:
    """Yield two ends of a bus in this process."""
    with opened("virtual", "test-pythoncan", "test-pythoncan") as buses:
        yield buses


def test_frame_arrives_as_it_was_sent_and_only_at_the_other_end(pair: list[PythonCan]) -> None:
    first, second = pair
    assert first.send(0x201, b"\x0f\x00\x01\x02")
    assert second.recv(1.0) == (0x201, b"\x0f\x00\x01\x02")
    assert first.recv(0.0) is None
    first.send(0x080, b"")
    assert second.recv(1.0) == (0x080, b"")


def group(number: int) -> str:
    """Return a multicast group that no other run of these tests uses at the same time."""
    return f"239.{74 + number}.{os.getpid() >> 8 & 0xFF}.{os.getpid() & 0xFF}"


def test_own_frames_of_a_multicast_bus_are_left_out_and_those_of_others_are_not() -> None:
    with opened("udp_multicast", group(0), group(0)) as (first, second):
        first.send(0x080, b"")
        second.send(0x080, b"")
        first.send(0x201, b"\x01")
        assert [first.recv(1.0), first.recv(0.1)] == [(0x080, b""), None]
        assert [second.recv(1.0), second.recv(1.0), second.recv(0.1)] == [(0x080, b""), (0x201, b"\x01"), None]


def test_multicast_groups_of_one_machine_do_not_hear_each_other() -> None:
    with opened("udp_multicast", group(1), group(2), group(2)) as (first, second, third):
        second.send(0x201, b"\x01")
        assert third.recv(1.0) == (0x201, b"\x01")
        assert first.recv(0.1) is None


def test_what_another_group_said_while_a_bus_was_opened_is_not_heard(monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame of another group arrives after the socket is opened and before it is restricted to its own group.

    The bus discards this frame.
    """
    told = python_can._hear_own_group_only
    heard_before = []

    def late(descriptor: int) -> None:
        other.send(0x201, b"\x01")
        heard_before.append(select.select([descriptor], [], [], 1.0)[0])
        told(descriptor)

    with opened("udp_multicast", group(3)) as (other,):
        monkeypatch.setattr(python_can, "_hear_own_group_only", late)
        with opened("udp_multicast", group(4)) as (bus,):
            assert heard_before == [[bus.fileno()]]
            assert bus.recv(0.1) is None


def test_other_identifiers_are_kept_out(pair: list[PythonCan]) -> None:
    first, second = pair
    second.accept([0x181])
    for can_id in (0x180, 0x181, 0x581):
        first.send(can_id, b"")
    assert second.recv(1.0) == (0x181, b"")
    assert second.recv(0.0) is None


def test_error_frame_is_flagged() -> None:
    with can.Bus(interface="virtual", channel="test-errors") as other:
        bus = PythonCan("virtual", "test-errors", 1_000_000)
        other.send(can.Message(arbitration_id=0x40, is_error_frame=True, data=bytes(8)))
        assert bus.recv(1.0) == (0x20000040, bytes(8))
        bus.close()


def test_adapter_that_fails_is_latched(pair: list[PythonCan]) -> None:
    first, _ = pair
    first._bus.shutdown()
    assert first.recv(0.0) is None
    assert first.fault is BusFault.ADAPTER


def test_an_unplugged_adapter_closes_without_an_error() -> None:
    """The serial device of slcan accepts no more bytes, not even those that close the channel."""
    bus = PythonCan("slcan", "loop://", 1_000_000)
    while bus.send(0x201, bytes(8)):
        pass
    bus.close()


def test_frame_that_cannot_be_sent_is_dropped_and_counted() -> None:
    bus = PythonCan("virtual", "test-full", 1_000_000)
    other = can.Bus(interface="virtual", channel="test-full", rx_queue_size=1)
    assert [bus.send(0x201, b"") for _ in range(3)] == [True, False, False]
    assert bus.counters.dropped == 2
    other.shutdown()
    bus.close()


@pytest.mark.parametrize(
    ("interface", "channel"),
    [("no_such_interface", "x"), ("slcan", "/dev/no_such_tty"), ("udp_multicast", "10.0.0.1"), ("kvaser", "0")],
)
def test_bus_that_cannot_be_opened_is_one_line(interface: str, channel: str) -> None:
    with pytest.raises(BusError, match=f"interface '{interface}' channel '{channel}': cannot be opened") as error:
        open_bus(BusSettings(interface=interface, channel=channel))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("interface", ["socketcan", "datagram"])
def test_options_that_do_not_apply_are_refused(interface: str) -> None:
    with pytest.raises(UsageError, match=f'options: fd do not apply to interface "{interface}"'):
        open_bus(BusSettings(interface=interface, channel="x", options={"fd": True}))


def test_session_starts_no_thread(pair: list[PythonCan]) -> None:
    before = threading.active_count()
    with Session(pair[0], BusSettings(interface="virtual")):
        assert threading.active_count() == before


def test_session_sends_our_heartbeat_and_ends_with_one(pair: list[PythonCan]) -> None:
    with Session(pair[0], BusSettings(interface="virtual", host_heartbeat_period=0.005)) as session:
        session.begin_heartbeat()
        session.wait(0.05)
    frames = []
    while (frame := pair[1].recv(0.0)) is not None:
        frames.append(frame)
    assert set(frames) == {(0x77F, b"\x05")}
    assert len(frames) > 2


@pytest.mark.parametrize(
    ("interface", "options", "expected"),
    [
        ("slcan", {}, {"timeout": 1e-4, "bitrate": 500_000}),
        ("slcan", {"timeout": 0.01}, {"timeout": 0.01, "bitrate": 500_000}),
        ("socketcand", {"host": "rig"}, {"host": "rig", "tcp_tune": True, "bitrate": 500_000}),
        ("kvaser", {}, {"bitrate": 500_000}),
    ],
)
def test_adapters_are_opened_for_a_fixed_rate(
    interface: str, options: dict[str, object], expected: dict[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bit rate is passed to python-can, and options of the file replace the defaults."""
    opened: list[dict[str, object]] = []
    monkeypatch.setattr(can, "Bus", lambda **arguments: opened.append(arguments))
    PythonCan(interface, "x", 500_000, options)  # type: ignore[arg-type]
    assert opened == [{"interface": interface, "channel": "x", **expected}]
