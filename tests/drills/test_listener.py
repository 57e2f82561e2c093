"""Test the listener on a bus in memory: receiving, sending SYNC, polling silent drives, and switching off."""

from __future__ import annotations

import shutil
import struct
from pathlib import Path

import pytest

from tests.bus.fake import FakeBus
from tsa_ctrl.config import load_configuration
from tsa_ctrl.drills.listener import Listener

CONFIG = Path(__file__).resolve().parents[2] / "config"


def tpdo(torque: int) -> tuple[int, bytes]:
    return 0x181, struct.pack("<Hhi", 0x1237, torque, 0)


class Bench:
    def __init__(self, folder: Path) -> None:
        for name in ("controller.toml", "actuator.toml"):
            shutil.copy(CONFIG / name, folder)
        self.bus = FakeBus()
        self.listener = Listener(load_configuration(folder / "controller.toml"), self.bus, self.bus.clock)

    def hear(self, *frames: tuple[int, bytes]) -> None:
        for frame in frames:
            self.bus.waiting.append(frame)
            self.listener.step(0.0)

    def wait(self, seconds: float) -> list[int]:
        """Receive nothing; return the identifiers of the frames sent meanwhile."""
        before, end = len(self.bus.sent), self.bus.clock.now + seconds
        while self.bus.clock.now < end:
            self.listener.step(0.0005)
        return [can_id for can_id, _ in self.bus.sent[before:]]


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def test_without_guard_it_only_listens(bench: Bench) -> None:
    bench.hear((0x080, b""), tpdo(100))
    assert bench.wait(0.1) == []
    assert bench.listener.torques() == {"knee": pytest.approx(0.1)}


def test_on_guard_it_sends_no_sync(bench: Bench) -> None:
    """In guard mode the listener sends no SYNC within 0.1 s.

    The watchdogs of some drives act only on SYNC, and a dead loop sends none.
    """
    bench.hear(tpdo(100))
    bench.listener.guard()
    assert 0x080 not in bench.wait(0.1)


def test_a_drive_without_tpdos_is_asked_and_its_answer_kept(bench: Bench) -> None:
    bench.listener.guard()
    bench.hear(tpdo(100))
    bench.wait(0.012)
    assert (0x601, bytes.fromhex("4077600000000000")) in bench.bus.sent
    bench.hear((0x581, bytes.fromhex("4b77600005000000")))
    assert [(s.torque, s.source) for s in bench.listener.quiet()[0]] == [
        (pytest.approx(0.1), "tpdo"), (pytest.approx(0.005), "sdo"),
    ]  # fmt: skip


def test_other_answers_are_not_taken_for_torque(bench: Bench) -> None:
    bench.listener.guard()
    bench.hear((0x581, bytes.fromhex("4b41600037120000")), (0x581, bytes.fromhex("8077600000000206")), (0x181, b"x"))
    assert bench.listener.quiet() == ([], [])


def test_a_drive_that_still_has_torque_at_the_end_is_switched_off(bench: Bench) -> None:
    bench.listener.guard()
    bench.hear(tpdo(15))
    bench.listener.quiet()
    assert bench.bus.sent == []
    bench.listener.guard()
    bench.hear(tpdo(100))
    bench.listener.quiet()
    sent = bench.bus.sent
    assert (0x201, bytes(4)) in sent
    assert (0x601, bytes.fromhex("2b40600000000000")) in sent
    assert (0x000, b"\x02\x01") in sent


def test_the_emcys_of_a_drive_are_kept_with_their_time(bench: Bench) -> None:
    bench.listener.guard()
    bench.bus.clock.now += 0.1
    bench.hear((0x081, bytes.fromhex("5082100000000000")), (0x081, bytes(8)))
    assert [(said.node, said.code) for said in bench.listener.quiet()[1]] == [(1, 0x8250)]


def test_the_time_outs_that_a_drive_holds_are_read(bench: Bench) -> None:
    answers = {
        (0x1400, 5): "4b00140514000000",
        (0x1016, 1): "4316100164007f00",
        (0x1016, 2): "4316100200000000",
        (0x100C, 0): "4b0c100000000000",
        (0x100D, 0): "8000100011000906",
    }

    def answer(frame: tuple[int, bytes]) -> list[tuple[int, bytes]]:
        key = struct.unpack_from("<HB", frame[1], 1)
        text = answers.get((key[0], key[1]), "8016100311000906")
        return [(0x581, bytes.fromhex(text))] if frame[0] == 0x601 else []

    bench.bus.answer = answer
    assert bench.listener.armed() == {"knee": {"rpdo": 20, "heartbeat": 100}}
