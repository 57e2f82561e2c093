"""Client of a running daemon: requests, measurements, events, and a lease for streaming set-points.

`tsa_ctrl.Client` is the class of this module, and `tsa help client` shows its page.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from types import TracebackType
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from tsa_ctrl.arguments import kind_of, listing_arguments, number_of, path_of
from tsa_ctrl.errors import BusError, LeaseLostError, UsageError
from tsa_ctrl.ipc import protocol, server_process
from tsa_ctrl.ipc.connection import peer_of
from tsa_ctrl.ipc.protocol import AnyRequest, Event, default_path
from tsa_ctrl.signals import Kind, Place, signals_of

LONGEST_ANSWER = 4 * 1024 * 1024  # bytes
PIECE = 65536  # bytes
MOST_RATE = 4000.0  # Hz: no loop is faster
QUEUE_WAIT = 0.01  # s between two attempts to connect while the queue of connections is full
STOP_TIMEOUT = 1.0  # s for the answer to a stop request; a working server answers within milliseconds

T = TypeVar("T")


class _Axis(msgspec.Struct, frozen=True, kw_only=True):
    """Measurements of one axis in one cycle, with one attribute for each signal of the client (`signals`).

    A value is a float, or None for a quantity that this rig does not measure. A code is a str, a flag is a bool.
    """

    name: str
    set_point_limit: float | None = None  # N*m, largest magnitude of a set-point; None: not set over the socket
    clamped: bool = False  # True if the newest set-point exceeded the limit and was clamped

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...


if TYPE_CHECKING:
    AxisMeasured = _Axis
else:
    _TYPES = {Kind.CODE: str, Kind.FLAG: bool, Kind.COUNT: int | None}
    AxisMeasured = msgspec.defstruct(
        "AxisMeasured",
        [(signal.name, _TYPES.get(signal.kind, float | None)) for signal in signals_of(Place.CLIENT)],
        bases=(_Axis,),
        namespace={"__doc__": _Axis.__doc__},
        frozen=True,
        kw_only=True,
    )


class Measured(msgspec.Struct, frozen=True):
    """Measurements of one cycle; `measured["knee"]` returns the values of one axis."""

    time: float  # s, CLOCK_MONOTONIC, of the cycle
    age: float | None  # s since then; None before the first cycle
    cycle: int
    phase: str  # "settling", "running", "stopping", "faulted", "resetting", ...
    axes: list[AxisMeasured]

    def __getitem__(self, name: str) -> AxisMeasured:
        """Return the measurements of one axis; raise KeyError for an unknown axis."""
        for axis in self.axes:
            if axis.name == name:
                return axis
        raise KeyError(name)


LONGEST_TIMEOUT = 1e6  # s


class Client:
    """A connection to the daemon; use it as a context manager and in one thread only."""

    def __init__(
        self,
        path: str | None = None,
        timeout: float = 3.0,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Connect to the daemon.

        Args:
            path: socket of the daemon; None: the default socket of this user.
            timeout: longest time to wait for an answer, s.
            clock: returns the monotonic time, s.
            sleep: sleeps for a time in s.

        Raises:
            BusError: no daemon answers there.
            UsageError: an argument has a wrong type.
        """
        if path is not None:
            path = str(path_of(path, "Client", "the path of the daemon's socket"))
        timeout = number_of(timeout, "Client: timeout in s", 0.0, LONGEST_TIMEOUT)
        self.clock = clock
        self._sleep = sleep
        self._path = path = default_path() if path is None else path
        self._timeout = timeout
        self._received = b""
        self._unanswered = False  # True from a request to its answer, also after a time-out or an interrupt
        self._lease: Lease | None = None
        self._next_event = 0
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(timeout)
        try:
            self._connect(path, timeout)
        except OSError as error:
            self._socket.close()
            process = server_process.running(path)
            if process is not None:
                raise BusError(
                    f"{path}: no daemon answers there yet; process {process} is starting, or restarts its socket "
                    "server; try again in some seconds"
                ) from None
            raise BusError(
                f"{path}: no daemon answers there ({error.strerror or error}); "
                "start one with `tsa run CONTROLLER.toml`, or give its --socket"
            ) from None
        user = peer_of(self._socket).user
        if user not in (0, os.getuid()) and path == default_path():
            self._socket.close()
            raise BusError(f"{path}: user {user} answers there, not yours; look who made that file")
        self._socket.setblocking(False)

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _connect(self, path: str, patience: float) -> None:
        """Connect, and wait up to `patience` s for a place in the queue of connections; raise OSError if that fails."""
        end = time.monotonic() + patience
        while True:
            try:
                return self._socket.connect(path)
            except BlockingIOError:  # the queue is full
                if time.monotonic() > end:
                    raise
                time.sleep(QUEUE_WAIT)

    def close(self) -> None:
        """Close the connection, which also ends a lease."""
        self._socket.close()

    def ask(self, request: AnyRequest) -> dict[str, Any]:
        """Return the object of the answer; raise UsageError if the request is rejected, BusError without an answer.

        After a time-out or an interrupt, the late answer is discarded before the next request is sent.
        """
        end = time.monotonic() + self._timeout
        if self._unanswered:
            self._answer(end)
        self._unanswered = True
        with contextlib.suppress(OSError):  # a refusal may wait to be read
            self._write(msgspec.json.encode(request) + b"\n", self._timeout)
        message = self._answer(end)
        if not message.pop("ok"):
            raise UsageError(f"daemon: {message['error']}")
        return message

    def _answer(self, end: float) -> dict[str, Any]:
        """Return the next answer; raise BusError if none arrives until `end` (monotonic s)."""
        while True:
            for message in self._messages():
                if not self._take(message):
                    return message
            self._read(end - time.monotonic())

    def measure(self) -> Measured:
        """Return the measurements of the newest cycle; before the first cycle, zeros with the age None.

        Raises:
            BusError: the daemon does not answer.
        """
        return self._as(self.ask(protocol.Measure()), Measured)

    def cycles(self, rate: float) -> Iterator[Measured]:
        """Yield `measure()` at `rate` (Hz), beginning with the loop's first cycle; missed times are skipped.

        Raises:
            UsageError: `rate` is out of range.
            BusError: the daemon does not answer.
        """
        if not 0.0 < rate <= MOST_RATE:
            raise UsageError(f"rate {rate:g} Hz: allowed is above 0 to {MOST_RATE:g}")
        period, due = 1.0 / rate, self.clock()
        while True:
            measured = self.measure()
            if measured.age is not None:
                yield measured
            due += period
            now = self.clock()
            if due < now:
                due += math.ceil((now - due) / period) * period
            self._sleep(due - now)

    def events(self) -> list[Event]:
        """Return the events since the last call, including faults; raise BusError without an answer."""
        found = self._as(self.ask(protocol.Events(self._next_event)).get("events"), list[Event])
        if found:
            self._next_event = found[-1].number + 1
        return found

    def lease(self, seconds: float = 0.2) -> Lease:
        """Acquire the lease of the set-points of all axes; it is lost after `seconds` without a set-point.

        Raises:
            UsageError: another client holds the lease, or no axis takes its set-point from the socket.
            BusError: the daemon does not answer.
        """
        seconds = number_of(seconds, "lease: seconds")
        self.ask(protocol.Lease(seconds))
        self._lease = Lease(self, seconds)
        return self._lease

    def recover(self) -> None:
        """Request a recovery from a latched fault; raise UsageError if it is rejected, BusError without an answer."""
        self.ask(protocol.Recover())

    def stop(self) -> dict[str, Any]:
        """Ramp the torque to 0 and end the daemon, by SIGTERM if its socket rejects the request or does not answer.

        Returns the answer, or `signalled` (a process id) and `reason`. Raises the errors of `server_process.stop`.
        """
        return stop_daemon(self._path, self._timeout)  # another connection: this one may wait for an answer

    def stream(self, lines: bytes, patience: float) -> None:
        """Send lines that have no answer, and process received events; `Lease` uses it.

        A server that is hundreds of values behind has `patience` s to read, then LeaseLostError is raised.
        """
        with contextlib.suppress(OSError):  # the next read reports the end, after earlier messages
            self._write(lines, patience)
        self._read(0.0)
        for message in self._messages():
            self._take(message)

    def _as(self, found: object, kind: type[T]) -> T:
        try:
            return msgspec.convert(found, kind)
        except msgspec.ValidationError as error:
            raise BusError(f"{self._path}: the daemon is of another version ({error}); start it again") from None

    def _ended(self, why: str) -> BusError:
        """Return the error to raise when the connection has ended."""
        if self._lease is None or self._lease.given_back:
            return BusError(f"{self._path}: {why}")
        self._lease.why = self._lease.why or why
        return LeaseLostError(f"{self._path}: the set-point's lease is lost: {self._lease.why}")

    def _write(self, data: bytes, patience: float) -> None:
        while data:
            try:
                data = data[self._socket.send(data) :]
            except BlockingIOError:
                if not select.select([], [self._socket], [], patience)[1]:
                    self.close()  # a partly sent line cannot be withdrawn
                    raise self._ended("the socket's server does not read any longer; is it hanging?") from None

    def _read(self, patience: float) -> None:
        """Read the data that arrives within `patience` s (0: without waiting). Raises BusError, LeaseLostError."""
        if self._socket.fileno() < 0:
            raise self._ended("the connection is closed")
        readable = select.select([self._socket], [], [], max(patience, 0.0))[0]
        if not readable:
            if patience != 0.0:
                raise BusError(f"{self._path}: the daemon does not answer (timed out); is it hanging?")
            return
        try:
            data = self._socket.recv(PIECE)
        except OSError:
            data = b""
        if not data or len(self._received) > LONGEST_ANSWER:
            raise self._ended("the daemon closed the connection; see its output")
        self._received += data

    def _messages(self) -> Iterator[dict[str, Any]]:
        while b"\n" in self._received:
            line, _, self._received = self._received.partition(b"\n")
            yield msgspec.json.decode(line)

    def _take(self, message: dict[str, Any]) -> bool:
        """Return True if the message is an event for the lease's holder rather than an answer."""
        if "event" not in message:
            self._unanswered = False
            return False
        if self._lease is not None:
            self._lease.take(message)
        return True


