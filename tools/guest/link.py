"""Network interfaces over route netlink, so that neither iproute2 nor a user's rights to it are needed."""

from __future__ import annotations

import errno
import os
import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass

# linux/rtnetlink.h, linux/if_link.h, linux/netlink.h
RTM_NEWLINK, RTM_GETLINK, RTM_NEWROUTE, NLMSG_ERROR, NLMSG_DONE = 16, 18, 24, 2, 3
NLM_F_REQUEST, NLM_F_ACK, NLM_F_EXCL, NLM_F_CREATE, NLM_F_DUMP = 0x1, 0x4, 0x200, 0x400, 0x300
IFLA_IFNAME, IFLA_LINKINFO, IFLA_INFO_KIND = 3, 18, 1
IFF_UP, IFF_MULTICAST = 0x1, 0x1000
RTA_DST, RTA_OIF, RT_TABLE_LOCAL, RTPROT_BOOT, RT_SCOPE_LINK, RTN_UNICAST = 1, 4, 255, 3, 253, 1
HEADER = struct.Struct("=IHHII")  # nlmsghdr: length, type, flags, sequence, port
IFINFO = struct.Struct("=BxHiII")  # ifinfomsg: family, type, index, flags, change mask
ROUTE = struct.Struct("=8BI")  # rtmsg: family, lengths, service, table, protocol, scope, type, flags
ATTRIBUTE = struct.Struct("=HH")  # rtattr: length, type


@dataclass(frozen=True)
class Interface:
    name: str
    kind: str  # "vcan", "can", "bridge"...; empty for those without one, lo among them
    up: bool


def interfaces() -> list[Interface]:
    """All interfaces of this network namespace; none where the kernel denies netlink."""
    try:
        with _connection() as link:
            _send(link, RTM_GETLINK, NLM_F_DUMP, IFINFO.pack(0, 0, 0, 0, 0))
            return [_interface(body) for kind, body in _messages(link) if kind == RTM_NEWLINK]
    except OSError:
        return []


def find(name: str) -> Interface | None:
    return next((interface for interface in interfaces() if interface.name == name), None)


def create_vcan(name: str) -> None:
    """As `ip link add dev NAME type vcan`; raises OSError with the kernel's reason."""
    info = _attribute(IFLA_LINKINFO, _attribute(IFLA_INFO_KIND, b"vcan"))
    body = IFINFO.pack(0, 0, 0, 0, 0) + _attribute(IFLA_IFNAME, name.encode() + b"\0") + info
    _request(RTM_NEWLINK, NLM_F_CREATE | NLM_F_EXCL, body)


def set_flags(name: str, flags: int) -> None:
    """As `ip link set NAME up` (or `multicast on`); raises OSError with the kernel's reason."""
    _request(RTM_NEWLINK, 0, IFINFO.pack(0, 0, socket.if_nametoindex(name), flags, flags))


def route_multicast(name: str) -> None:
    """As `ip route add 224.0.0.0/4 dev NAME table local`; raises OSError with the kernel's reason."""
    header = ROUTE.pack(socket.AF_INET, 4, 0, 0, RT_TABLE_LOCAL, RTPROT_BOOT, RT_SCOPE_LINK, RTN_UNICAST, 0)
    group = _attribute(RTA_DST, socket.inet_aton("224.0.0.0"))
    device = _attribute(RTA_OIF, struct.pack("=I", socket.if_nametoindex(name)))
    _request(RTM_NEWROUTE, NLM_F_CREATE, header + group + device)


def bring_up_alone(vcan: str) -> None:
    """Loopback, multicast on it, and the vcan, in a network namespace of our own; raises OSError."""
    set_flags("lo", IFF_UP | IFF_MULTICAST)
    route_multicast("lo")
    create_vcan(vcan)
    set_flags(vcan, IFF_UP)


def _connection() -> socket.socket:
    return socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE)


def _attribute(kind: int, value: bytes) -> bytes:
    length = ATTRIBUTE.size + len(value)
    return ATTRIBUTE.pack(length, kind) + value + bytes(-length % 4)


def _send(link: socket.socket, kind: int, flags: int, body: bytes) -> None:
    link.send(HEADER.pack(HEADER.size + len(body), kind, NLM_F_REQUEST | flags, 1, 0) + body)


def _request(kind: int, flags: int, body: bytes) -> None:
    with _connection() as link:
        _send(link, kind, NLM_F_ACK | flags, body)
        for _ in _messages(link):
            pass


def _messages(link: socket.socket) -> Iterator[tuple[int, bytes]]:
    """The parts of an answer, up to its end; a negative acknowledgement is raised as OSError."""
    while True:
        data = link.recv(1 << 17)
        while data:
            length, kind, _, _, _ = HEADER.unpack_from(data)
            body, data = data[HEADER.size : length], data[(length + 3) & ~3 :]
            if kind == NLMSG_ERROR and (code := -struct.unpack_from("=i", body)[0]):
                raise OSError(code, os.strerror(code))
            if kind in {NLMSG_ERROR, NLMSG_DONE}:
                return
            yield kind, body


def _attributes(data: bytes) -> dict[int, bytes]:
    found = {}
    while len(data) >= ATTRIBUTE.size:
        length, kind = ATTRIBUTE.unpack_from(data)
        if length < ATTRIBUTE.size:
            raise OSError(errno.EBADMSG, "malformed netlink attribute")
        found[kind & 0x3FFF] = data[ATTRIBUTE.size : length]
        data = data[(length + 3) & ~3 :]
    return found


def _interface(body: bytes) -> Interface:
    flags = IFINFO.unpack_from(body)[3]
    attributes = _attributes(body[IFINFO.size :])
    kind = _attributes(attributes.get(IFLA_LINKINFO, b"")).get(IFLA_INFO_KIND, b"")
    return Interface(_text(attributes[IFLA_IFNAME]), _text(kind), bool(flags & IFF_UP))


def _text(value: bytes) -> str:
    return value.rstrip(b"\0").decode()
