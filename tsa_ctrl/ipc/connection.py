"""One client of the socket server: who it is, what it has asked and was not answered yet, what it has not read yet."""

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

# Who is at the other end of a local socket, by the kernel's word, and what he may do there.

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


UNSENT = 256 * 1024  # bytes of answers that a client may leave unread

_encode = msgspec.json.encode


class Connection:
    """A non-blocking socket with its lines; `gone` when the other end is, or reads nothing."""

    def __init__(self, connection: socket.socket, peer: Peer, role: Role, now: float) -> None:
        self.socket = connection
        self.peer = peer
        self.role = role
        self.last = now  # s, of its last request
        self.lines: deque[bytes] = deque()  # asked, and not looked at yet
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
        """One object, to be sent as soon as the client takes it."""
        self._unsent += _encode(message) + b"\n"

    def refuse(self, text: str) -> None:
        self.push({"ok": False, "error": text})

    def dismiss(self, text: str) -> None:
        """Send the reason for the end of the connection, as far as the client takes it."""
        self.refuse(text)
        self.send()

    def settle(self, taken: Callable[[int], bool], now: float, patience: float) -> None:
        """Answer the commands that the loop has taken, or has not taken within `patience` s."""
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
    """Raises UsageError when this client may not do that."""
    if client.role < role:
        raise UsageError(f"{verb}: user {client.peer.user} may only watch here; see [socket] group and watch_group")
