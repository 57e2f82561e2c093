"""The process behind the local socket: `python -m tsa_ctrl.ipc.server FD`, its description as JSON on stdin.

Everything is bounded: clients, line length, waiting answers, time to finish a line. Whatever clients do costs this
process, never the loop, which takes at most one command per cycle from the mailbox. It ends with the daemon: their pipe
closes however the daemon dies.
"""

from __future__ import annotations

import contextlib
import difflib
import grp
import os
import selectors
import signal
import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from tsa_ctrl.errors import TsaError, UsageError
from tsa_ctrl.ipc.mailbox import RECOVER, Command, Mailbox
from tsa_ctrl.ipc.protocol import (
    LONGEST_LINE,
    AnyRequest,
    Description,
    Recover,
    Set,
    SetPointValue,
    Status,
    Stop,
    is_socket,
    make_private,
    private_folder,
    user_of,
)
from tsa_ctrl.ipc.report import EventPrinter, status_report
from tsa_ctrl.system.signals import ignore

CLIENTS = 16
UNSENT = 256 * 1024  # bytes of answers that a client may leave unread
IDLE = 30.0  # s without a request after which a client is let go
TICK = 0.005  # s between looks for answers while a command is on its way
ANSWER_TIME = 1.0  # s for the loop to take a command
READY = b"ready\n"

_decode = msgspec.json.Decoder(AnyRequest).decode
_encode = msgspec.json.encode


class Client:
    """One connection: bytes received and not yet a line, bytes not yet sent."""

    def __init__(self, connection: socket.socket, now: float) -> None:
        self.connection = connection
        self.user = user_of(connection)
        self.received = b""
        self.unsent = b""
        self.last = now
        self.pending: list[tuple[int, float, dict[str, Any]]] = []  # ticket, since when, answer


