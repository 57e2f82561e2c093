"""Read, create, delete and switch the CAN links of this machine over route netlink (rtnetlink(7)), and open a bus.

The netlink part is our own, because every command that opens a bus uses it. The library pyroute2 0.9.7 takes 630 ms to
import and 4 ms to read a link. This module takes 4 ms and 0.5 ms. Both report the kernel's reason for a failure.
"""

from __future__ import annotations

import contextlib
import os
import socket
import struct
import sys
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

from tsa_ctrl.bus.wire.bus import Bus
from tsa_ctrl.bus.wire.datagram import DatagramBus
from tsa_ctrl.bus.wire.socketcan import SocketCan
from tsa_ctrl.errors import BusError, UsageError

if TYPE_CHECKING:  # the first process in the guest of tools/vcan imports this module with only the standard library
    from tsa_ctrl.bus.settings import BusSettings


RTM_NEWLINK, RTM_DELLINK, RTM_GETLINK, RTM_NEWROUTE = 16, 17, 18, 24  # linux/rtnetlink.h
CREATE, EXCLUSIVE, DUMP = 0x400, 0x200, 0x300  # NLM_F_... of linux/netlink.h
LINK = struct.Struct("=BxHiII")  # ifinfomsg: family, type, index, flags, change
_REQUEST, _ACK = 1, 4
_ERROR, _DONE = 2, 3  # NLMSG_...: an acknowledgement, positive or negative; the end of a dump
_HEADER = struct.Struct("=IHHII")  # nlmsghdr: length, type, flags, sequence, port
_ATTRIBUTE = struct.Struct("=HH")  # rtattr: length, type
_TYPE_MASK = 0x3FFF  # without NLA_F_NESTED
_BUFFER = 1 << 17
_TIMEOUT = 1.0  # s


def request(kind: int, flags: int, body: bytes) -> list[bytes]:
    """Send a request, and return the bodies of the answers before its acknowledgement.

    Raises:
        OSError: with the kernel's reason, or without netlink.
    """
    if not hasattr(socket, "AF_NETLINK"):
        raise OSError("this system has no netlink")
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as netlink:
        netlink.settimeout(_TIMEOUT)
        netlink.send(_HEADER.pack(_HEADER.size + len(body), kind, _REQUEST | _ACK | flags, 1, 0) + body)
        bodies: list[bytes] = []
        while not answer(netlink.recv(_BUFFER), bodies):
            pass
        return bodies


def answer(data: bytes, bodies: list[bytes]) -> bool:
    """Add the messages of a datagram to `bodies`; return True at the end of the answer. Raises OSError on rejection."""
    while len(data) >= _HEADER.size:
        length, kind, *_ = _HEADER.unpack_from(data)
        body, data = data[_HEADER.size : length], data[max(_HEADER.size, (length + 3) & ~3) :]
        if kind in (_ERROR, _DONE):
            code = -int.from_bytes(body[:4], sys.byteorder, signed=True) if kind == _ERROR else 0
            if code:
                raise OSError(code, os.strerror(code))
            return True
        bodies.append(body)
    return False


def attribute(kind: int, value: bytes) -> bytes:
    """Return one attribute of a message as bytes."""
    length = _ATTRIBUTE.size + len(value)
    return _ATTRIBUTE.pack(length, kind) + value + bytes(-length % 4)


def attributes(data: bytes) -> dict[int, bytes]:
    """Return the attributes by type, up to the first invalid one."""
    found = {}
    while len(data) >= _ATTRIBUTE.size:
        length, kind = _ATTRIBUTE.unpack_from(data)
        if length < _ATTRIBUTE.size:
            break
        found[kind & _TYPE_MASK] = data[_ATTRIBUTE.size : length]
        data = data[(length + 3) & ~3 :]
    return found


