"""Test raw SocketCAN on a real vcan."""

from __future__ import annotations

import socket
import struct
import subprocess
import threading
import time
from collections.abc import Iterator

import pytest

from tsa_ctrl.bus.settings import BusSettings
from tsa_ctrl.bus.wire.bus import BusFault
from tsa_ctrl.bus.wire.link import open_bus
from tsa_ctrl.bus.wire.socketcan import SocketCan
from tsa_ctrl.errors import BusError


@pytest.fixture
def pair(vcan: str) -> Iterator[tuple[SocketCan, SocketCan]]:
    first, second = SocketCan(vcan), SocketCan(vcan)
    yield first, second
    first.close()
    second.close()


@pytest.mark.vcan
def test_frame_is_the_kernels_can_frame(pair: tuple[SocketCan, SocketCan], vcan: str) -> None:
    raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    raw.bind((vcan,))
    pair[0].send(0x201, b"\x0f\x00\xfa\x00")
    assert raw.recv(16) == struct.pack("=IB3x8s", 0x201, 4, b"\x0f\x00\xfa\x00")
    raw.close()


@pytest.mark.vcan
@pytest.mark.parametrize("data", [b"", b"\x05", bytes(range(8))])
def test_frame_arrives_and_is_not_heard_by_its_sender(pair: tuple[SocketCan, SocketCan], data: bytes) -> None:
    first, second = pair
    assert first.send(0x181, data)
    assert second.recv(1.0) == (0x181, data)
    assert first.recv(0.0) is None


@pytest.mark.vcan
def test_nothing_is_waited_for_its_time_and_not_much_longer(pair: tuple[SocketCan, SocketCan]) -> None:
    waits = []
    for _ in range(50):
        start = time.monotonic()
        assert pair[0].recv(0.0005) is None
        waits.append(time.monotonic() - start)
    assert min(waits) >= 0.0005
    assert min(waits) < 0.005  # the wait is not rounded up to a kernel tick


@pytest.mark.vcan
def test_what_has_come_is_taken_at_once(pair: tuple[SocketCan, SocketCan]) -> None:
    first, second = pair
    frames = [(0x100 + number, bytes(range(number % 9))) for number in range(150)]  # more than one system call
    for frame in frames:
        assert first.send(*frame)
    until = time.monotonic() + 0.01
    assert second.gather(until, 149) == frames[:149]
    assert time.monotonic() >= until
    assert (second.gather(0.0, 9), second.gather(0.0, 9), second.fault) == (frames[149:], [], None)


@pytest.mark.vcan
def test_the_last_answer_is_waited_for_and_brings_the_others(pair: tuple[SocketCan, SocketCan]) -> None:
    first, second = pair
    second.listen_for(0x1C0)
    frames = [(0x181, b"\x01"), (0x281, b""), (0x1C0, bytes(8))]

    def answer() -> None:
        for frame in frames:
            time.sleep(0.05)
            first.send(*frame)

    for _ in range(2):
        thread = threading.Thread(target=answer)
        thread.start()
        found = second.answers(5.0, 9)
        found += second.gather(time.monotonic() + 0.01, 9)
        thread.join()
        assert found == frames
    second.listen_for(0x181)
    start = time.monotonic()
    first.send(*frames[2])
    assert second.answers(0.02, 9) == [frames[2]]
    assert time.monotonic() - start >= 0.02


@pytest.mark.vcan
def test_a_timer_set_before_ends_the_wait_for_answers_once(pair: tuple[SocketCan, SocketCan]) -> None:
    first, second = pair
    second.expect(time.monotonic() - 1.0)  # no effect before `listen_for`
    second.listen_for(0x1C0)
    until = time.monotonic() + 0.05
    second.expect(until)
    assert second.answers(600.0, 9) == []
    assert until <= time.monotonic() < until + 300.0
    first.send(0x1C0, b"")
    second.expect(time.monotonic() + 600.0)  # the answer arrives before this time
    assert second.answers(1200.0, 9) == [(0x1C0, b"")]
    second.gather(0.0, 9)
    second.expect(time.monotonic() - 1.0)
    assert second.answers(600.0, 9) == []  # this time has already passed
    second.expect(time.monotonic() + 600.0)
    assert second.answers(0.01, 9) == []  # the time-out ends the wait first
    start = time.monotonic()
    assert second.answers(0.02, 9) == []  # `expect` applied to the previous wait only
    assert time.monotonic() - start >= 0.02


