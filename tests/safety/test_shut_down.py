"""Shutdown at the end of every run."""

from __future__ import annotations

import pytest

from tests.bus.fake import FakeBus
from tests.bus.nodes import Responder, one_axis_rig
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.bus.wire.bus import BusFault, Frame
from tsa_ctrl.safety.shut_down import shut_down


class ObedientDrive(Responder):
    """A drive that follows the controlword. `stuck` keeps it enabled."""

    def __init__(self, stuck: bool = False) -> None:
        super().__init__()
        self.stuck = stuck

    def __call__(self, frame: Frame) -> list[Frame]:
        if frame[0] == 0x201 and not self.stuck:
            word = frame[1][0]
            self.statusword = {0x06: 0x0231, 0x00: 0x0250}[word]
        return list(super().__call__(frame))


def stop(drive: Responder, timeout: float = 0.05) -> tuple[list[str], Rig, FakeBus]:
    rig, bus, _ = one_axis_rig(drive)
    return shut_down(rig, 0.001, timeout), rig, bus


def test_drive_is_shut_down_disabled_and_left_pre_operational() -> None:
    """Exactly three commands follow the confirmation, and no torque is ever sent."""
    unconfirmed, _, bus = stop(ObedientDrive())
    assert unconfirmed == []
    commands = [data for can_id, data in bus.sent if can_id == 0x201]
    assert commands == [bytes([word, 0, 0, 0]) for word in (0x06, 0x00, 0x00, 0x00, 0x00)]
    assert [data for can_id, data in bus.sent if can_id == 0x000] == [b"\x80\x01", b"\x80\x20", b"\x80\x40"]


def test_drive_that_does_not_confirm_is_named() -> None:
    unconfirmed, _, bus = stop(ObedientDrive(stuck=True))
    assert unconfirmed == [
        "axis 'knee': the drive did not confirm that it is off (its last state was operation_enabled); cut its power"
    ]
    commands = [data for can_id, data in bus.sent if can_id == 0x000]
    assert commands == [b"\x02\x01", b"\x80\x20", b"\x80\x40"]  # it may act according to its object 0x6007


def test_failed_bus_ends_it_at_once_with_the_reason() -> None:
    rig, bus, _ = one_axis_rig()
    bus.fault = BusFault.INTERFACE_DOWN
    bus.full = True
    begin = bus.clock.now
    assert shut_down(rig, 0.001, 10.0) == [
        "axis 'knee': the drive did not confirm that it is off (the interface is down); cut its power"
    ]
    assert bus.clock.now - begin < 4 * 0.001


def test_twice_is_as_good_as_once() -> None:
    rig, _, _ = one_axis_rig(ObedientDrive())
    assert shut_down(rig, 0.001) == shut_down(rig, 0.001) == []


@pytest.mark.parametrize("statusword", [0x0218, 0x0200, 0x0250])
def test_fault_not_ready_and_disabled_are_off(statusword: int) -> None:
    drive = ObedientDrive(stuck=True)
    drive.statusword = statusword
    assert stop(drive)[0] == []


def test_drive_has_a_second_to_confirm() -> None:
    rig, bus, _ = one_axis_rig(ObedientDrive(stuck=True))
    begin = bus.clock.now
    assert shut_down(rig, 0.01)
    assert 1.0 <= bus.clock.now - begin < 1.0 + 6 * 0.01


class Silent(Responder):
    """Nodes that answer nothing and record the time of each frame."""

    def __init__(self) -> None:
        super().__init__()
        self.bus: FakeBus | None = None
        self.times: dict[int, list[float]] = {}

    def __call__(self, frame: Frame) -> list[Frame]:
        if self.bus is not None:
            self.times.setdefault(frame[0], []).append(self.bus.clock.now)
        return []


def test_answers_are_waited_for_until_four_fifths_of_the_period() -> None:
    """Then the commands are sent nevertheless, and SYNC keeps its period."""
    nodes = Silent()
    rig, nodes.bus, _ = one_axis_rig(nodes)
    begin = nodes.bus.clock.now
    shut_down(rig, 0.01, 0.05)
    syncs, commands = nodes.times[0x080], nodes.times[0x201]
    assert syncs == pytest.approx([begin + 0.01 * n for n in range(1, len(syncs) + 1)], abs=1e-9)
    assert [b - a for a, b in zip(syncs, commands, strict=True)] == pytest.approx([0.008] * len(syncs), abs=1e-9)


def test_heartbeat_goes_on_until_the_end() -> None:
    """Nodes that monitor this heartbeat detect no loss during the shutdown: one is sent every 20 ms."""
    _, _, bus = stop(ObedientDrive(stuck=True), timeout=0.1)
    assert sum(can_id == 0x77F for can_id, _ in bus.sent) in (6, 7, 8)