class Lease:
    """The right to send set-points. It ends with the `with` block, or with a LeaseLostError that states the reason."""

    def __init__(self, client: Client, seconds: float) -> None:
        self.seconds = seconds
        self.why = ""  # reason why it was lost
        self.given_back = False
        self._client = client
        self.clamped: dict[str, float] = {}  # N*m by axis: the limit to which a value was clamped
        self._refused = ""
        self._confirmed = client.clock()  # s, time of the newest value whose arrival was confirmed

    def __enter__(self) -> Lease:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with contextlib.suppress(BusError, UsageError):  # the error that ended the block has priority
            self.release()

    @property
    def held(self) -> bool:
        """Return True unless this client has received the end of the lease."""
        return not self.why

    @listing_arguments
    def send(self, values: Mapping[str, float], wanted: float | None = None) -> None:
        """Send the desired joint torque (N*m) by axis without an answer; a new value replaces the last one of its axis.

        A value beyond the axis' `set_point_limit` is clamped to it; `clamped` and the next measurement report this.

        Args:
            values: N*m by axis.
            wanted: time stamp of the set-points, from which their time-out counts, s of `clock`; None: now.

        Raises:
            LeaseLostError: the lease is lost.
            UsageError: a value is not finite, or this or an earlier value was rejected.
        """
        client = self._client
        now = client.clock()
        if not isinstance(values, Mapping):
            raise UsageError(
                f"send: found a {kind_of(values)}; give the torques in N*m by axis, such as {{'knee': 0.3}}"
            )
        values = {str(axis): number_of(value, f"send: axis '{axis}'") for axis, value in values.items()}
        for axis, value in values.items():
            if not math.isfinite(value):
                raise UsageError(f"axis '{axis}': a set-point of {value}; not a finite number")
        if self.held:
            time = now if wanted is None else number_of(wanted, "send: wanted")
            requests = (protocol.SetPointValue(axis, value, time, True) for axis, value in values.items())
            client.stream(b"".join(msgspec.json.encode(request) + b"\n" for request in requests), self.seconds)
            if now - self._confirmed > self.seconds and self.held:
                self.why = f"no value was confirmed for {self.seconds:g} s; does the socket's server hang?"
        if self.why:
            raise LeaseLostError(f"the set-point's lease is lost: {self.why}")
        if self._refused:
            refused, self._refused = self._refused, ""
            raise UsageError(f"daemon: {refused}")

    def release(self) -> None:
        """Release the lease, so that the set-point goes to 0 at its rate; does nothing if the lease is lost."""
        if self.held:
            self.why, self.given_back = "it was given back", True
            self._client.ask(protocol.Release())

    def take(self, message: Mapping[str, Any]) -> None:
        """Process an event of the server about the lease."""
        if message["event"] == "clamped":
            self.clamped[message["axis"]] = message["clamped"]
        elif message["event"] == "refused":
            self._refused = message["error"]
        elif message["event"] == "lease" and message["held"]:
            self._confirmed = message["time"]
        elif message["event"] == "lease":
            self.why = self.why or message["why"]


def stop_daemon(path: str, timeout: float = STOP_TIMEOUT) -> dict[str, Any]:
    """Ramp the torque to 0 and end the daemon behind a socket; see `Client.stop`, `timeout` in s."""

    def ask() -> dict[str, Any]:
        with Client(path, timeout) as client:
            return client.ask(protocol.Stop())

    return server_process.stop(path, ask)
