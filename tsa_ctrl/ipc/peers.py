"""Who is at the other end of a local socket, by the kernel's word, and what he may do there."""

from __future__ import annotations

import os
import socket
import struct
from collections.abc import Collection
from enum import IntEnum
from pathlib import Path
from typing import NamedTuple

_CREDENTIALS = struct.Struct("=3i")  # struct ucred: process, user, group
_SO_PEERGROUPS = 59  # asm-generic/socket.h, Linux 4.13; the socket module has no name for it
_MOST_GROUPS = 1024  # bytes: the most that getsockopt of Python takes, 256 groups


class Role(IntEnum):
    """Each may do what those before it may."""

    WATCH = 1  # status, measurements, events
    COMMAND = 2  # also parameters, the lease of the set-point, stop; recovery while it holds the lease
    OWNER = 3  # also recovery at any time: who started the daemon, and root


class Peer(NamedTuple):
    """The process that connected; its groups include the supplementary ones."""

    process: int
    user: int
    groups: frozenset[int] = frozenset()

    def __str__(self) -> str:
        try:
            name = Path(f"/proc/{self.process}/comm").read_text(encoding="utf-8", errors="replace").strip()
        except OSError:  # it is gone, or hidden from this user
            name = ""
        return f"process {self.process}{f' ({name})' if name.isprintable() and name else ''} of user {self.user}"


def peer_of(connection: socket.socket) -> Peer:
    """Who connected (SO_PEERCRED, SO_PEERGROUPS)."""
    data = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    process, user, group = _CREDENTIALS.unpack(data)
    try:
        data = connection.getsockopt(socket.SOL_SOCKET, _SO_PEERGROUPS, _MOST_GROUPS)
        groups = frozenset(struct.unpack(f"={len(data) // 4}I", data))
    except OSError:  # more groups than that: the first one alone counts
        groups = frozenset()
    return Peer(process, user, groups | {group})


def user_of(connection: socket.socket) -> int:
    """The user at the other end of a local socket."""
    return peer_of(connection).user


def role_of(peer: Peer, command: Collection[int], watch: Collection[int]) -> Role | None:
    """What a peer may do, by the groups that may command and watch; None: nothing at all."""
    if peer.user in (0, os.getuid()):
        return Role.OWNER
    if not peer.groups.isdisjoint(command):
        return Role.COMMAND
    return Role.WATCH if not peer.groups.isdisjoint(watch) else None