_IFF_UP = 1
_ARPHRD_CAN = 280  # linux/if_arp.h
_IFLA_IFNAME, _IFLA_TXQLEN, _IFLA_LINKINFO, _IFLA_STATS64 = 3, 13, 18, 23  # linux/if_link.h
_INFO_KIND, _INFO_DATA = 1, 2
_CAN_BITTIMING, _CAN_STATE, _CAN_RESTART_MS, _CAN_BERR_COUNTER = 1, 4, 6, 8  # linux/can/netlink.h
_STATS = struct.Struct("=32x4Q")  # rtnl_link_stats64 from rx_errors on: errors rx, tx, dropped rx, tx


class CanState(IntEnum):
    """CAN controller states: enum can_state of linux/can/netlink.h."""

    ERROR_ACTIVE = 0
    ERROR_WARNING = 1
    ERROR_PASSIVE = 2
    BUS_OFF = 3
    STOPPED = 4
    SLEEPING = 5


@dataclass(frozen=True)
class Interface:
    """One link. A value that the link lacks is None, for instance the bit rate of a vcan."""

    up: bool
    kind: str | None = None  # "can", "vcan", "slcan", ...
    queue_length: int | None = None  # frames, txqueuelen
    bitrate: int | None = None  # bit/s
    state: CanState | None = None
    errors: tuple[int, int] | None = None  # transmit and receive error counters
    is_can: bool = False  # of any kind
    restart_ms: int | None = None  # ms until the kernel leaves bus-off; 0: never
    lost: int = 0  # frames since the link is up: errors and drops in both directions
    name: str = ""


def read(channel: str) -> Interface | None:
    """Return a link read from the kernel, or None without an answer (no such link, no netlink)."""
    try:
        found = request(RTM_GETLINK, 0, LINK.pack(0, 0, socket.if_nametoindex(channel), 0, 0))
    except OSError:
        return None
    return parse(found[0]) if found else None


IN_ONE_MACHINE = frozenset({"virtual", "udp_multicast", "datagram"})  # interfaces without a drive on them
_VIRTUAL_LINKS = ("vcan", "vxcan")


def is_simulated(interface: str, channel: str) -> bool:
    """Return True if no real drive can be on this bus, because it does not leave the machine."""
    if interface != "socketcan":
        return interface in IN_ONE_MACHINE
    link = read(channel)
    return link is not None and link.kind in _VIRTUAL_LINKS


def can_interfaces() -> dict[str, Interface]:
    """Return the CAN links of this machine by name, up or down; empty if the kernel denies netlink."""
    try:
        found = [parse(body) for body in request(RTM_GETLINK, DUMP, LINK.pack(0, 0, 0, 0, 0))]
    except OSError:
        return {}
    return {link.name: link for link in found if link.is_can}


def set_up(channel: str, up: bool | None) -> None:
    """Switch a link up or down, like `ip link set CHANNEL up`; raise OSError with the kernel's reason.

    `up` None changes nothing: the kernel only checks that this process may switch the link.
    """
    change = 0 if up is None else _IFF_UP
    request(RTM_NEWLINK, 0, LINK.pack(0, 0, socket.if_nametoindex(channel), int(bool(up)), change))


def make_vcan(name: str) -> None:
    """Create a vcan and set it up, like `ip link add dev NAME type vcan`; after an OSError it does not exist."""
    info = attribute(_IFLA_LINKINFO, attribute(_INFO_KIND, b"vcan"))
    body = LINK.pack(0, 0, 0, 0, 0) + attribute(_IFLA_IFNAME, name.encode() + b"\0") + info
    request(RTM_NEWLINK, CREATE | EXCLUSIVE, body)
    try:
        set_up(name, True)
    except BaseException:
        with contextlib.suppress(OSError):
            delete(name)
        raise


def delete(name: str) -> None:
    """Delete a link, like `ip link del NAME`; raise OSError with the kernel's reason."""
    request(RTM_DELLINK, 0, LINK.pack(0, 0, socket.if_nametoindex(name), 0, 0))


