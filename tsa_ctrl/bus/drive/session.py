"""Configuration session: SDO, NMT, EMCY and heartbeats through canopen, on the bus that the loop uses afterwards.

Everything runs in the caller's thread and on the clock of the bus. While the session waits for an answer, it receives
frames and sends our heartbeat. It never starts canopen's thread.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Collection, Iterable
from dataclasses import replace
from types import TracebackType

import can
import canopen
from canopen.sdo import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from tsa_ctrl.bus.canopen import cia301, objects
from tsa_ctrl.bus.canopen.cia301 import Emcy, NmtCommand, NmtState
from tsa_ctrl.bus.canopen.objects import Object
from tsa_ctrl.bus.settings import BusSettings
from tsa_ctrl.bus.wire.bus import REMOTE_FLAG, Bus, Frame, wire_of
from tsa_ctrl.errors import BusError, StoppedError

ABSENT = frozenset({0x06020000, 0x06090011})  # abort codes: no such object, no such subindex

ANSWER_TIMEOUT = 0.5  # s, for one SDO answer, unless the configuration has another value
_ATTEMPTS = 3  # SDO transfers are repeated, because the configuration of a drive is idempotent
_ANSWER_LENGTH = 8  # bytes of every SDO frame
_LISTENING = 0.1  # s, to detect another master before anything is sent
_ASK_EVERY = 0.05  # s, between two requests of node guarding
_PAUSE = 0.005  # s, after a frame that could not be sent
_MOST_WAITING = 512  # maximum number of frames taken before a request
_HIGHEST = 0x7FF  # highest 11-bit identifier; larger values carry flags: error frames, remote requests

# Both libraries log errors to the root logger. These errors are reported here as a one-line exception.
for _name in ("canopen", "can"):
    logging.getLogger(_name).addHandler(logging.NullHandler())


class SdoRefusedError(BusError):
    """A node aborted an SDO transfer with this `code` (CiA 301)."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


class _Network(canopen.Network):  # type: ignore[misc]  # canopen is not followed by mypy
    """canopen's network on a `Bus`; the session passes received frames to `notify`."""

    def __init__(self, bus: Bus) -> None:
        super().__init__()
        self._seam = bus

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        if not self._seam.send(can_id, bytes(data)):
            raise can.CanOperationError(f"{self._seam.name}: frame dropped")


class _Client(SdoClient):  # type: ignore[misc]
    """canopen's SDO client, with `wait(seconds, reached)` in place of a thread."""

    RESPONSE_TIMEOUT = 0.0
    patience = ANSWER_TIMEOUT  # s

    def __init__(self, node_id: int, network: _Network, wait: Callable[[float, Callable[[], bool]], bool]) -> None:
        super().__init__(cia301.SDO_REQUEST + node_id, cia301.SDO_ANSWER + node_id, canopen.ObjectDictionary())
        self.network = network
        self._wait = wait
        self.late = False  # an answer has not arrived in time, so a wrong one may be the answer to an earlier request
        network.subscribe(cia301.SDO_ANSWER + node_id, self._take)

    def _take(self, can_id: int, data: bytearray, timestamp: float) -> None:
        """Pass on an answer of the right length. Others are ignored, because canopen would unpack them anyway."""
        if len(data) == _ANSWER_LENGTH:
            self.on_response(can_id, data, timestamp)

    def read_response(self) -> bytes:
        if not self._wait(self.patience, lambda: not self.responses.empty()):
            self.late = True
        return bytes(super().read_response())


