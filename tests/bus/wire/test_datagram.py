"""Test the bus of local sockets: delivery, lost and returning participants, and rejected use."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager

import pytest

from tsa_ctrl.bus.settings import BusSettings
from tsa_ctrl.bus.wire.datagram import MOST_PARTICIPANTS, DatagramBus
from tsa_ctrl.bus.wire.link import is_simulated, open_bus
from tsa_ctrl.errors import BusError

TORQUE = (0x201, b"\x0f\x00\x01\x02")


@pytest.fixture
def channel() -> str:
    """Return the name of a bus that no other test uses at the same time."""
    return f"test-{os.getpid()}-{time.monotonic_ns()}"


@pytest.fixture
def three(channel: str) -> Iterator[list[DatagramBus]]:
    buses = [DatagramBus(channel) for _ in range(3)]
    yield buses
    for bus in buses:
        bus.close()


def all_frames(bus: DatagramBus) -> list[tuple[int, bytes]]:
    return bus.gather(0.0, 1000)


def test_every_participant_but_the_sender_receives_each_frame_once_and_in_order(three: list[DatagramBus]) -> None:
    frames = [(0x080, b""), TORQUE, (0x7FF, bytes(range(8)))]
    for sender in three:
        for frame in frames:
            assert sender.send(*frame)
        for bus in three:
            assert all_frames(bus) == ([] if bus is sender else frames)
        assert (sender.counters.sent, sender.counters.dropped) == (len(frames), 0)


def test_a_frame_of_a_cycle_ends_the_wait_and_others_do_not(three: list[DatagramBus]) -> None:
    daemon, plant, _ = three
    daemon.listen_for(0x182)
    for can_id in (0x181, 0x182):
        plant.send(can_id, b"\x01")
    began = time.monotonic()
    assert [can_id for can_id, _ in daemon.answers(5.0, 8)] == [0x181, 0x182]
    assert time.monotonic() - began < 1.0
    plant.send(0x181, b"\x01")
    began = time.monotonic()
    assert [can_id for can_id, _ in daemon.answers(0.05, 8)] == [0x181]
    assert time.monotonic() - began >= 0.05


def test_only_accepted_identifiers_arrive(three: list[DatagramBus]) -> None:
    three[1].accept([0x181])
    for can_id in (0x181, 0x182):
        three[0].send(can_id, b"")
    assert all_frames(three[1]) == [(0x181, b"")]
    assert len(all_frames(three[2])) == 2
    three[1].accept(None)
    three[0].send(0x182, b"")
    assert three[1].flush() == 1


PARTICIPANT = """
import sys
from tsa_ctrl.bus.wire.datagram import DatagramBus
bus = DatagramBus(sys.argv[1])
print("ready", flush=True)
while True:
    frame = bus.recv(1.0)
    if frame is not None:
        bus.send(frame[0] + 1, frame[1])
"""


@contextmanager
def participant(channel: str) -> Iterator[subprocess.Popen[str]]:
    """Run a process that answers each frame with the next identifier, and kill it."""
    process = subprocess.Popen([sys.executable, "-c", PARTICIPANT, channel], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def test_a_participant_that_is_killed_leaves_nothing_behind_and_may_return(channel: str) -> None:
    bus = DatagramBus(channel)
    for _ in range(3):
        with participant(channel):
            assert bus.send(*TORQUE)
            assert bus.recv(5.0) == (TORQUE[0] + 1, TORQUE[1])
    assert bus.send(*TORQUE)  # without receivers, as on a bus without other nodes
    assert bus.fault is None
    assert bus.counters.dropped == 0
    bus.close()


def test_a_participant_that_stops_reading_loses_frames_and_the_others_lose_none(channel: str) -> None:
    sender, reader = DatagramBus(channel), DatagramBus(channel)
    with closing(sender), closing(reader), participant(channel) as process:
        process.send_signal(signal.SIGSTOP)
        for number in range(1000):
            assert sender.send(0x100, number.to_bytes(2, "big"))
            assert reader.recv(1.0) == (0x100, number.to_bytes(2, "big"))


def test_a_frame_that_nobody_has_room_for_is_dropped_and_counted(channel: str) -> None:
    sender, hanging = DatagramBus(channel, send_queue=8), DatagramBus(channel)
    results = [sender.send(*TORQUE) for _ in range(100)]
    assert results[:8] == [True] * 8
    assert not results[-1]
    assert sender.counters.dropped == results.count(False)
    assert len(all_frames(hanging)) == results.count(True)
    assert sender.send(*TORQUE)
    sender.close()
    hanging.close()


def test_a_full_bus_is_one_line_and_has_room_again_when_somebody_leaves(channel: str) -> None:
    buses = [DatagramBus(channel) for _ in range(MOST_PARTICIPANTS)]
    with pytest.raises(BusError, match=f"this bus already has {MOST_PARTICIPANTS} participants; stop one") as error:
        DatagramBus(channel)
    assert "\n" not in str(error.value)
    buses.pop(3).close()
    buses.append(DatagramBus(channel))
    buses[-1].send(*TORQUE)
    assert all(all_frames(bus) == [TORQUE] for bus in buses[:-1])
    for bus in buses:
        bus.close()


@pytest.mark.parametrize("name", ["", "../can0", "x" * 65])
def test_a_name_that_is_not_allowed_is_one_line(name: str) -> None:
    with pytest.raises(BusError, match="use 1 to 64 letters, digits") as error:
        DatagramBus(name)
    assert "BusError" not in str(error.value)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_each_user_has_buses_of_his_own(three: list[DatagramBus], channel: str) -> None:
    """For another user the same name is a separate bus, so no frame is exchanged in either direction."""
    code = f"""
import os
from tsa_ctrl.bus.wire.datagram import DatagramBus
os.setuid(65534)
bus = DatagramBus({channel!r})
bus.send(0x080, b"")
print(bus.recv(0.2))
"""
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    while process.poll() is None:
        three[0].send(*TORQUE)
        time.sleep(0.01)
    assert process.communicate()[0] == "None\n"
    assert three[0].recv(0.0) is None


def test_the_configured_interface_opens_it(channel: str) -> None:
    settings = BusSettings(interface="datagram", channel=channel)
    bus = open_bus(settings)
    assert bus.name == f"datagram:{channel}"
    assert bus.fileno() >= 0
    assert is_simulated("datagram", channel)
    bus.close()
    bus.close()
