"""Assign a node id by LSS (CiA 305) to a drive without one. The drive must be the only node on the bus."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from tsa_ctrl.bus.canopen import cia301
from tsa_ctrl.bus.wire.bus import Bus, Frame
from tsa_ctrl.errors import BusError

_SWITCH, _NODE_ID, _STORE = 0x04, 0x11, 0x17
_WAITING, _CONFIGURING = 0, 1
_INQUIRE = {"vendor": 0x5A, "product code": 0x5B, "revision": 0x5C, "serial number": 0x5D}
_INQUIRE_NODE_ID = 0x5E
_ANSWER_TIMEOUT = 0.5  # s
_SECOND = 0.1  # s, in which the answer of a second node would arrive
_LISTENING = 0.5  # s, in which other nodes on the bus are detected
_BOOT_TIMEOUT = 5.0  # s


@dataclass(frozen=True)
class Found:
    """The only node that answers LSS: its identity (0x1018), and its node id or None."""

    identity: dict[str, int]
    node_id: int | None


def find(bus: Bus) -> Found:
    """Return the only node on the bus, and leave it in LSS waiting state; raise BusError for no node or several."""
    _quiet(bus)
    _send(bus, _SWITCH, _CONFIGURING)
    try:
        identity = {name: _inquire(bus, command) for name, command in _INQUIRE.items()}
        node_id = _ask(bus, bytes((_INQUIRE_NODE_ID,)))[1]
    finally:
        _send(bus, _SWITCH, _WAITING)
    return Found(identity, node_id if 1 <= node_id <= 127 else None)


def set_node_id(bus: Bus, node_id: int, say: Callable[[str], None] = lambda line: None) -> Found:
    """Set and store the node id of the only node on the bus, and return its earlier state.

    Args:
        bus: an open bus.
        node_id: new node id.
        say: receives a text if a reset or a power cycle is needed.

    Raises:
        BusError: no node or more than one answers, or the node cannot take or store the id.
    """
    found = find(bus)
    _send(bus, _SWITCH, _CONFIGURING)
    try:
        _confirmed(
            bus, bytes((_NODE_ID, node_id)), f"does not accept node id {node_id}: use its switches or the maker's tool"
        )
        _confirmed(
            bus,
            bytes((_STORE,)),
            "cannot store its node id and loses it at power-off: use its switches or the maker's tool",
        )
    finally:
        _send(bus, _SWITCH, _WAITING)
    if found.node_id is not None:
        say(f"the drive had node id {found.node_id}: the new one takes effect at its next reset or power cycle")
        return found
    if not any(frame[0] == cia301.HEARTBEAT + node_id for frame in _frames(bus, _BOOT_TIMEOUT)):
        say(f"the drive accepted node id {node_id} but did not boot up within {_BOOT_TIMEOUT:g} s: power-cycle it")
    return found


def _quiet(bus: Bus) -> None:
    """Raise BusError if traffic shows another node or an active master."""
    bus.accept(None)
    bus.flush()
    heard = {frame[0] for frame in _frames(bus, _LISTENING) if frame[0] <= 0x7FF}
    masters = {cia301.NMT, cia301.SYNC} & heard
    if masters or len({can_id & 0x7F for can_id in heard}) > 1:
        frames = ", ".join(f"0x{can_id:03X}" for can_id in sorted(heard))
        raise BusError(
            f"{bus.name}: other nodes are active (heard {frames}) and would also take the new node id; leave only this "
            "drive on the bus, and start again"
        )


def _send(bus: Bus, *data: int) -> None:
    if not bus.send(cia301.LSS_REQUEST, bytes(data).ljust(8, b"\0")):
        raise BusError(f"{bus.name}: the frame could not be sent; check adapter, cable and interface")


def _ask(bus: Bus, request: bytes) -> bytes:
    """Return the answer to a request; raise BusError if no node or more than one answers."""
    bus.flush()
    _send(bus, *request)
    first = _receive(bus, request[0], _ANSWER_TIMEOUT)
    if first is None:
        raise BusError(
            f"{bus.name}: no node answers to LSS; check power, wiring and bit rate; a drive whose node id is set by "
            "switches or the maker's tool does not support LSS"
        )
    if _receive(bus, request[0], _SECOND) is not None:
        raise BusError(f"{bus.name}: more than one node answers to LSS; leave only this drive on the bus")
    return first


def _receive(bus: Bus, command: int, timeout: float) -> bytes | None:
    for frame in _frames(bus, timeout):
        if frame[0] == cia301.LSS_ANSWER and len(frame[1]) == 8 and frame[1][0] == command:
            return frame[1]
    return None


def _inquire(bus: Bus, command: int) -> int:
    return int(struct.unpack_from("<I", _ask(bus, bytes((command,))), 1)[0])


def _confirmed(bus: Bus, request: bytes, refusal: str) -> None:
    answer = _ask(bus, request)
    if answer[1]:
        raise BusError(f"{bus.name}: the drive {refusal} (LSS error {answer[1]})")


def _frames(bus: Bus, timeout: float) -> Iterator[Frame]:
    """Yield the frames that arrive within `timeout` s."""
    end = bus.clock() + timeout
    while (left := end - bus.clock()) > 0.0:
        frame = bus.recv(left)
        if frame is not None:
            yield frame