class Session:
    """A context manager that only listens until a method sends something. Its methods raise BusError if the bus fails.

    `touched` holds the nodes that were sent a command or a value. Reading does not change a node.
    """

    def __init__(self, bus: Bus, settings: BusSettings, stopped: Callable[[], str | None] = lambda: None) -> None:
        """`stopped` returns a reason to stop waiting, or None. The session raises it once, as StoppedError."""
        self._bus = bus
        self._settings = settings
        self._stopped = stopped
        self._network = _Network(bus)
        self._clients: dict[int, _Client] = {}
        self._states: dict[int, list[int]] = {}  # NMT states received from each node, in order
        self._heard: set[int] = set()
        self._masters: set[int] = set()
        self._emcys: dict[int, list[Emcy]] = {}
        self._guarded: frozenset[int] = frozenset()
        self._heartbeat = False
        self._next_heartbeat = -math.inf
        self.touched: set[int] = set()

    def __enter__(self) -> Session:
        self._bus.accept(None)
        self._bus.flush()
        for can_id in master_frames(self._settings.host_node_id):
            self._network.subscribe(can_id, self._on_master)
        for node_id in range(1, 128):
            if node_id != self._settings.host_node_id:
                self._network.subscribe(cia301.HEARTBEAT + node_id, self._on_heartbeat)
            self._network.subscribe(cia301.EMCY + node_id, self._on_emergency)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._heartbeat:
            self._bus.send(cia301.HEARTBEAT + self._settings.host_node_id, cia301.heartbeat(NmtState.OPERATIONAL))

    def listen(self, rpdos: Iterable[int] = ()) -> frozenset[int]:
        """Return the identifiers, received within a tenth of a second, that only a master sends, including `rpdos`."""
        for can_id in rpdos:
            self._network.subscribe(can_id, self._on_master)
        self._masters.clear()
        self.wait(_LISTENING)
        return frozenset(self._masters)

    def alone(self, rpdos: Iterable[int] = (), tolerated: frozenset[int] = frozenset()) -> None:
        """Raise BusError if another master sends frames that are not `tolerated`; this method sends nothing."""
        heard = self.listen(rpdos)
        if heard - tolerated:
            raise BusError(another_master(self._bus.name, heard))

    def begin_heartbeat(self) -> None:
        """Send our heartbeat from now on. A loop must continue it afterwards, because its loss is an error."""
        self._heartbeat = True

    def guard(self, node_ids: Collection[int]) -> None:
        """Supervise these nodes, which have no heartbeat, by node guarding: remote frames request their state."""
        self._guarded = frozenset(node_ids)

    def be_patient(self, node_id: int, seconds: float) -> None:
        """Set the time to wait for an SDO answer of this node, s."""
        self._client(node_id).patience = seconds

    def clock(self) -> float:
        """Return the monotonic time of the bus, s."""
        return self._bus.clock()

    def wait(self, seconds: float, reached: Callable[[], bool] = lambda: False) -> bool:
        """Receive frames and send our heartbeat until `reached`, for at most `seconds`.

        Returns:
            True if `reached`. False after `seconds`, or immediately if the bus fails.
        """
        end = self._bus.clock() + seconds
        while not reached():
            cause = self._stopped()
            if cause is not None:
                self._stopped = lambda: None  # the shutdown that follows must still be able to wait
                raise StoppedError(cause)
            now = self._bus.clock()
            self._beat(now)
            due = min(end, self._next_heartbeat) if self._heartbeat else end
            frame = self._bus.recv(max(0.0, due - now))
            if frame is not None:
                self._take(frame, now)
            elif self._bus.fault is not None:
                return False
            if now >= end:
                return reached()
        return True

    def _catch_up(self) -> None:
        """Receive the waiting frames, because a late answer does not belong to the next request."""
        now = self._bus.clock()
        for frame in self._bus.gather(0.0, _MOST_WAITING):
            self._take(frame, now)

    def _take(self, frame: Frame, now: float) -> None:
        can_id, data = frame
        if can_id <= _HIGHEST:
            self._network.notify(can_id, bytearray(data), now)

    @property
    def heard(self) -> set[int]:
        """Return the nodes that sent a heartbeat or a boot-up in this session."""
        return set(self._heard)

    def nmt(self, command: NmtCommand, node_id: int) -> None:
        """Send an NMT command."""
        self.touched.add(node_id)
        if not self._bus.send(cia301.NMT, cia301.nmt(command, node_id)):
            raise self._failed()

    def boot(self, node_ids: Iterable[int], timeout: float) -> set[int]:
        """Reset the communication of these nodes; return those that did not boot up within `timeout` s."""
        nodes = set(node_ids)
        for node_id in nodes:
            self._states[node_id] = []
            self.nmt(NmtCommand.RESET_COMMUNICATION, node_id)
        return self.booted(nodes, timeout)

    def booted(self, node_ids: Iterable[int], timeout: float) -> set[int]:
        """Wait for the boot-up of nodes that were reset; return those that did not boot up within `timeout` s."""
        return self._wait(set(node_ids), lambda states: NmtState.BOOT_UP in states, timeout)

    def start(self, node_ids: Iterable[int], timeout: float) -> set[int]:
        """Start these nodes; return those whose heartbeat did not report "operational" within `timeout` s."""
        nodes = set(node_ids)
        for node_id in nodes:
            self._states[node_id] = []
            self.nmt(NmtCommand.START, node_id)
        return self._wait(nodes, lambda states: NmtState.OPERATIONAL in states, timeout)

    def read(self, node_id: int, entry: Object) -> int:
        """Return an object read by SDO; raise SdoRefusedError or BusError if that fails."""
        return entry.decode(self._transfer(node_id, entry, lambda client: client.upload(*entry.key)))

    def upload_if_there(self, node_id: int, entry: Object, unreadable: list[Object] | None = None) -> bytes | None:
        """Return the bytes of an object, or None if the node rejects the request.

        `unreadable` receives the object if the reason is another one than its absence.
        """
        try:
            return self._transfer(node_id, entry, lambda client: client.upload(*entry.key))
        except SdoRefusedError as error:
            if unreadable is not None and error.code not in ABSENT:
                unreadable.append(entry)
            return None

    def read_if_readable(self, node_id: int, entry: Object, unreadable: list[Object] | None = None) -> int | None:
        """Return an object, or None if the node rejects the request; `unreadable` as in `upload_if_there`."""
        data = self.upload_if_there(node_id, entry, unreadable)
        return None if data is None else entry.decode(data)

    def read_text(self, node_id: int, entry: Object) -> str:
        """Return a text object, or an empty text if the node rejects the request."""
        data = self.upload_if_there(node_id, entry) or b""
        return "".join(c for c in data.decode("latin-1") if c.isprintable()).strip()

    def ask(self, node_id: int, entry: Object) -> int | None:
        """Return an object after one attempt, or None if the node does not answer or rejects the request."""
        try:
            return entry.decode(self._transfer(node_id, entry, lambda client: client.upload(*entry.key), attempts=1))
        except BusError:
            if self._bus.fault is not None:
                raise
            return None

    def write(self, node_id: int, entry: Object, value: int) -> None:
        """Write an object by SDO; raise SdoRefusedError or BusError if that fails."""
        data = entry.encode(value)
        self.touched.add(node_id)
        self._transfer(node_id, entry, lambda client: client.download(*entry.key, data) or b"")

    def read_if_there(self, node_id: int, entry: Object) -> int | None:
        """Return an object, or None if the node lacks it."""
        try:
            return self.read(node_id, entry)
        except SdoRefusedError as error:
            if error.code in ABSENT:
                return None
            raise

    def emcys(self, node_id: int) -> tuple[Emcy, ...]:
        """Return the emergencies of a node in this session, without error resets."""
        return tuple(self._emcys.get(node_id, ()))

    def _transfer(
        self, node_id: int, entry: Object, action: Callable[[_Client], bytes], attempts: int = _ATTEMPTS
    ) -> bytes:
        client, name = self._client(node_id), wire_of(self._bus, node_id).name
        wrong = ""
        for _ in range(attempts):
            self._catch_up()
            try:
                return action(client)
            except SdoAbortedError as error:
                reason = SdoAbortedError.CODES.get(error.code, "unknown reason")
                raise SdoRefusedError(
                    f"{name}: node {node_id} rejects {entry}: {reason} (abort code 0x{error.code:08X})",
                    error.code,
                ) from None
            except SdoCommunicationError as error:
                wrong = "" if client.late else str(error)
            except (can.CanError, OSError):  # a frame was dropped, or the bus failed
                self.wait(_PAUSE)
            if self._bus.fault is not None:
                raise self._failed()
        if wrong:
            raise BusError(
                f"{name}: node {node_id} does not follow CiA 301 in its answer for {entry}: {wrong}; check that no "
                "other node has this id, and report the fault to the manufacturer of the node"
            )
        raise BusError(
            f"{name}: node {node_id} does not answer SDO requests ({entry}) within {client.patience:g} s; "
            "check its power, node id and bit rate; increase answer_timeout if it is only slow"
        )

    def _failed(self) -> BusError:
        reason = "frames cannot be sent" if self._bus.fault is None else self._bus.fault.value
        return BusError(f"{self._bus.name}: {reason}; check adapter, cable and interface, and start again")

    def _client(self, node_id: int) -> _Client:
        if node_id not in self._clients:
            self._clients[node_id] = _Client(node_id, self._network, self.wait)
        return self._clients[node_id]

    def _wait(self, nodes: set[int], reached: Callable[[list[int]], bool], timeout: float) -> set[int]:
        def missing() -> set[int]:
            return {node_id for node_id in nodes if not reached(self._states[node_id])}

        end = self._bus.clock() + timeout
        while missing() and (left := end - self._bus.clock()) > 0.0:
            asked = missing() & self._guarded
            for node_id in asked:
                self._bus.send(REMOTE_FLAG | cia301.HEARTBEAT + node_id, b"")
            self.wait(min(left, _ASK_EVERY) if asked else left, lambda: not missing())
            if self._bus.fault is not None:
                raise self._failed()
        return missing()

    def _on_heartbeat(self, can_id: int, data: bytearray, timestamp: float) -> None:
        state = cia301.heartbeat_state(bytes(data))
        node_id = can_id - cia301.HEARTBEAT
        if state is not None:
            self._heard.add(node_id)
            self._states.setdefault(node_id, []).append(state)

    def _on_emergency(self, can_id: int, data: bytearray, timestamp: float) -> None:
        found = cia301.decode(bytes(data))
        if found is not None and not found.is_reset:
            self._emcys.setdefault(can_id - cia301.EMCY, []).append(found)

    def _on_master(self, can_id: int, data: bytearray, timestamp: float) -> None:
        self._masters.add(can_id)

    def _beat(self, now: float) -> None:
        """Send our heartbeat when it is due. It ends with the session, because it must not outlive the master."""
        if self._heartbeat and now >= self._next_heartbeat:
            self._next_heartbeat = now + self._settings.host_heartbeat_period
            self._bus.send(cia301.HEARTBEAT + self._settings.host_node_id, cia301.heartbeat(NmtState.OPERATIONAL))


