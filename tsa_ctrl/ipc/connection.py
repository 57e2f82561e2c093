"""Handle one client of the socket server: its user and role, its pending requests and its unread answers."""

from __future__ import annotations

import os
import socket
import struct
from collections import deque
from collections.abc import Callable, Collection
from enum import IntEnum
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc.protocol import LONGEST_LINE

_CREDENTIALS = struct.Struct("=3i")  # struct ucred: process, user, group
_SO_PEERGROUPS = 59  # asm-generic/socket.h, Linux 4.13; the socket module has no name for it
_MOST_GROUPS = 1024  # bytes: the most that getsockopt of Python takes, 256 groups


class Role(IntEnum):
    """List the roles of a client; each role includes the permissions of the lower ones."""

    WATCH = 1  # status, measurements, events
    COMMAND = 2  # also parameters, the lease of the set-point, stop; recovery while it holds the lease
    OWNER = 3  # also recovery at any time: who started the daemon, and root


class Peer(NamedTuple):
    """Identify the process that connected; `groups` includes its supplementary groups."""

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
    """Return the process that connected, as the kernel reports it (SO_PEERCRED, SO_PEERGROUPS)."""
    data = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    process, user, group = _CREDENTIALS.unpack(data)
    try:
        data = connection.getsockopt(socket.SOL_SOCKET, _SO_PEERGROUPS, _MOST_GROUPS)
        groups = frozenset(struct.unpack(f"={len(data) // 4}I", data))
    except OSError:  # more groups than fit: only the primary group counts
        groups = frozenset()
    return Peer(process, user, groups | {group})


def user_of(connection: socket.socket) -> int:
    """Return the user id of the process that connected."""
    return peer_of(connection).user


def role_of(peer: Peer, command: Collection[int], watch: Collection[int]) -> Role | None:
    """Return the role of a peer by its user and groups, or None if it has no permission.

    `command` and `watch` are the groups with that role. Root and the user of this process have the role OWNER.
    """
    if peer.user in (0, os.getuid()):
        return Role.OWNER
    if not peer.groups.isdisjoint(command):
        return Role.COMMAND
    return Role.WATCH if not peer.groups.isdisjoint(watch) else None


UNSENT = 256 * 1024  # bytes of answers that a client may leave unread

_encode = msgspec.json.encode


class Connection:
    """Hold a non-blocking socket with its requests and answers.

    `gone` is True if the client has disconnected or does not read its answers.
    """

    def __init__(self, connection: socket.socket, peer: Peer, role: Role, now: float) -> None:
        self.socket = connection
        self.peer = peer
        self.role = role
        self.last = now  # s, of its last request
        self.lines: deque[bytes] = deque()  # requests that were received and not processed yet
        self.pending: list[tuple[int, float, dict[str, Any]]] = []  # ticket, since when, answer
        self.gone = False
        self._received = b""
        self._unsent = b""

    def receive(self, now: float) -> None:
        """Read a bounded part of what has arrived, unless earlier requests still wait for an answer."""
        if self.lines:
            return
        try:
            data = self.socket.recv(LONGEST_LINE)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self.gone = True
            return
        *lines, self._received = (self._received + data).split(b"\n")
        if lines:
            self.last = now
            self.lines.extend(lines)
        if len(self._received) > LONGEST_LINE:
            self.dismiss(f"a request is longer than {LONGEST_LINE} bytes; send one object per line")
            self.gone = True

    def push(self, message: dict[str, Any]) -> None:
        """Queue one object to be sent as soon as the client reads."""
        self._unsent += _encode(message) + b"\n"

    def refuse(self, text: str) -> None:
        self.push({"ok": False, "error": text})

    def dismiss(self, text: str) -> None:
        """Send the reason for the end of the connection, without waiting for the client."""
        self.refuse(text)
        self.send()

    def settle(self, taken: Callable[[int], bool], now: float, patience: float) -> None:
        """Answer the commands that the loop has accepted, and those that it has not accepted within `patience` s."""
        waiting = []
        for ticket, since, answer in self.pending:
            if taken(ticket):
                self.push(answer)
            elif now - since > patience:
                self.refuse(f"the loop did not take the command within {patience:g} s")
            else:
                waiting.append((ticket, since, answer))
        self.pending = waiting

    def send(self) -> None:
        if not self._unsent or self.gone:
            return
        try:
            sent = self.socket.send(self._unsent)
            self._unsent = self._unsent[sent:]
        except BlockingIOError:
            pass
        except OSError:
            self.gone = True
        if len(self._unsent) > UNSENT:
            self.gone = True


def may(client: Connection, verb: str, role: Role) -> None:
    """Raise UsageError if the client's role is below `role`."""
    if client.role < role:
        raise UsageError(f"{verb}: user {client.peer.user} may only watch here; see [socket] group and watch_group")
