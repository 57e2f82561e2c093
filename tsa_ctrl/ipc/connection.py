"""Open the socket of the server, and handle one client: its user and role, pending requests and unread answers.

The socket is for its owner alone, or also for groups. The socket of another running daemon is never replaced.
"""

from __future__ import annotations

import contextlib
import grp
import os
import socket
import struct
from collections import deque
from collections.abc import Callable, Collection, Iterator
from enum import IntEnum
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc.protocol import LONGEST_LINE, is_socket, make_private, private_folder

_CREDENTIALS = struct.Struct("=3i")  # struct ucred: process, user, group
_SO_PEERGROUPS = 59  # asm-generic/socket.h, Linux 4.13; the socket module has no name for it
_MOST_GROUPS = 1024  # bytes, limit of Python's getsockopt: 256 groups


class Role(IntEnum):
    """Roles of a client; each role includes the permissions of the lower ones."""

    WATCH = 1  # status, measurements, events
    COMMAND = 2  # also parameters, the lease of the set-point, stop; recovery while it holds the lease
    OWNER = 3  # also recovery at any time; for root and the user who started the daemon


class Peer(NamedTuple):
    """The process that connected; `groups` includes its supplementary groups."""

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


def role_of(peer: Peer, command: Collection[int], watch: Collection[int]) -> Role | None:
    """Return the role of a peer by its user and groups, or None if it has no permission.

    Processes in the groups `command` and `watch` have those roles. Root and the user of this process are OWNER.
    """
    if peer.user in (0, os.getuid()):
        return Role.OWNER
    if not peer.groups.isdisjoint(command):
        return Role.COMMAND
    return Role.WATCH if not peer.groups.isdisjoint(watch) else None


UNSENT = 256 * 1024  # bytes of answers that a client may leave unread

_encode = msgspec.json.encode


class Connection:
    """A non-blocking socket with its requests and answers.

    `gone` is True if the client has disconnected or does not read its answers.
    """

    def __init__(self, connection: socket.socket, peer: Peer, role: Role, now: float) -> None:
        self.socket = connection
        self.peer = peer
        self.role = role
        self.last = now  # s, time of its last request
        self.lines: deque[bytes] = deque()  # requests that were received and not processed yet
        self.pending: list[tuple[int, float, dict[str, Any]]] = []  # ticket, since when, answer
        self.gone = False
        self._received = b""
        self._unsent = b""

    def receive(self, now: float) -> None:
        """Read a bounded part of the received data, unless earlier requests still wait for an answer."""
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
        """Send the reason for closing the connection, without waiting for the client."""
        self.refuse(text)
        self.send()

    def settle(self, taken: Callable[[int], bool], now: float, patience: float) -> None:
        """Answer the commands that the loop has taken, and reject those that it has not taken within `patience` s."""
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


CLIENTS = 16  # connections of one role; another one replaces the connection that has been silent longest
ACCEPTED = 16  # connections that are accepted at once
BACKLOG = 256  # connections that wait until the server accepts them


def listen(path: str, group: str | None, watch_group: str | None = None) -> socket.socket:
    """Return a listening socket for its owner alone (0600), or also for a group (0660); raise UsageError if that fails.

    A file has only one group. With two groups, every user may connect (0666), and `role_of` rejects users without a
    role.
    """
    place = Path(path)
    if str(place.parent) == private_folder():
        make_private(str(place.parent))
    if is_socket(path):
        _replace(place)
    number = None if group is None else group_number(group, "group")
    watch = None if watch_group is None else group_number(watch_group, "watch_group")
    both = number is not None and watch is not None
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    bound = False
    try:
        before = os.umask(0o177)
        try:
            listener.bind(path)
        finally:
            os.umask(before)
        bound = True
        if both:
            place.chmod(0o666)
        elif number is not None or watch is not None:
            os.chown(path, -1, number if number is not None else watch or 0)
            place.chmod(0o660)
        listener.listen(BACKLOG)
    except OSError as error:
        listener.close()
        if bound:  # otherwise the file belongs to another process
            place.unlink(missing_ok=True)
        if bound and isinstance(error, PermissionError):
            key, name = ("group", group) if group is not None else ("watch_group", watch_group)
            raise UsageError(
                f"[socket] {key} '{name}': {path} cannot be given to it ({error.strerror}); give a group of this user"
            ) from None
        reason = error.strerror or error  # a path that is too long has no number
        raise UsageError(f"[socket] path {path}: cannot listen there ({reason}); give another path") from None
    return listener


@contextlib.contextmanager
def listening(path: str, group: str | None, watch_group: str | None = None) -> Iterator[socket.socket]:
    """Listen as `listen` inside the block, and remove the socket's file unless another process has replaced it."""
    listener = listen(path, group, watch_group)
    place = Path(path)
    ours = place.stat().st_ino
    try:
        yield listener
    finally:
        listener.close()
        with contextlib.suppress(OSError):
            if place.stat().st_ino == ours:
                place.unlink()


def accepted(
    listener: socket.socket, command: Collection[int], watch: Collection[int], now: float
) -> Iterator[Connection]:
    """Yield the clients that wait for a connection, at most ACCEPTED; a user without a role is rejected.

    `command` and `watch` are the groups of those roles; `now` in s.
    """
    with contextlib.suppress(OSError):
        for _ in range(ACCEPTED):
            connection, _ = listener.accept()
            connection.setblocking(False)
            peer = peer_of(connection)
            role = role_of(peer, command, watch)
            client = Connection(connection, peer, role or Role.WATCH, now)
            if role is not None:
                yield client
            else:
                client.dismiss(f"user {peer.user} may not use this socket; see [socket] group and watch_group")
                connection.close()


def group_number(name: str, key: str) -> int:
    """Return the number of a group; for an unknown group raise UsageError with `key` of the configuration."""
    try:
        return grp.getgrnam(name).gr_gid
    except KeyError:
        raise UsageError(f"[socket] {key} '{name}': no such group; give one that exists") from None


def _replace(place: Path) -> None:
    """Remove a socket without a listening process; raise UsageError if a daemon answers there."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(place))
        except ConnectionRefusedError:  # left over from a daemon that was killed
            try:
                place.unlink()
            except OSError as error:
                raise UsageError(
                    f"{place}: is left over and cannot be removed ({error.strerror}); remove it, or give another "
                    "[socket] path"
                ) from None
        except OSError as error:  # a daemon may listen there, but this path does not reach it
            raise UsageError(
                f"[socket] path {place}: cannot connect ({error.strerror or error}); give another path"
            ) from None
        else:
            raise UsageError(f"{place}: another daemon answers there; stop it, or give another [socket] path")
