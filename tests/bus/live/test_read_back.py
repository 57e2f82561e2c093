"""Test the read-back of written values from the nodes in spare bus time. A single deviating answer is not a fault."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Callable

import pytest

from tsa_ctrl.bus.canopen.objects import Object, Type
from tsa_ctrl.bus.drive.checks import NodeReport, Report, Row
from tsa_ctrl.bus.live.read_back import CommandReadback, Held, ReadBack, ReadTarget, held_by

TIMER, CLAMP = Object(0x1400, 5, Type.U16, "RPDO event timer"), Object(0x6072, 0, Type.U16, "max torque")
HELD = (Held(1, TIMER, 20), Held(1, CLAMP, 3000))


class Node:
    """Node 1, which answers a request when the test calls `answer`. Frames are literal bytes."""

    def __init__(self, bitrate: int = 1_000_000) -> None:
        self.asked: list[tuple[float, int, bytes]] = []
        self.holds = {(0x1400, 5): 20, (0x6072, 0): 3000}
        self.now = 0.0
        self.reader = ReadBack(self, bitrate, HELD)  # type: ignore[arg-type]
        self.abort = False

    def send(self, can_id: int, data: bytes) -> bool:
        self.asked.append((self.now, can_id, data))
        return True

    def answer(self, change: Callable[[bytes], bytes] = lambda data: data) -> bool:
        command, index, subindex = struct.unpack_from("<BHB", self.asked[-1][2])
        assert command == 0x40
        data = struct.pack("<BHBHxx", 0x4B, index, subindex, self.holds[index, subindex])
        if self.abort:
            data = struct.pack("<BHBI", 0x80, index, subindex, 0x06020000)
        return self.reader.answer(1, change(data))

    def run(self, seconds: float) -> float | None:
        """Run cycles of 1 ms and answer each request at once. Return the time until a change is found (s), or None."""
        start = self.now
        while self.now < start + seconds:
            count = len(self.asked)
            self.reader.update(self.now)
            if len(self.asked) > count and self.answer():
                return self.now - start
            self.now += 1e-3
        return None


def test_every_object_is_asked_for_in_turn_and_one_every_20_ms() -> None:
    node = Node()
    assert node.run(1.0) is None
    assert 45 <= len(node.asked) <= 50
    assert {can_id for _, can_id, _ in node.asked} == {0x601}
    assert [data[1:4] for _, _, data in node.asked[:4]] == [b"\x00\x14\x05", b"\x72\x60\x00"] * 2


def test_a_torque_offset_is_asked_for_after_every_four_others() -> None:
    offset = Held(1, Object(0x60B2, 0, Type.I16, "torque offset"), 0)
    others = [Held(1, Object(0x2000 + number, 0, Type.U16, "another"), 0) for number in range(50)]
    asked: list[int] = []
    reader = ReadBack(Node(), 1_000_000, [*others, offset])  # type: ignore[arg-type]
    reader._send = lambda can_id, data: asked.append(*struct.unpack_from("<H", data, 1)) is None
    for cycle in range(2000):
        reader.update(1e-3 * cycle)
        index = asked[-1]
        reader.answer(1, struct.pack("<BHBI", 0x4B, index, 0, 0))
    places = [place for place, index in enumerate(asked) if index == 0x60B2]
    assert {later - earlier for earlier, later in itertools.pairwise(places)} == {5}
    assert set(asked) == {0x60B2, *range(0x2000, 0x2032)}


def test_a_slow_bus_is_asked_more_seldom() -> None:
    node = Node(bitrate=250_000)
    node.run(1.0)
    assert len(node.asked) == pytest.approx(12.5, abs=1)


def test_what_was_changed_is_found_in_the_round_in_which_it_is_asked_for_twice() -> None:
    node = Node()
    node.run(0.5)
    node.holds[0x1400, 5] = 0
    found = node.run(1.0)
    assert found is not None
    assert found < 0.1
    assert node.reader.altered == {1: "0x1400:5 RPDO event timer is 0x0, but was 0x14 at startup"}


def test_one_wrong_answer_accuses_nobody() -> None:
    node = Node()
    node.reader.update(0.0)
    assert node.answer(lambda data: data[:4] + b"\x00" * 4) is False
    node.now = 0.02
    assert node.run(2.0) is None


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data[:7],
        lambda data: b"\x4b\x72\x60\x00" + b"\x00" * 4,  # answer for another object
        lambda data: b"\x41" + data[1:],  # segmented transfer, more data than one frame
    ],
)
def test_what_is_no_answer_to_the_question_says_nothing(change: Callable[[bytes], bytes]) -> None:
    node = Node()
    node.holds[0x1400, 5] = 0
    for n in range(5):
        node.reader.update(2.0 * n)
        if node.asked[-1][2][1] == 0x00:
            assert node.answer(change) is False
    assert node.reader.altered == {}


def test_a_node_that_refuses_or_is_silent_is_no_matter() -> None:
    node = Node()
    node.abort = True
    assert node.run(1.0) is None
    for n in range(3000):
        node.now = 10.0 + 1e-3 * n
        node.reader.update(node.now)  # without answers, one request per second, each for the next object
    assert [now for now, _, _ in node.asked if now >= 10.0] == [10.0, 11.0, 12.0]
    indices = [struct.unpack_from("<H", data, 1)[0] for _, _, data in node.asked]
    assert all(one != other for one, other in itertools.pairwise(indices))


def test_what_the_loop_writes_itself_and_what_is_not_there_is_not_asked_for() -> None:
    target, mode = Object(0x6871, 0, Type.I16, "target torque"), Object(0x6060, 0, Type.I8, "mode of operation")
    word = Object(0x6040, 0, Type.U16, "controlword")
    rows = [Row(TIMER, 0, 20), Row(CLAMP, None, None), Row(target, 0, 0), Row(mode, 0, 10), Row(word, 0, 6)]
    assert held_by(Report((NodeReport("drive", 1, rows=rows),))) == (HELD[0],)


def test_the_drives_are_asked_by_turns_what_they_heard_between_the_other_questions() -> None:
    asked: list[tuple[int, int]] = []

    class Drives:
        def send(self, can_id: int, data: bytes) -> bool:
            asked.append((can_id, struct.unpack_from("<H", data, 1)[0]))
            return True

    drives = [ReadTarget(node, Object(0x6071 + 0x800 * place, 0, Type.I16, "target torque"), CommandReadback())
              for place, node in enumerate((1, 2))]  # fmt: skip
    reader = ReadBack(Drives(), 1_000_000, HELD, drives, 0.2)  # type: ignore[arg-type]
    assert [each.readback.too_many for each in drives] == [5, 5]
    for cycle in range(1000):
        count = len(asked)
        reader.update(1e-3 * cycle)
        if len(asked) > count:
            can_id, index = asked[-1]
            digits = 17 if index in (0x6071, 0x6871) else {0x1400: 20, 0x6072: 3000}[index]
            subindex = 5 if index == 0x1400 else 0
            reader.answer(can_id - 0x600, struct.pack("<BHBHxx", 0x4B, index, subindex, digits))
    commands = [each for each in asked if each[1] in (0x6071, 0x6871)]
    assert commands[:4] == [(0x601, 0x6071), (0x602, 0x6871)] * 2
    assert 46 <= len(commands) <= 49
    assert len(asked) - len(commands) == pytest.approx(50, abs=1)
    assert [each.readback.asked for each in drives] == pytest.approx([24, 24], abs=1)
    assert reader.altered == {}
