"""Set up the network of a guest or a network namespace, with loopback, multicast and a vcan, without iproute2.

A user may create a network namespace with a vcan without root rights, as `unshare --map-root-user --net` does.
"""

from __future__ import annotations

import ctypes
import os
import socket
import struct
from pathlib import Path

from tsa_ctrl.bus.wire.link import CREATE, LINK, RTM_NEWLINK, RTM_NEWROUTE, attribute, make_vcan, request

IFF_UP, IFF_MULTICAST = 0x1, 0x1000
RTA_DST, RTA_OIF, RT_TABLE_LOCAL, RTPROT_BOOT, RT_SCOPE_LINK, RTN_UNICAST = 1, 4, 255, 3, 253, 1
CLONE_NEWUSER, CLONE_NEWNET = 0x10000000, 0x40000000
LIBC = ctypes.CDLL(None, use_errno=True)
ROUTE = struct.Struct("=8BI")  # rtmsg: family, lengths, service, table, protocol, scope, type, flags


def bring_up_alone(vcan: str) -> None:
    """Set up loopback, multicast and a vcan in a separate network namespace.

    Raises:
        OSError: The kernel rejects a request.
    """
    flags = IFF_UP | IFF_MULTICAST
    request(RTM_NEWLINK, 0, LINK.pack(0, 0, socket.if_nametoindex("lo"), flags, flags))
    route_multicast("lo")
    make_vcan(vcan)


def route_multicast(name: str) -> None:
    """Add a multicast route, like `ip route add 224.0.0.0/4 dev NAME table local`.

    Raises:
        OSError: The kernel rejects the request.
    """
    header = ROUTE.pack(socket.AF_INET, 4, 0, 0, RT_TABLE_LOCAL, RTPROT_BOOT, RT_SCOPE_LINK, RTN_UNICAST, 0)
    group = attribute(RTA_DST, socket.inet_aton("224.0.0.0"))
    device = attribute(RTA_OIF, struct.pack("=I", socket.if_nametoindex(name)))
    request(RTM_NEWROUTE, CREATE, header + group + device)


def possible(vcan: str) -> bool:
    """Return True if `enter` works. A child process tries it, because a process cannot leave a namespace."""
    child = os.fork()
    if not child:
        try:
            enter(vcan)
        except OSError:
            os._exit(1)
        os._exit(0)
    return os.waitpid(child, 0)[1] == 0


def enter(vcan: str) -> None:
    """Move this process into a network namespace with loopback and `vcan`.

    Raises:
        OSError: The kernel denies the request.
    """
    user, group = os.getuid(), os.getgid()
    if LIBC.unshare(CLONE_NEWUSER | CLONE_NEWNET):
        raise OSError(ctypes.get_errno(), "unshare")
    Path("/proc/self/setgroups").write_text("deny")
    Path("/proc/self/uid_map").write_text(f"0 {user} 1")
    Path("/proc/self/gid_map").write_text(f"0 {group} 1")
    bring_up_alone(vcan)
