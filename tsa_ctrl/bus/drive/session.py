"""A configuration session: SDO, NMT and heartbeats through canopen, on the bus that the loop uses afterwards.

Everything happens in the caller's thread and in the bus' own time: while an answer is waited for, frames are taken and
our heartbeat is sent. canopen's thread of its own is never started.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable
from types import TracebackType

import can
import canopen
from canopen.sdo import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from tsa_ctrl.bus.canopen import cia301
from tsa_ctrl.bus.canopen.cia301 import NmtCommand, NmtState
from tsa_ctrl.bus.canopen.objects import Object
from tsa_ctrl.bus.settings import BusSettings
from tsa_ctrl.bus.wire.seam import Bus, Frame
from tsa_ctrl.errors import BusError

ABSENT = frozenset({0x06020000, 0x06090011})  # abort codes: no such object, no such subindex

_ANSWER_TIMEOUT = 0.5  # s, for one SDO answer
_ATTEMPTS = 3  # SDO reads and writes are repeated, as the configuration of a drive is idempotent
_ANSWER_LENGTH = 8  # bytes of every SDO frame
_LISTENING = 0.1  # s, for another master before anything is sent
_PAUSE = 0.005  # s, after a frame that could not be sent
_MOST_WAITING = 512  # frames taken before a request
_HIGHEST = 0x7FF  # identifier of 11 bits; more has flags: error frames, remote requests

# Both libraries report to the root logger what is told here in one line by an exception.
for _name in ("canopen", "can"):
    logging.getLogger(_name).addHandler(logging.NullHandler())


class SdoRefusedError(BusError):
    """A node aborted an SDO transfer with this `code` (CiA 301)."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


class _Network(canopen.Network):  # type: ignore[misc]  # canopen is not followed by mypy
    """canopen's network over a `Bus`; what is received is handed to `notify` by the session."""

    def __init__(self, bus: Bus) -> None:
        super().__init__()
        self._seam = bus

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        if not self._seam.send(can_id, bytes(data)):
            raise can.CanOperationError(f"{self._seam.name}: frame dropped")


class _Client(SdoClient):  # type: ignore[misc]
    """canopen's SDO client, which waits by `wait(seconds, reached)` instead of for a thread."""

    RESPONSE_TIMEOUT = 0.0

    def __init__(self, node_id: int, network: _Network, wait: Callable[[float, Callable[[], bool]], bool]) -> None:
        super().__init__(cia301.SDO_REQUEST + node_id, cia301.SDO_ANSWER + node_id, canopen.ObjectDictionary())
        self.network = network
        self._wait = wait
        network.subscribe(cia301.SDO_ANSWER + node_id, self._take)

    def _take(self, can_id: int, data: bytearray, timestamp: float) -> None:
        """Answers of a wrong length are no answers: canopen would unpack them all the same."""
        if len(data) == _ANSWER_LENGTH:
            self.on_response(can_id, data, timestamp)

    def read_response(self) -> bytes:
        self._wait(_ANSWER_TIMEOUT, lambda: not self.responses.empty())
        return bytes(super().read_response())


