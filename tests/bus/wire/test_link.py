"""The kernel's answer about an interface, as bytes."""

from __future__ import annotations

import struct

import pytest

from tsa_ctrl.bus.wire import link as interface
from tsa_ctrl.bus.wire.link import CanState, Interface, check, parse
from tsa_ctrl.errors import BusError


def attribute(kind: int, data: bytes) -> bytes:
    raw = struct.pack("=HH", 4 + len(data), kind) + data
    return raw + bytes(-len(raw) % 4)


def answer(kind: bytes = b"can", flags: int = 1, bitrate: int = 500_000, state: int = 0) -> bytes:
    data = (
        attribute(1, struct.pack("=8I", bitrate, 875, 125, 6, 7, 2, 1, 1))
        + attribute(4, struct.pack("=I", state))
        + attribute(8, struct.pack("=HH", 8, 127))
    )
    body = (
        struct.pack("=BxHiII", 0, 280, 3, flags, 0)
        + attribute(3, b"can0\0")
        + attribute(13, struct.pack("=I", 128))
        + attribute(18 | 0x8000, attribute(1, kind + b"\0") + attribute(2 | 0x8000, data))
    )
    return struct.pack("=IHHII", 16 + len(body), 16, 0, 1, 0) + body


def test_can_interface_in_full() -> None:
    assert parse(answer()) == Interface(True, "can", 128, 500_000, CanState.ERROR_ACTIVE, (8, 127), is_can=True)


def test_virtual_interface_has_no_bit_rate() -> None:
    assert parse(answer(kind=b"vcan", flags=0)) == Interface(False, "vcan", 128, is_can=True)


def test_error_message_is_none() -> None:
    assert parse(struct.pack("=IHHIIi", 20, 2, 0, 1, 0, -19)) is None


@pytest.mark.parametrize("length", range(16, 150, 7))
def test_truncated_answer_does_no_harm(length: int) -> None:
    whole = answer()
    if length >= 32:
        parse(whole[:length])


@pytest.mark.parametrize(
    ("found", "message"),
    [
        (Interface(True, "can", 128, 250_000, CanState.ERROR_ACTIVE), "its bit rate is 250000 bit/s, .* says 1000000"),
        (
            Interface(True, "can", 128, 1_000_000, CanState.ERROR_PASSIVE, (136, 0)),
            r"state error_passive, error counters 136 \(tx\) and 0 \(rx\)",
        ),
        (Interface(True, "can", 128, 1_000_000, CanState.BUS_OFF), "state bus_off"),
        (
            Interface(True, "can", 128, 1_000_000, CanState.ERROR_ACTIVE, (0, 8)),
            r"error counters are 0 \(tx\) and 8 \(rx\), wanted are 0",
        ),
    ],
)
def test_interface_that_is_not_fit_is_refused(monkeypatch: pytest.MonkeyPatch, found: Interface, message: str) -> None:
    monkeypatch.setattr(interface, "read", lambda channel: found)
    with pytest.raises(BusError, match=message):
        check("can0", 1_000_000)


@pytest.mark.parametrize(
    "found", [None, Interface(True, "vcan"), Interface(True, "can", 128, 1_000_000, CanState.ERROR_ACTIVE, (0, 0))]
)
def test_fit_or_unknown_interface_passes(monkeypatch: pytest.MonkeyPatch, found: Interface | None) -> None:
    monkeypatch.setattr(interface, "read", lambda channel: found)
    check("can0", 1_000_000)
