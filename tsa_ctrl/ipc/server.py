"""Run the server of the local socket: `python -m tsa_ctrl.ipc.server FD`, with its description as JSON on stdin.

The daemon starts it first. It sends an `Opening`, then a line for each stage of its startup, then the description.

Everything is bounded: clients, line length, waiting answers, time to finish a line. Clients can load only this process,
never the loop, which takes at most one command per cycle from the mailbox. If this process hangs or dies, another one
replaces it and listens on the same socket (`system.process_supervisor`). It ends with the daemon, because their pipe
closes even if the daemon is killed.

A stop request is handled before all others. The client that sends set-points waits for at most one request of one other
client. Each role has its own connections. A new connection
replaces the one that has been silent longest, so that connections cannot block a new one. The set-point has one owner
at a time: its lease is renewed by set-points and ends after a time without any.
"""

from __future__ import annotations

import contextlib
import math
import os
import selectors
import signal
import socket
import sys
import time
from collections.abc import Callable
from typing import Any

import msgspec

from tsa_ctrl.errors import TsaError, UsageError
from tsa_ctrl.ipc import protocol
from tsa_ctrl.ipc.connection import CLIENTS, Connection, Role, accepted, group_number, listening, may
from tsa_ctrl.ipc.mailbox import Command, Mailbox
from tsa_ctrl.ipc.parameters import axis_index, change, clamped, recovery
from tsa_ctrl.ipc.protocol import AnyRequest, Description, Opening
from tsa_ctrl.ipc.report import EventPrinter, events_since, measurement, status_report, waits_for
from tsa_ctrl.system.process_supervisor import READY, ignore, supervise

IDLE = 30.0  # s without a request after which a client is disconnected
TICK = 0.005  # s between two checks for answers while a command is pending
LOOK = 0.02  # s between two checks of events and cycles while a client holds the lease
ANSWER_TIME = 1.0  # s for the loop to take a command
NICE = -10  # above other processes of a loaded machine, so that set-points arrive in time; the loop is above this
HANGS = 0.5  # s without a cycle after which the loop counts as hanging
AHEAD = 0.1  # s; a set-point's time stamp that is further ahead is from another clock
REPLACED = 1.5  # s without a sign of life (five per second) after which another server takes over
ENDING = ("stopping", "ended")  # phases
STARTING = "starting"  # the phase before the daemon has described itself
HAND_OVER = 0.2  # s in which clients that connected during startup are served before they must connect again
_ALWAYS = (protocol.Status, protocol.Measure, protocol.Events, protocol.Stop)  # requests permitted during startup
SHORTEST, LONGEST = 0.02, 10.0  # s, bounds of a lease
CONFIRMED = 0.25  # share of the lease between two confirmations to its holder