class Server:
    """Answers requests from the mailbox; `step` is one look at everything that can happen."""

    def __init__(
        self,
        listener: socket.socket,
        mailbox: Mailbox,
        description: Description,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """What a server before this one was told is withdrawn: its clients are gone."""
        self._clock = clock
        self._wanting: Client | None = None  # whose set-points the loop follows
        mailbox.withdraw()
        self._listener = listener
        self._mailbox = mailbox
        self._description = description
        self._clients: dict[int, Client] = {}
        self._selector = selectors.DefaultSelector()
        self._selector.register(listener, selectors.EVENT_READ)

    def watch(self, descriptor: int) -> None:
        """Also wake up when this descriptor becomes readable."""
        self._selector.register(descriptor, selectors.EVENT_READ)

    def step(self, timeout: float) -> list[int]:
        """Handle what is there within `timeout` s; returns the watched descriptors that became readable."""
        waiting = any(client.pending for client in self._clients.values())
        others: list[int] = []
        for key, _ in self._selector.select(min(timeout, TICK) if waiting else timeout):
            now = self._clock()
            if key.fileobj is self._listener:
                self._accept(now)
            elif key.fd in self._clients:
                self._receive(self._clients[key.fd], now)
            else:
                others.append(key.fd)
        now = self._clock()
        for client in list(self._clients.values()):
            self._settle(client, now)
            self._send(client)
            if now - client.last > IDLE and not client.pending:
                self._drop(client)
        return others

    def close(self) -> None:
        for client in list(self._clients.values()):
            self._drop(client)
        self._selector.close()
        self._listener.close()

    def _accept(self, now: float) -> None:
        with contextlib.suppress(OSError):
            connection, _ = self._listener.accept()
            connection.setblocking(False)
            if len(self._clients) >= CLIENTS:
                with contextlib.suppress(OSError):
                    connection.send(_line(_error(f"{CLIENTS} clients are connected already; try again later")))
                connection.close()
                return
            self._clients[connection.fileno()] = Client(connection, now)
            self._selector.register(connection, selectors.EVENT_READ)

    def _receive(self, client: Client, now: float) -> None:
        try:
            data = client.connection.recv(LONGEST_LINE)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(client)
            return
        client.received += data
        *lines, client.received = client.received.split(b"\n")
        for line in lines:
            client.last = now
            client.unsent += self._answer(client, line, now)
        if len(client.received) > LONGEST_LINE:
            client.unsent += _line(_error(f"a request is longer than {LONGEST_LINE} bytes; send one object per line"))
            self._send(client)
            self._drop(client)

    def _answer(self, client: Client, line: bytes, now: float) -> bytes:
        """The answer's bytes, or nothing while the loop has to take a command first."""
        try:
            request = _decode(line)
            if isinstance(request, Recover) and client.user not in (0, os.getuid()):
                raise UsageError("recover: only the user who started the daemon may; ask at the machine")
            command, answer = self._handle(client, request, now)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            return _line(_error(f"not a request: {error}"))
        except RecursionError:
            return _line(_error("not a request: nested too deeply; one flat object per line"))
        except UsageError as error:
            return _line(_error(str(error)))
        if command is None:
            return _line(answer)
        ticket = self._mailbox.put(command)
        if ticket is None:
            return _line(_error("too many commands are waiting; try again"))
        client.pending.append((ticket, now, answer))
        return b""

    def _handle(self, client: Client, request: AnyRequest, now: float) -> tuple[Command | None, dict[str, Any]]:
        """The command that a request means, if any, and the answer once it is taken."""
        match request:
            case Status():
                return None, {"ok": True, **status_report(self._mailbox, self._description, now)}
            case Stop():
                self._mailbox.request_stop()
                return None, {"ok": True, "waiting_for": self._mailbox.stage()[1] or None}
            case Recover():
                return Command(0, RECOVER, 0.0), {"ok": True}
            case SetPointValue(axis=axis, value=value, time=wanted):
                index = self._axis(axis)
                limit = self._description.set_point_limit[index]
                if limit is None:
                    raise UsageError(f"axis '{axis}': its set-point does not come over the socket; see setpoint.kind")
                _inside("set-point", value, -limit, limit, "N*m")
                self._mailbox.want(index, value, now if wanted is None else wanted)
                self._wanting = client
                return None, {"ok": True}
            case Set(name=name, value=value):
                return self._set(name, value)

    def _set(self, name: str, value: float) -> tuple[Command, dict[str, Any]]:
        axis, dot, parameter = name.rpartition(".")
        description = self._description
        if not dot and len(description.axes) > 1:
            raise UsageError(f"'{name}': say of which axis: {', '.join(f'{axis}.{name}' for axis in description.axes)}")
        index = self._axis(axis) if dot else 0
        ranges = description.parameters[index]
        for number, known in enumerate(ranges):
            if known.name == parameter:
                if known.low is None or known.high is None:
                    raise UsageError(f"'{parameter}' cannot be set with this axis' estimator; see estimator.kind")
                _inside(parameter, value, known.low, known.high, known.unit)
                before = self._mailbox.status()[1][index][1][number]
                answer = {"ok": True, "axis": description.axes[index], "name": parameter, "unit": known.unit}
                return Command(index, number, value), {**answer, "before": before, "value": value}
        names = [known.name for known in ranges]
        near = difflib.get_close_matches(parameter, names, n=1)
        advice = f"did you mean '{near[0]}'?" if near else f"known are {', '.join(names)}"
        raise UsageError(f"no parameter '{parameter}'; {advice}")

    def _axis(self, name: str) -> int:
        try:
            return self._description.axes.index(name)
        except ValueError:
            raise UsageError(f"no axis '{name}'; known are {', '.join(self._description.axes)}") from None

    def _settle(self, client: Client, now: float) -> None:
        """Answer what the loop has taken, or not taken in time."""
        waiting = []
        for ticket, since, answer in client.pending:
            if self._mailbox.taken(ticket):
                client.unsent += _line(answer)
            elif now - since > ANSWER_TIME:
                client.unsent += _line(_error(f"the loop did not take the command within {ANSWER_TIME:g} s"))
            else:
                waiting.append((ticket, since, answer))
        client.pending = waiting

    def _send(self, client: Client) -> None:
        if not client.unsent or client.connection.fileno() < 0:
            return
        try:
            sent = client.connection.send(client.unsent)
            client.unsent = client.unsent[sent:]
        except BlockingIOError:
            pass
        except OSError:
            self._drop(client)
        if len(client.unsent) > UNSENT:
            self._drop(client)

    def _drop(self, client: Client) -> None:
        descriptor = client.connection.fileno()
        if client is self._wanting:
            self._wanting = None
            self._mailbox.withdraw()
        if descriptor >= 0:
            self._clients.pop(descriptor, None)
            self._selector.unregister(client.connection)
            client.connection.close()


def _inside(name: str, value: float, low: float, high: float, unit: str) -> None:
    if not low <= value <= high:
        of = "" if unit == "1" else f" {unit}"
        raise UsageError(f"{name} {value:g}{of} is out of bounds; allowed is {low:g} to {high:g}{of}")


def _error(text: str) -> dict[str, Any]:
    return {"ok": False, "error": text}


def _line(answer: dict[str, Any]) -> bytes:
    return _encode(answer) + b"\n"


def listen(path: str, group: str | None) -> socket.socket:
    """A listening socket for its owner alone (0600), or also for a group (0660); raises UsageError."""
    place = Path(path)
    if str(place.parent) == private_folder():
        make_private(str(place.parent))
    if is_socket(path):
        probe = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        with probe:
            try:
                probe.connect(path)
            except OSError:  # left over from a daemon that was killed
                try:
                    place.unlink()
                except OSError as error:
                    raise UsageError(
                        f"{path}: is left over and cannot be removed ({error.strerror}); remove it, or give another "
                        "[socket] path"
                    ) from None
            else:
                raise UsageError(f"{path}: another daemon answers there; stop it, or give another [socket] path")
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    bound = False
    try:
        before = os.umask(0o177)
        try:
            listener.bind(path)
        finally:
            os.umask(before)
        bound = True
        if group is not None:
            os.chown(path, -1, grp.getgrnam(group).gr_gid)
            place.chmod(0o660)
        listener.listen(CLIENTS)
        listener.setblocking(False)
    except (KeyError, OSError) as error:
        listener.close()
        if bound:  # else it is another's
            place.unlink(missing_ok=True)
        if isinstance(error, KeyError):
            raise UsageError(f"[socket] group '{group}': no such group; give one that exists") from None
        if bound and isinstance(error, PermissionError):
            raise UsageError(
                f"[socket] group '{group}': {path} cannot be given to it ({error.strerror}); give a group of this user"
            ) from None
        raise UsageError(f"[socket] path {path}: cannot listen there ({error.strerror}); give another path") from None
    return listener


def main(argv: list[str]) -> int:
    """Serve until the daemon's end of stdin closes; events are printed as they come."""
    ignore(signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # they reach the whole group; the daemon decides
    asked = sys.stdin.buffer.readline()
    if not asked:  # the daemon is gone already
        return 0
    description = msgspec.json.decode(asked, type=Description)
    mailbox = Mailbox(len(description.axes), len(description.parameters[0]), int(argv[0]))
    try:
        server = Server(listen(description.path, description.group), mailbox, description)
    except TsaError as error:
        os.write(sys.stdout.fileno(), f"{error}\n".encode())
        return error.exit_code
    owned = Path(description.path).stat().st_ino
    with contextlib.suppress(BrokenPipeError):  # then stdin says the same
        os.write(sys.stdout.fileno(), READY)
    daemon = sys.stdin.fileno()
    server.watch(daemon)
    watcher = EventPrinter(mailbox)
    try:
        while daemon not in server.step(0.2):
            watcher.update()
        watcher.update()
        watcher.finish(0.5)
    finally:
        server.close()
        with contextlib.suppress(OSError):
            if Path(description.path).stat().st_ino == owned:
                Path(description.path).unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
