"""Test the bytes of CiA 301 frames, the emergency messages and the CAN error frames."""

from __future__ import annotations

import pytest

from tsa_ctrl.bus.canopen import cia301
from tsa_ctrl.bus.canopen.cia301 import Emcy, NmtState
from tsa_ctrl.bus.wire.bus import describe


def test_heartbeat_is_one_byte_both_ways() -> None:
    for state in NmtState:
        assert cia301.heartbeat_state(cia301.heartbeat(state)) == state
    assert cia301.heartbeat(NmtState.OPERATIONAL) == b"\x05"
    assert cia301.heartbeat_state(b"\x85") == NmtState.OPERATIONAL  # bit 7 is the toggle bit of node guarding
    assert [cia301.heartbeat_state(data) for data in (b"", b"\x05\x00")] == [None, None]


def test_emergency_is_code_register_and_vendor_bytes() -> None:
    assert cia301.decode(b"\x10\x32\x05\x01\x02\x03\x04\x05") == Emcy(0x3210, 0x05, b"\x01\x02\x03\x04\x05")
    assert [cia301.decode(bytes(length)) for length in (0, 7, 9)] == [None, None, None]


def test_emergency_reads_as_a_sentence() -> None:
    text = str(Emcy(0x8130, 0x11, b"\x00\x00\x00\x00\x7f"))
    assert text == (
        "EMCY 0x8130 (life guard or heartbeat error; generic+communication error register; vendor 00 00 00 00 7f)"
    )


@pytest.mark.parametrize(
    ("code", "meaning"),
    [
        (0x0000, "error reset or no error"),
        (0x8250, "RPDO time-out"),
        (0x2311, "continuous over-current at the output"),  # the nearest listed code is 0x2310
        (0x2FFF, "current"),
        (0x0001, "error of the generic class"),
    ],
)
def test_unlisted_code_is_named_by_its_class(code: int, meaning: str) -> None:
    assert cia301.text(code) == meaning


@pytest.mark.parametrize(
    ("can_id", "data", "words"),
    [
        (0x20000040, bytes(8), "bus-off"),
        (0x20000004, b"\x00\x30" + bytes(6), "controller problem, receive error passive, transmit error passive"),
        (0x20000020, bytes(8), "no acknowledge: no other node is on the bus"),
        (0x20000200, bytes(8), "error frame 0x00000200"),
    ],
)
def test_error_frames_in_words(can_id: int, data: bytes, words: str) -> None:
    assert describe(can_id, data) == words