class Lease:
    """The lease of the client that may send set-points.

    A client that sends a set-point without a lease also holds the lease while that value acts. It receives no events
    about the lease.
    """

    def __init__(self, withdraw: Callable[[], None], tell: Callable[[str], None]) -> None:
        """`withdraw` is called at each end of the lease; `tell` receives the text of an event."""
        self.holder: Connection | None = None
        self.seconds = 0.0
        self._silently = True
        self._until = 0.0
        self._confirmed = 0.0
        self._withdraw = withdraw
        self._tell = tell

    @property
    def listener(self) -> Connection | None:
        """Return the holder if it receives events about the lease."""
        return None if self._silently else self.holder

    def left(self, now: float) -> float:
        """Return the time until the lease ends, s."""
        return self._until - now

    def report(self, now: float) -> dict[str, Any] | None:
        """Return the holder and the remaining time (s) for the status, or None without a holder."""
        if self.holder is None:
            return None
        process, user, _ = self.holder.peer
        return {"process": process, "user": user, "seconds": self.seconds, "left": max(0.0, self.left(now))}

    def take(self, client: Connection, seconds: float, now: float) -> None:
        """Take or renew the lease; raise UsageError if another client holds it, or if `seconds` is out of bounds."""
        if not SHORTEST <= seconds <= LONGEST:
            raise UsageError(f"a lease of {seconds:g} s; allowed is {SHORTEST:g} to {LONGEST:g} s")
        self._refuse_others(client, now)
        if self.listener is None:
            self._confirmed = now
            self._tell(f"set-point: {client.peer} holds its lease of {seconds:g} s")
        self.holder, self.seconds, self._silently, self._until = client, seconds, False, now + seconds

    def use(self, client: Connection, seconds: float, now: float) -> None:
        """Renew the lease by a set-point, which acts for `seconds`; raise UsageError if another client holds it."""
        self._refuse_others(client, now)
        if self.listener is None:
            self.holder, self.seconds = client, seconds
        self._until = now + self.seconds

    def confirm(self, time: float, now: float) -> None:
        """Confirm to the holder, a few times per lease period, that the value of `time` has arrived."""
        if self.listener is not None and now - self._confirmed >= CONFIRMED * self.seconds:
            self._confirmed = now
            self.listener.push({"event": "lease", "held": True, "time": time})

    def end(self, why: str) -> None:
        """End the lease, withdraw the set-points and report `why` to the holder and as an event."""
        if self.listener is not None:
            self._tell(f"set-point: {self.listener.peer} no longer holds its lease: {why}")
            self.listener.push({"event": "lease", "held": False, "why": why})
        self.holder, self._silently = None, True
        self._withdraw()

    def check(self, now: float) -> None:
        """End the lease if its time has expired."""
        if self.holder is not None and now > self._until:
            self.end(f"no set-point came for {self.seconds:g} s")

    def _refuse_others(self, client: Connection, now: float) -> None:
        if self.holder is not None and self.holder is not client:
            raise UsageError(
                f"the set-point is held by {self.holder.peer} (lease of {self.seconds:g} s, {self.left(now):.2g} s of "
                "it left, renewed by each value); wait for its end, or stop that process"
            )