class Session:
    """Use as a context manager. Raises BusError when another master is heard, or the bus fails.

    `heartbeat`: send ours while the session lasts; not for a session after which no loop goes on with it, as a drive
    that has heard it once would report its loss.
    """

    def __init__(self, bus: Bus, settings: BusSettings, heartbeat: bool = True) -> None:
        self._bus = bus
        self._settings = settings
        self._network = _Network(bus)
        self._clients: dict[int, _Client] = {}
        self._states: dict[int, list[int]] = {}  # NMT states heard of each node, in order
        self._heard: set[int] = set()
        self._masters: set[int] = set()
        self._heartbeat = heartbeat
        self._next_heartbeat = -math.inf

    def __enter__(self) -> Session:
        self._bus.accept(None)
        self._bus.flush()
        host = cia301.HEARTBEAT + self._settings.host_node_id
        for can_id in (cia301.NMT, cia301.SYNC, host):
            self._network.subscribe(can_id, self._on_master)
        for node_id in range(1, 128):
            if node_id != self._settings.host_node_id:
                self._network.subscribe(cia301.HEARTBEAT + node_id, self._on_heartbeat)
        heartbeat, self._heartbeat = self._heartbeat, False
        self.wait(_LISTENING)
        if self._masters:
            heard = ", ".join(f"0x{can_id:03X}" for can_id in sorted(self._masters))
            raise BusError(
                f"{self._bus.name}: another master is active (heard its frames {heard}); "
                "stop the other program, or give this one another bus"
            )
        self._heartbeat = heartbeat
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._heartbeat:
            self._bus.send(cia301.HEARTBEAT + self._settings.host_node_id, cia301.heartbeat(NmtState.OPERATIONAL))

    def clock(self) -> float:
        """The bus' time, s, monotonic."""
        return self._bus.clock()

    def wait(self, seconds: float, reached: Callable[[], bool] = lambda: False) -> bool:
        """Take frames and send our heartbeat until `reached`, at most `seconds`; at once False when the bus fails."""
        end = self._bus.clock() + seconds
        while not reached():
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
        """Take what waits already: an answer that came too late is none to the next request."""
        now = self._bus.clock()
        for frame in self._bus.gather(0.0, _MOST_WAITING):
            self._take(frame, now)

    def _take(self, frame: Frame, now: float) -> None:
        can_id, data = frame
        if can_id <= _HIGHEST:
            self._network.notify(can_id, bytearray(data), now)

    @property
    def heard(self) -> set[int]:
        """Nodes that sent a heartbeat or a boot-up since the session began."""
        return set(self._heard)

    def nmt(self, command: NmtCommand, node_id: int) -> None:
        """Send an NMT command."""
        if not self._bus.send(cia301.NMT, cia301.nmt(command, node_id)):
            raise self._failed()

    def boot(self, node_ids: Iterable[int], timeout: float) -> set[int]:
        """Reset the communication of these nodes; the nodes that did not boot up within `timeout` s."""
        nodes = set(node_ids)
        for node_id in nodes:
            self._states[node_id] = []
            self.nmt(NmtCommand.RESET_COMMUNICATION, node_id)
        return self._wait(nodes, lambda states: NmtState.BOOT_UP in states, timeout)

    def start(self, node_ids: Iterable[int], timeout: float) -> set[int]:
        """Start these nodes; those whose heartbeat did not say "operational" within `timeout` s."""
        nodes = set(node_ids)
        for node_id in nodes:
            self._states[node_id] = []
            self.nmt(NmtCommand.START, node_id)
        return self._wait(nodes, lambda states: NmtState.OPERATIONAL in states, timeout)

    def read(self, node_id: int, entry: Object) -> int:
        """Read an object by SDO; raises SdoRefusedError or BusError."""
        return entry.decode(self._transfer(node_id, entry, lambda client: client.upload(*entry.key)))

    def write(self, node_id: int, entry: Object, value: int) -> None:
        """Write an object by SDO; raises SdoRefusedError or BusError."""
        data = entry.encode(value)
        self._transfer(node_id, entry, lambda client: client.download(*entry.key, data) or b"")

    def read_if_there(self, node_id: int, entry: Object) -> int | None:
        """Read an object; None when the node does not have it."""
        try:
            return self.read(node_id, entry)
        except SdoRefusedError as error:
            if error.code in ABSENT:
                return None
            raise

    def _transfer(self, node_id: int, entry: Object, action: Callable[[_Client], bytes]) -> bytes:
        client = self._client(node_id)
        for _ in range(_ATTEMPTS):
            self._catch_up()
            try:
                return action(client)
            except SdoAbortedError as error:
                reason = SdoAbortedError.CODES.get(error.code, "unknown reason")
                raise SdoRefusedError(
                    f"{self._bus.name}: node {node_id} refuses {entry}: {reason} (abort code 0x{error.code:08X})",
                    error.code,
                ) from None
            except SdoCommunicationError:
                pass
            except (can.CanError, OSError):  # a frame was dropped, or the bus failed
                self.wait(_PAUSE)
            if self._bus.fault is not None:
                raise self._failed()
        raise BusError(
            f"{self._bus.name}: node {node_id} does not answer to SDO requests ({entry}); "
            "check that it is powered, its node id and its bit rate"
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

        if not self.wait(timeout, lambda: not missing()) and self._bus.fault is not None:
            raise self._failed()
        return missing()

    def _on_heartbeat(self, can_id: int, data: bytearray, timestamp: float) -> None:
        state = cia301.heartbeat_state(bytes(data))
        node_id = can_id - cia301.HEARTBEAT
        if state is not None:
            self._heard.add(node_id)
            self._states.setdefault(node_id, []).append(state)

    def _on_master(self, can_id: int, data: bytearray, timestamp: float) -> None:
        self._masters.add(can_id)

    def _beat(self, now: float) -> None:
        """Our heartbeat, when it is due: it ends with the session, for it must not outlive its master."""
        if self._heartbeat and now >= self._next_heartbeat:
            self._next_heartbeat = now + self._settings.host_heartbeat_period
            self._bus.send(cia301.HEARTBEAT + self._settings.host_node_id, cia301.heartbeat(NmtState.OPERATIONAL))
