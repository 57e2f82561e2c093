"""The socket that the server listens on: of its owner alone, or also of groups; never another daemon's."""

from __future__ import annotations

import contextlib
import grp
import os
import socket
from collections.abc import Collection, Iterator
from pathlib import Path

from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc.connection import Connection, Role, peer_of, role_of
from tsa_ctrl.ipc.protocol import is_socket, make_private, private_folder

CLIENTS = 16  # connections of one role; a further one replaces the one that has been silent longest
ACCEPTED = 16  # connections that are accepted at once
BACKLOG = 256  # connections that wait until the server accepts them


def listen(path: str, group: str | None, watch_group: str | None = None) -> socket.socket:
    """A listening socket for its owner alone (0600), or also for a group (0660); raises UsageError.

    A file has one group: where there are two, every user may connect (0666), and `peers.role_of` decides who stays.
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
        if bound:  # else it is another's
            place.unlink(missing_ok=True)
        if bound and isinstance(error, PermissionError):
            key, name = ("group", group) if group is not None else ("watch_group", watch_group)
            raise UsageError(
                f"[socket] {key} '{name}': {path} cannot be given to it ({error.strerror}); give a group of this user"
            ) from None
        raise UsageError(f"[socket] path {path}: cannot listen there ({error.strerror}); give another path") from None
    return listener


@contextlib.contextmanager
def listening(path: str, group: str | None, watch_group: str | None = None) -> Iterator[socket.socket]:
    """As `listen`, while inside; the socket's name goes with it, unless another has taken it meanwhile."""
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
    """Yield the clients that wait for a connection, at most ACCEPTED of them; a user without a role is rejected.

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
    """Return the number of a group. The UsageError for an unknown one names `key` of the configuration."""
    try:
        return grp.getgrnam(name).gr_gid
    except KeyError:
        raise UsageError(f"[socket] {key} '{name}': no such group; give one that exists") from None


def _replace(place: Path) -> None:
    """Remove a socket without a listening process."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(place))
        except OSError:  # left over from a daemon that was killed
            try:
                place.unlink()
            except OSError as error:
                raise UsageError(
                    f"{place}: is left over and cannot be removed ({error.strerror}); remove it, or give another "
                    "[socket] path"
                ) from None
        else:
            raise UsageError(f"{place}: another daemon answers there; stop it, or give another [socket] path")