def master_frames(host: int) -> frozenset[int]:
    """Return the identifiers that only a master with the node id `host` sends, apart from RPDOs."""
    requests = (cia301.SDO_REQUEST + node_id for node_id in range(1, 128))
    return frozenset((cia301.NMT, cia301.SYNC, cia301.HEARTBEAT + host, *requests))


def another_master(name: str, heard: Collection[int]) -> str:
    """Return the message for frames that only a master sends."""
    frames = ", ".join(f"0x{can_id:03X}" for can_id in sorted(heard))
    if set(heard) == {cia301.SYNC}:
        return (
            f"{name}: SYNC (0x080) is on the bus, from another master or a drive that sends it (0x1005 bit 30); "
            "stop the other program, or write produces_sync = true in that drive's profile, so that startup "
            "disables its SYNC"
        )
    return (
        f"{name}: another master is active (heard {frames}); nothing was sent: "
        "stop the other program, or use another bus"
    )


RELEASED = frozenset({objects.HEARTBEAT_CONSUMER.index, objects.LIFE_TIME_FACTOR.index})  # 0 after a shutdown


def release_heartbeat(session: Session, node_id: int, host: int) -> None:
    """Disable the heartbeat consumer (0x1016) for `host` and life guarding (0x100D), and read both back.

    Call it while our heartbeat is still sent.

    Raises:
        BusError: the node does not answer or stays armed.
    """
    for entry in _armed(session, node_id, host):
        session.write(node_id, entry, 0)
        found = session.read(node_id, entry)
        if found:
            raise BusError(
                f"node {node_id}: {entry} stays {found:#x} after 0 was written; the drive will report a lost "
                "connection: start with --reset-faults next time"
            )


def _armed(session: Session, node_id: int, host: int) -> list[objects.Object]:
    armed = []
    for number in range(1, (session.read_if_there(node_id, objects.HEARTBEAT_CONSUMERS) or 0) + 1):
        entry = replace(objects.HEARTBEAT_CONSUMER, subindex=number)
        value = session.read_if_there(node_id, entry) or 0
        if value >> 16 & 0x7F == host and value & 0xFFFF:
            armed.append(entry)
    if session.read_if_there(node_id, objects.LIFE_TIME_FACTOR):
        armed.append(objects.LIFE_TIME_FACTOR)
    return armed