class Server:
    """Answer requests from the mailbox; `step` handles all pending events once."""

    def __init__(
        self,
        listener: socket.socket,
        mailbox: Mailbox,
        description: Description,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Withdraw the set-points of an earlier server, whose clients are gone. An unknown group raises UsageError."""
        groups = (("group", description.group), ("watch_group", description.watch_group))
        self._command, self._watch = ({group_number(name, key)} if name else set() for key, name in groups)
        self._clock = clock
        listener.setblocking(False)  # connections are accepted until none waits
        self._listener = listener
        self._mailbox = mailbox
        self._description = description
        self._clients: dict[int, Connection] = {}
        self._turn: list[Connection] = []  # clients in the order in which they are served, one line each
        self._lease = Lease(self._withdraw, lambda text: mailbox.tell(self._clock(), text))
        self._told = 0  # number of the next event for the lease's holder
        self._read = 0  # number of the last events that were read
        self._looked = -math.inf  # s
        self._withdraw()
        self._selector = selectors.DefaultSelector()
        self._selector.register(listener, selectors.EVENT_READ)

    def watch(self, descriptor: int) -> None:
        """Also wake up when this descriptor becomes readable."""
        self._selector.register(descriptor, selectors.EVENT_READ)

    def step(self, timeout: float) -> list[int]:
        """Handle the requests that arrive within `timeout` s; return the watched descriptors that became readable."""
        others: list[int] = []
        connecting = False
        for key, _ in self._selector.select(self._patience(timeout)):
            now = self._clock()
            if key.fileobj is self._listener:
                connecting = True
            elif key.fd in self._clients:
                client = self._clients[key.fd]
                client.receive(now)
            else:
                others.append(key.fd)
        now = self._clock()
        if connecting:  # last, so that no client is replaced before its request was read
            self._accept(now)
        self._answer_stops(now)
        self._answer_all(self._lease.holder, now)
        self._lease.check(now)
        self._answer_next(now)
        self._look(now)
        for client in list(self._clients.values()):
            client.settle(self._mailbox.taken, now, ANSWER_TIME)
            client.send()
            if client.gone or (now - client.last > IDLE and not client.pending):
                self._drop(client)
        return others

    def hand_over(self) -> None:
        """Accept no more connections, and serve the connected clients for at most `HAND_OVER` s."""
        self._selector.unregister(self._listener)
        end = self._clock() + HAND_OVER
        while self._clients and self._clock() < end:
            self.step(TICK)

    def close(self) -> None:
        """Inform the holder of the lease that the daemon has ended, and close all connections."""
        if self._lease.listener is not None:
            self._lease.end("the daemon has ended")
        for client in list(self._clients.values()):
            client.send()
            self._drop(client)
        self._selector.close()
        self._listener.close()

    def _patience(self, timeout: float) -> float:
        """Return the longest time to wait for a request, s."""
        clients, now = self._clients.values(), self._clock()
        if any(client.lines for client in clients):
            return 0.0
        if any(client.pending for client in clients):
            return min(timeout, TICK)
        if self._lease.holder is not None:
            return max(0.0, min(timeout, LOOK, self._lease.left(now)))
        return timeout

    def _accept(self, now: float) -> None:
        """Accept waiting connections, a bounded number of them."""
        for client in accepted(self._listener, self._command, self._watch, now):
            self._make_room(client.role)
            self._clients[client.socket.fileno()] = client
            self._turn.append(client)
            self._selector.register(client.socket, selectors.EVENT_READ)

    def _make_room(self, role: Role) -> None:
        """Close the connection of this role that has been silent longest, unless the role has a free place."""
        known = [client for client in self._clients.values() if client.role is role]
        if len(known) >= CLIENTS:
            silent = min((one for one in known if one is not self._lease.holder), key=lambda one: one.last)
            silent.dismiss(f"this connection was closed because {CLIENTS} others are open; connect again")
            self._drop(silent)

    def _answer_stops(self, now: float) -> None:
        """Answer every client whose next request is a stop."""
        for client in self._clients.values():
            while client.lines and protocol.is_stop(client.lines[0]):
                self._answer(client, client.lines.popleft(), now)

    def _answer_all(self, client: Connection | None, now: float) -> None:
        """Answer all requests of this client."""
        while client is not None and client.lines:
            self._answer(client, client.lines.popleft(), now)

    def _answer_next(self, now: float) -> None:
        """Answer one request of one client, in rotation."""
        for place, client in enumerate(self._turn):
            if client.lines:
                self._turn.append(self._turn.pop(place))
                self._answer(client, client.lines.popleft(), now)
                return

    def _answer(self, client: Connection, line: bytes, now: float) -> None:
        """Answer a request, or pass its command to the loop first."""
        try:
            request = protocol.decode(line)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            client.refuse(f"not a request: {error}")
            return
        except RecursionError:
            client.refuse("not a request: nested too deeply; one flat object per line")
            return
        quiet = isinstance(request, protocol.SetPointValue) and request.quiet
        try:
            found = self._handle(client, request, now)
        except UsageError as error:
            if quiet:
                client.push({"event": "refused", "error": str(error)})
            else:
                client.refuse(str(error))
            return
        if isinstance(found, dict):
            if not quiet:
                client.push({"ok": True, **found})
            return
        command, answer = found
        ticket = self._mailbox.put(command)
        if ticket is None:
            client.refuse("too many commands are waiting; try again")
        elif stage := waits_for(self._mailbox, now)[1]:  # the loop takes it with its first cycle
            client.push({"ok": True, **answer, "waiting_for": stage})
        else:
            client.pending.append((ticket, now, {"ok": True, **answer}))

    def _handle(
        self, client: Connection, request: AnyRequest, now: float
    ) -> dict[str, Any] | tuple[Command, dict[str, Any]]:
        """Return the answer, or a command with the answer to send once the loop has taken it."""
        mailbox, lease = self._mailbox, self._lease
        if not self._description.axes and not isinstance(request, _ALWAYS):
            raise UsageError(f"the daemon is starting ({mailbox.stage()[1]}); try again when it runs")
        match request:
            case protocol.Status():
                return status_report(mailbox, self._description, now, lease.report(now))
            case protocol.Measure():
                return measurement(mailbox, self._description, now, self._clamped)
            case protocol.Events(since=since):
                return {"events": events_since(mailbox, since)}
            case protocol.Set(name=name, value=value):
                may(client, "set", Role.COMMAND)
                return change(mailbox, self._description, name, value, client.role is Role.OWNER, now)
            case protocol.SetPointValue():
                may(client, "setpoint", Role.COMMAND)
                return self._set_point(client, request, now)
            case protocol.Lease(seconds=seconds):
                may(client, "lease", Role.COMMAND)
                self._grant(client, seconds, now)
            case protocol.Release():
                if client is lease.holder:
                    lease.end("it was given back")
            case protocol.Stop():
                may(client, "stop", Role.COMMAND)
                mailbox.request_stop()
                return {"waiting_for": mailbox.stage()[1] or None}
            case protocol.Recover():
                if client.role < Role.OWNER and client is not lease.listener:
                    raise UsageError(
                        "recover: only who holds the set-point's lease or started the daemon may; ask at the machine"
                    )
                return recovery(mailbox, self._description, now), {}
        return {}

    def _grant(self, client: Connection, seconds: float, now: float) -> None:
        if not any(limit is not None for limit in self._description.set_point_limit):
            raise UsageError('lease: no axis takes its set-point from here; see setpoint.kind = "socket"')
        self._lease.take(client, seconds, now)
        events = events_since(self._mailbox, 0)
        self._told = events[-1]["number"] + 1 if events else 0

    def _set_point(self, client: Connection, request: protocol.SetPointValue, now: float) -> dict[str, Any]:
        """Take a set-point, clamped to its range. The answer, or an event for a quiet one, reports the clamping."""
        description, axis = self._description, request.axis
        index = axis_index(description, axis)
        limit, timeout = description.set_point_limit[index], description.set_point_timeout[index]
        if limit is None:
            raise UsageError(f"axis '{axis}': its set-point does not come over the socket; see setpoint.kind")
        value = clamped(request.value, limit)
        wanted = now if request.time is None else request.time
        if not now - timeout <= wanted <= now + AHEAD:
            raise UsageError(
                f"the set-point's time is {abs(now - wanted):.3g} s {'ago' if wanted < now else 'ahead'}; allowed is "
                f"{timeout:g} s ago to now, by CLOCK_MONOTONIC of this machine in s"
            )
        self._lease.use(client, timeout, now)
        if wanted < self._newest[index]:
            raise UsageError("the set-point is older than the present one; send them in the order of time")
        self._newest[index] = wanted
        self._mailbox.want(index, value, wanted)
        self._lease.confirm(wanted, now)
        flag = {} if value == request.value else {"axis": axis, "clamped": value}
        if flag and request.quiet and not self._clamped[index]:
            client.push({"event": "clamped", **flag})
        self._clamped[index] = bool(flag)
        return flag

    def _withdraw(self) -> None:
        self._newest = [-math.inf] * len(self._description.axes)  # s, time stamp of each axis' set-point
        self._clamped = [False] * len(self._description.axes)
        self._mailbox.withdraw()

    def _look(self, now: float) -> None:
        """Check the loop, and send events to the holder of the lease."""
        lease = self._lease
        if lease.listener is None or now - self._looked < LOOK:
            return
        self._looked = now
        cycle, _, phase, _ = self._mailbox.measured()
        if cycle and now - cycle > HANGS and not self._mailbox.stage()[1]:
            ending = self._description.phases[phase] in ENDING
            lease.end("the daemon has ended" if ending else f"the loop hangs, no cycle for {HANGS:g} s")
        elif (found := self._mailbox.text())[0] != self._read:
            self._read = found[0]
            for event in events_since(self._mailbox, self._told):
                self._told = event["number"] + 1
                lease.listener.push({"event": "told", **event})

    def _drop(self, client: Connection) -> None:
        if client is self._lease.holder:
            self._lease.end("its connection ended")
        del self._clients[client.socket.fileno()]
        self._turn.remove(client)
        self._selector.unregister(client.socket)
        client.socket.close()


def main(argv: list[str]) -> int:
    """Serve until the daemon's end of stdin closes; print events as they occur."""
    ignore(signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # the whole process group receives them; the daemon decides
    with contextlib.suppress(OSError):  # if this user may
        os.setpriority(os.PRIO_PROCESS, 0, NICE)
    lines = Lines(sys.stdin.fileno())
    asked = lines.take()
    if not asked:  # the daemon is gone already
        return 0
    opening = msgspec.json.decode(asked, type=Opening)
    try:
        with listening(opening.path, opening.group, opening.watch_group) as listener:
            with contextlib.suppress(BrokenPipeError):  # stdin then reports the end of the daemon
                os.write(sys.stdout.fileno(), READY)
            asked = answer_start(listener, opening, lines)
            if not asked:
                return 0
            description = msgspec.json.decode(asked, type=Description)
            axes, parameters, fd = len(description.axes), len(description.parameters[0]), int(argv[0])
            mailbox = Mailbox(axes, parameters, fd)
            with contextlib.suppress(BrokenPipeError):
                os.write(sys.stdout.fileno(), READY)

            def work(before: int) -> int:
                return serve(listener, Mailbox(axes, parameters, os.dup(fd)), description)

            return supervise(work, mailbox.alive, lambda: mailbox.heard, REPLACED, mailbox.replace)
    except TsaError as error:
        os.write(sys.stdout.fileno(), f"{error}\n".encode())
        return error.exit_code


class Lines:
    """The lines that the daemon sends, one by one."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._received = b""

    def take(self) -> bytes:
        """Wait for the next line and return it; it is empty once the daemon has ended."""
        while b"\n" not in self._received:
            data = os.read(self.descriptor, 1 << 16)
            if not data:
                return b""
            self._received += data
        line, _, self._received = self._received.partition(b"\n")
        return line

    @property
    def waiting(self) -> bool:
        """Return True if a whole line has been received but not taken."""
        return b"\n" in self._received


def answer_start(listener: socket.socket, opening: Opening, lines: Lines) -> bytes:
    """Answer while the daemon starts; return its description, empty if it has ended. A stop request ends the daemon."""
    mailbox = Mailbox(0, 0)
    mailbox.publish_stage(time.monotonic(), "starting")
    place = (opening.path, opening.group, opening.name)
    description = Description(*place, 1.0, [], [], {}, [STARTING], [], {}, watch_group=opening.watch_group)
    server = Server(listener.dup(), mailbox, description)
    server.watch(lines.descriptor)
    stopped = False
    try:
        while True:
            if lines.waiting or lines.descriptor in server.step(0.2):
                line = lines.take()
                if not line or line.startswith(b"{"):
                    server.hand_over()
                    return line
                mailbox.publish_stage(time.monotonic(), line.decode(errors="replace"))
            if mailbox.stop_requested and not stopped:
                stopped = True
                os.kill(os.getppid(), signal.SIGTERM)
    finally:
        server.close()
        mailbox.close()


def serve(listener: socket.socket, mailbox: Mailbox, description: Description) -> int:
    """Serve until the daemon's end of stdin closes, and print each event once, even if the server was replaced."""
    server = Server(listener, mailbox, description)
    daemon = sys.stdin.fileno()
    server.watch(daemon)
    watcher = EventPrinter(mailbox)
    try:
        while daemon not in server.step(0.2):
            mailbox.alive()
            watcher.update()
        watcher.update()
        watcher.finish(0.5)
    finally:
        server.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
