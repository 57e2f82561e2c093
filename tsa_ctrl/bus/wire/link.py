"""What the kernel says of a CAN interface (rtnetlink, RTM_GETLINK): kind, bit rate, state, error counters, queue.

And to switch one down and up (RTM_NEWLINK), for the simulated machine's faults.
"""

from __future__ import annotations

import os
import socket
import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

from tsa_ctrl.errors import BusError

_MESSAGE = struct.Struct("=IHHII")  # nlmsghdr: length, type, flags, sequence, port
_LINK = struct.Struct("=BxHiII")  # ifinfomsg: family, type, index, flags, change
_ATTRIBUTE = struct.Struct("=HH")  # rtattr: length, type
_RTM_NEWLINK, _RTM_GETLINK, _NLM_F_REQUEST, _NLM_F_ACK = 16, 18, 1, 4
_IFF_UP = 1
_ARPHRD_CAN = 280  # linux/if_arp.h
_TYPE_MASK = 0x3FFF  # without NLA_F_NESTED
_IFLA_TXQLEN, _IFLA_LINKINFO, _INFO_KIND, _INFO_DATA = 13, 18, 1, 2
_CAN_BITTIMING, _CAN_STATE, _CAN_BERR_COUNTER = 1, 4, 8  # of linux/can/netlink.h
_BUFFER = 65536
_TIMEOUT = 1.0  # s


class CanState(IntEnum):
    """enum can_state of linux/can/netlink.h."""

    ERROR_ACTIVE = 0
    ERROR_WARNING = 1
    ERROR_PASSIVE = 2
    BUS_OFF = 3
    STOPPED = 4
    SLEEPING = 5


@dataclass(frozen=True)
class Interface:
    """One interface; what it does not have (a vcan has no bit rate) is None."""

    up: bool
    kind: str | None = None  # "can", "vcan", "slcan", ...
    queue_length: int | None = None  # frames, txqueuelen
    bitrate: int | None = None  # bit/s
    state: CanState | None = None
    errors: tuple[int, int] | None = None  # transmit and receive error counters
    is_can: bool = False  # of whatever kind


def read(channel: str) -> Interface | None:
    """Ask the kernel; None when it does not answer (no such interface, no netlink)."""
    try:
        index = socket.if_nametoindex(channel)
        body = _LINK.pack(0, 0, index, 0, 0)
        request = _MESSAGE.pack(_MESSAGE.size + len(body), _RTM_GETLINK, _NLM_F_REQUEST, 1, 0) + body
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as netlink:
            netlink.settimeout(_TIMEOUT)
            netlink.send(request)
            return parse(netlink.recv(_BUFFER))
    except (OSError, AttributeError):  # AttributeError: not Linux
        return None


def set_up(channel: str, up: bool) -> None:
    """Switch an interface up or down, as `ip link set CHANNEL up`; raises OSError with the kernel's reason."""
    body = _LINK.pack(0, 0, socket.if_nametoindex(channel), int(up), _IFF_UP)
    request = _MESSAGE.pack(_MESSAGE.size + len(body), _RTM_NEWLINK, _NLM_F_REQUEST | _NLM_F_ACK, 1, 0) + body
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as netlink:
        netlink.settimeout(_TIMEOUT)
        netlink.send(request)
        code = -struct.unpack_from("=i", netlink.recv(_BUFFER), _MESSAGE.size)[0]
    if code:
        raise OSError(code, os.strerror(code))


def parse(message: bytes) -> Interface | None:
    """Decode the kernel's answer; None when it is an error message."""
    length, kind, *_ = _MESSAGE.unpack_from(message)
    if kind != _RTM_NEWLINK:
        return None
    _, link_type, _, flags, _ = _LINK.unpack_from(message, _MESSAGE.size)
    attributes = dict(_attributes(message[_MESSAGE.size + _LINK.size : length]))
    info = dict(_attributes(attributes.get(_IFLA_LINKINFO, b"")))
    data = dict(_attributes(info.get(_INFO_DATA, b"")))
    name = info.get(_INFO_KIND)
    real = name is not None and name.rstrip(b"\0") == b"can"
    return Interface(
        up=bool(flags & _IFF_UP),
        is_can=link_type == _ARPHRD_CAN,
        kind=None if name is None else name.rstrip(b"\0").decode(),
        queue_length=_u32(attributes.get(_IFLA_TXQLEN)),
        bitrate=_u32(data.get(_CAN_BITTIMING)) if real else None,
        state=_state(_u32(data.get(_CAN_STATE))) if real else None,
        errors=_pair(data.get(_CAN_BERR_COUNTER)) if real else None,
    )


def can_interfaces() -> dict[str, Interface]:
    """The CAN interfaces of this machine that are up, by name."""
    found = {name: read(name) for _, name in socket.if_nameindex()}
    return {name: link for name, link in found.items() if link is not None and link.is_can and link.up}


def check(channel: str, bitrate: int) -> None:
    """Raise BusError when a real CAN interface has another bit rate, is not error-active, or has counted errors."""
    found = read(channel)
    if found is None:
        return
    restart = f"ip link set {channel} down; ip link set {channel} up type can bitrate {bitrate}"
    if found.bitrate is not None and found.bitrate != bitrate:
        raise BusError(
            f"[bus] channel '{channel}': its bit rate is {found.bitrate} bit/s, the configuration says {bitrate}; "
            f"correct bitrate, or: {restart}"
        )
    if found.state is not None and found.state is not CanState.ERROR_ACTIVE:
        counters = "" if found.errors is None else f", error counters {found.errors[0]} (tx) and {found.errors[1]} (rx)"
        raise BusError(
            f"[bus] channel '{channel}': the controller is in state {found.state.name.lower()}{counters}; "
            f"check cable, termination and bit rate, then: {restart}"
        )
    if found.errors is not None and any(found.errors):
        raise BusError(
            f"[bus] channel '{channel}': its error counters are {found.errors[0]} (tx) and {found.errors[1]} (rx), "
            f"wanted are 0: something disturbs the bus; check cable, termination and bit rate, then: {restart}"
        )


def _attributes(data: bytes) -> Iterator[tuple[int, bytes]]:
    position = 0
    while position + _ATTRIBUTE.size <= len(data):
        length, kind = _ATTRIBUTE.unpack_from(data, position)
        if length < _ATTRIBUTE.size:
            return
        yield kind & _TYPE_MASK, data[position + _ATTRIBUTE.size : position + length]
        position += (length + 3) & ~3


def _u32(data: bytes | None) -> int | None:
    return None if data is None or len(data) < 4 else int.from_bytes(data[:4], sys.byteorder)


def _pair(data: bytes | None) -> tuple[int, int] | None:
    if data is None or len(data) < 4:
        return None
    transmit, receive = struct.unpack_from("=HH", data)
    return transmit, receive


def _state(value: int | None) -> CanState | None:
    return CanState(value) if value is not None and value in CanState._value2member_map_ else None