def parse(body: bytes) -> Interface:
    """Return the link in a message of the kernel (RTM_NEWLINK without its header)."""
    _, link_type, _, flags, _ = LINK.unpack_from(body)
    of = attributes(body[LINK.size :])
    info = attributes(of.get(_IFLA_LINKINFO, b""))
    kind = info.get(_INFO_KIND)
    data = attributes(info.get(_INFO_DATA, b"")) if kind is not None and _text(kind) == "can" else {}
    stats = of.get(_IFLA_STATS64, b"")
    return Interface(
        up=bool(flags & _IFF_UP),
        is_can=link_type == _ARPHRD_CAN,
        kind=None if kind is None else _text(kind),
        queue_length=_u32(of.get(_IFLA_TXQLEN)),
        bitrate=_u32(data.get(_CAN_BITTIMING)),
        state=_state(_u32(data.get(_CAN_STATE))),
        errors=_pair(data.get(_CAN_BERR_COUNTER)),
        restart_ms=_u32(data.get(_CAN_RESTART_MS)),
        lost=sum(_STATS.unpack_from(stats)) if len(stats) >= _STATS.size else 0,
        name=_text(of.get(_IFLA_IFNAME, b"")),
    )


def check(channel: str, bitrate: int) -> None:
    """Raise BusError if a real CAN interface has another bit rate, is not error-active, or has counted errors."""
    found = read(channel)
    if found is None:
        return
    restart = f"ip link set {channel} down; ip link set {channel} up type can bitrate {bitrate}"
    if found.bitrate is not None and found.bitrate != bitrate:
        raise BusError(
            f"[bus] channel '{channel}': its bit rate is {found.bitrate} bit/s, but the configuration has {bitrate}; "
            f"correct bitrate, or run: {restart}"
        )
    if found.state is not None and found.state is not CanState.ERROR_ACTIVE:
        counters = "" if found.errors is None else f", error counters {found.errors[0]} (tx) and {found.errors[1]} (rx)"
        raise BusError(
            f"[bus] channel '{channel}': the controller is in state {found.state.name.lower()}{counters}; "
            f"check cable, termination and bit rate, then run: {restart}"
        )
    if found.errors is not None and any(found.errors):
        raise BusError(
            f"[bus] channel '{channel}': its error counters are {found.errors[0]} (tx) and {found.errors[1]} (rx), "
            f"required: 0; the bus has errors: check cable, termination and bit rate, then run: {restart}"
        )


def _text(data: bytes) -> str:
    return data.rstrip(b"\0").decode(errors="replace")


def _u32(data: bytes | None) -> int | None:
    return None if data is None or len(data) < 4 else int.from_bytes(data[:4], sys.byteorder)


def _pair(data: bytes | None) -> tuple[int, int] | None:
    if data is None or len(data) < 4:
        return None
    transmit, receive = struct.unpack_from("=HH", data)
    return transmit, receive


def _state(value: int | None) -> CanState | None:
    return CanState(value) if value is not None and value in CanState._value2member_map_ else None


def open_bus(settings: BusSettings) -> Bus:
    """Open the configured bus and return it; raise BusError if it is not ready.

    "socketcan" uses a raw socket, "datagram" uses local sockets, and every other interface uses python-can.
    """
    if settings.interface in ("socketcan", "datagram") and settings.options:
        raise UsageError(
            f'[bus] options: {", ".join(settings.options)} do not apply to interface "{settings.interface}"; remove '
            "them (the bit rate of a SocketCAN interface is set with 'ip link')"
        )
    if settings.interface == "datagram":
        return DatagramBus(settings.channel, settings.send_queue)
    if settings.interface == "socketcan":
        bus = SocketCan(settings.channel, settings.send_queue)
        try:
            check(settings.channel, settings.bitrate)
        except BaseException:
            bus.close()
            raise
        return bus
    from tsa_ctrl.bus.wire.python_can import PythonCan  # slow to import, and not needed for a raw socket

    return PythonCan(settings.interface, settings.channel, settings.bitrate, settings.options)
