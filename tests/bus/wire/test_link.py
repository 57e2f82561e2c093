"""Test parsing the kernel's answer about a link from bytes, and creating and switching a vcan."""

from __future__ import annotations

import errno
import os
import struct

import pytest

from tsa_ctrl.bus.wire import link as interface
from tsa_ctrl.bus.wire.link import CanState, Interface, attribute, check, parse
from tsa_ctrl.errors import BusError


def link(kind: bytes = b"can", flags: int = 1, bitrate: int = 500_000, state: int = 0) -> bytes:
    data = (
        attribute(1, struct.pack("=8I", bitrate, 875, 125, 6, 7, 2, 1, 1))
        + attribute(4, struct.pack("=I", state))
        + attribute(6, struct.pack("=I", 100))
        + attribute(8, struct.pack("=HH", 8, 127))
    )
    return (
        struct.pack("=BxHiII", 0, 280, 3, flags, 0)
        + attribute(3, b"can0\0")
        + attribute(13, struct.pack("=I", 128))
        + attribute(18 | 0x8000, attribute(1, kind + b"\0") + attribute(2 | 0x8000, data))
        + attribute(23, struct.pack("=24Q", 10, 20, 30, 40, 1, 2, 4, 8, *range(100, 116)))
    )


def message(kind: int, body: bytes) -> bytes:
    return struct.pack("=IHHII", 16 + len(body), kind, 0, 1, 0) + body


def test_can_interface_in_full() -> None:
    assert parse(link()) == Interface(
        up=True, kind="can", queue_length=128, bitrate=500_000, state=CanState.ERROR_ACTIVE, errors=(8, 127),
        is_can=True, restart_ms=100, lost=15, name="can0",
    )  # fmt: skip


def test_virtual_interface_has_no_bit_rate() -> None:
    assert parse(link(kind=b"vcan", flags=0)) == Interface(False, "vcan", 128, is_can=True, lost=15, name="can0")


@pytest.mark.parametrize("length", range(16, 450, 7))
def test_truncated_answer_does_no_harm(length: int) -> None:
    parse(link()[:length])


def test_an_answer_ends_with_its_acknowledgement() -> None:
    """A dump comes in several datagrams. A single link comes in one datagram and the acknowledgement in the next."""
    bodies: list[bytes] = []
    assert not interface.answer(message(16, link()) + message(16, link(b"vcan")), bodies)
    assert interface.answer(message(16, link()) + message(2, struct.pack("=i", 0)), bodies)
    assert bodies == [link(), link(b"vcan"), link()]
    assert interface.answer(message(3, struct.pack("=i", 0)), bodies)


def test_a_refusal_is_the_kernels_reason() -> None:
    with pytest.raises(OSError, match="No such device"):
        interface.answer(message(2, struct.pack("=i", -19)), [])


def test_a_vcan_that_cannot_be_brought_up_is_not_left_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def kernel(kind: int, flags: int, body: bytes) -> list[bytes]:
        asked.append(kind)
        if asked == [interface.RTM_NEWLINK] * 2:
            raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))
        return []

    monkeypatch.setattr(interface, "request", kernel)
    monkeypatch.setattr(interface.socket, "if_nametoindex", lambda name: 7)
    with pytest.raises(PermissionError):
        interface.make_vcan("vcan7")
    assert asked == [interface.RTM_NEWLINK, interface.RTM_NEWLINK, interface.RTM_DELLINK]


@pytest.mark.vcan
def test_a_vcan_is_made_up_switched_and_seen(vcan: str) -> None:
    try:
        interface.make_vcan("vcan77")
    except OSError:
        pytest.skip("no right to make links here")
    try:
        found = interface.read("vcan77")
        assert found is not None
        assert (found.up, found.kind, found.is_can, found.name) == (True, "vcan", True, "vcan77")
        interface.set_up("vcan77", False)
        assert {name: link.up for name, link in interface.can_interfaces().items()}["vcan77"] is False
        with pytest.raises(FileExistsError):
            interface.make_vcan("vcan77")
    finally:
        interface.delete("vcan77")
    assert interface.read("vcan77") is None


ACTIVE, PASSIVE, OFF = CanState.ERROR_ACTIVE, CanState.ERROR_PASSIVE, CanState.BUS_OFF


@pytest.mark.parametrize(
    ("bitrate", "state", "errors", "message"),
    [
        (250_000, ACTIVE, None, "its bit rate is 250000 bit/s, .* has 1000000"),
        (1_000_000, PASSIVE, (136, 0), r"state error_passive, error counters 136 \(tx\) and 0 \(rx\)"),
        (1_000_000, OFF, None, "state bus_off"),
        (1_000_000, ACTIVE, (0, 8), r"error counters are 0 \(tx\) and 8 \(rx\), required: 0"),
    ],
)
def test_only_a_fit_or_unknown_interface_passes(
    monkeypatch: pytest.MonkeyPatch, bitrate: int, state: CanState, errors: tuple[int, int] | None, message: str
) -> None:
    found = [
        None,
        Interface(True, "vcan"),
        Interface(True, "can", 128, 1_000_000, ACTIVE, (0, 0)),
        Interface(True, "can", 128, bitrate, state, errors),
    ]
    monkeypatch.setattr(interface, "read", lambda channel: found.pop(0))
    for _ in range(3):
        check("can0", 1_000_000)
    with pytest.raises(BusError, match=message):
        check("can0", 1_000_000)