@pytest.mark.vcan
def test_kernel_keeps_other_identifiers_out(pair: tuple[SocketCan, SocketCan]) -> None:
    first, second = pair
    second.accept([0x181, 0x701])
    for can_id in (0x180, 0x181, 0x581, 0x701):
        first.send(can_id, b"")
    assert [second.recv(1.0), second.recv(1.0), second.recv(0.0)] == [(0x181, b""), (0x701, b""), None]


@pytest.mark.vcan
def test_error_frame_is_received_whatever_is_accepted(pair: tuple[SocketCan, SocketCan], vcan: str) -> None:
    pair[1].accept([0x181])
    raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    raw.bind((vcan,))
    raw.send(struct.pack("=IB3x8s", 0x20000040, 8, bytes(8)))
    assert pair[1].recv(1.0) == (0x20000040, bytes(8))
    raw.close()


@pytest.mark.vcan
def test_missing_interface_is_one_line_with_those_that_are_there(vcan: str) -> None:
    with pytest.raises(BusError, match=rf"channel 'vcan77': no such CAN interface; CAN interfaces here: .*{vcan}"):
        open_bus(BusSettings(channel="vcan77"))


@pytest.fixture
def own_vcan(vcan: str) -> Iterator[str]:
    """Yield a vcan that the test may take down. This requires the same rights as tools/vcan."""
    name = "vcan9"
    made = subprocess.run(["ip", "link", "add", "dev", name, "type", "vcan"], capture_output=True, check=False)
    if made.returncode:
        pytest.skip(f"may not make a vcan: {made.stderr.decode().strip()}")
    subprocess.run(["ip", "link", "set", name, "up"], check=True)
    yield name
    subprocess.run(["ip", "link", "del", name], capture_output=True, check=False)


@pytest.mark.vcan
def test_interface_that_goes_down_is_latched_until_the_fault_of_one_that_is_back_is_cleared(own_vcan: str) -> None:
    bus, other = SocketCan(own_vcan), SocketCan(own_vcan)
    timer = threading.Timer(0.1, subprocess.run, [["ip", "link", "set", own_vcan, "down"]])
    timer.start()
    assert bus.recv(10.0) is None
    timer.join()
    assert not bus.send(0x201, b"")
    assert (bus.counters.dropped, bus.fault) == (1, BusFault.INTERFACE_DOWN)
    subprocess.run(["ip", "link", "set", own_vcan, "up"], check=True)
    assert bus.fault is BusFault.INTERFACE_DOWN
    bus.clear_fault()
    other.recv(0.0)
    assert bus.send(0x201, b"\x01")
    assert (other.recv(1.0), bus.fault) == ((0x201, b"\x01"), None)
    bus.close()
    other.close()


@pytest.mark.vcan
def test_interface_that_is_down_is_refused_with_the_command_that_mends_it(own_vcan: str) -> None:
    subprocess.run(["ip", "link", "set", own_vcan, "down"], check=True)
    with pytest.raises(BusError, match=f"the interface is down; .* ip link set {own_vcan} up"):
        SocketCan(own_vcan)


@pytest.mark.vcan
def test_interface_that_is_gone_is_latched(own_vcan: str) -> None:
    bus = SocketCan(own_vcan)
    subprocess.run(["ip", "link", "del", own_vcan], check=True)
    bus.recv(0.0)
    bus.send(0x201, b"")
    assert bus.fault in (BusFault.INTERFACE_GONE, BusFault.INTERFACE_DOWN)
    bus.close()


def test_kernel_without_can_is_one_line() -> None:
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except (OSError, AttributeError):
        with pytest.raises(BusError, match="this kernel has no SocketCAN"):
            SocketCan("vcan0")
    else:
        pytest.skip("this kernel has CAN")
