"""A configuration session: SDO, NMT and heartbeats through canopen, on the bus that the loop uses afterwards.

canopen runs a thread of its own, as does our heartbeat; both have ended when the session is closed, before the loop
starts.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable
from types import TracebackType

import can
import canopen
from canopen.sdo import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from tsa_ctrl.bus import cia301
from tsa_ctrl.bus.cia301 import NmtCommand, NmtState
from tsa_ctrl.bus.objects import Object
from tsa_ctrl.bus.pythoncan import SeamBus
from tsa_ctrl.bus.seam import Bus
from tsa_ctrl.bus.settings import BusSettings
from tsa_ctrl.errors import BusError

ABSENT = frozenset({0x06020000, 0x06090011})  # abort codes: no such object, no such subindex

_ANSWER_TIMEOUT = 0.5  # s, for one SDO answer
_ATTEMPTS = 3  # SDO reads and writes are repeated, as the configuration of a drive is idempotent
_ANSWER_LENGTH = 8  # bytes of every SDO frame
_LISTENING = 0.1  # s, for another master before anything is sent
_POLL = 0.005  # s

# Both libraries report to the root logger what is told here in one line by an exception.
for _name in ("canopen", "can"):
    logging.getLogger(_name).addHandler(logging.NullHandler())


class SdoRefusedError(BusError):
    """A node aborted an SDO transfer with this `code` (CiA 301)."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


class Session:
    """Use as a context manager. Raises BusError when another master is heard, or the bus fails.

    `heartbeat`: send ours while the session lasts; not for a session after which no loop goes on with it, as a drive
    that has heard it once would report its loss.
    """

    def __init__(self, bus: Bus, settings: BusSettings, heartbeat: bool = True) -> None:
        self._bus = bus
        self._settings = settings
        self._network = canopen.Network(SeamBus(bus))
        self._network.NOTIFIER_CYCLE = 0.02  # s, how soon its thread notices that it shall end
        self._clients: dict[int, SdoClient] = {}
        self._states: dict[int, list[int]] = {}  # NMT states heard of each node, in order
        self._heard: set[int] = set()
        self._masters: set[int] = set()
        self._stop = threading.Event()
        self._heartbeat = threading.Thread(target=self._send_heartbeats, name="heartbeat") if heartbeat else None

    def __enter__(self) -> Session:
        self._bus.accept(None)
        self._bus.flush()
        host = cia301.HEARTBEAT + self._settings.host_node_id
        for can_id in (cia301.NMT, cia301.SYNC, host):
            self._network.subscribe(can_id, self._on_master)
        for node_id in range(1, 128):
            if node_id != self._settings.host_node_id:
                self._network.subscribe(cia301.HEARTBEAT + node_id, self._on_heartbeat)
        self._network.connect()
        try:
            time.sleep(_LISTENING)
            if self._masters:
                heard = ", ".join(f"0x{can_id:03X}" for can_id in sorted(self._masters))
                raise BusError(
                    f"{self._bus.name}: another master is active (heard its frames {heard}); "
                    "stop the other program, or give this one another bus"
                )
        except BaseException:
            self._network.disconnect()
            raise
        if self._heartbeat is not None:
            self._heartbeat.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._network.disconnect()
        if self._heartbeat is not None:
            self._stop.set()
            self._heartbeat.join()
            self._bus.send(cia301.HEARTBEAT + self._settings.host_node_id, cia301.heartbeat(NmtState.OPERATIONAL))

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

    def _transfer(self, node_id: int, entry: Object, action: Callable[[SdoClient], bytes]) -> bytes:
        client = self._client(node_id)
        for _ in range(_ATTEMPTS):
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
                time.sleep(_POLL)
            if self._bus.fault is not None:
                raise self._failed()
        raise BusError(
            f"{self._bus.name}: node {node_id} does not answer to SDO requests ({entry}); "
            "check that it is powered, its node id and its bit rate"
        )

    def _failed(self) -> BusError:
        reason = "frames cannot be sent" if self._bus.fault is None else self._bus.fault.value
        return BusError(f"{self._bus.name}: {reason}; check adapter, cable and interface, and start again")

    def _client(self, node_id: int) -> SdoClient:
        if node_id not in self._clients:
            client = SdoClient(cia301.SDO_REQUEST + node_id, cia301.SDO_ANSWER + node_id, canopen.ObjectDictionary())
            client.RESPONSE_TIMEOUT = _ANSWER_TIMEOUT
            client.network = self._network
            self._network.subscribe(cia301.SDO_ANSWER + node_id, _well_formed(client.on_response))
            self._clients[node_id] = client
        return self._clients[node_id]

    def _wait(self, nodes: set[int], reached: Callable[[list[int]], bool], timeout: float) -> set[int]:
        end = time.monotonic() + timeout
        while True:
            missing = {node_id for node_id in nodes if not reached(self._states[node_id])}
            if not missing or time.monotonic() > end:
                return missing
            if self._bus.fault is not None:
                raise self._failed()
            time.sleep(_POLL)

    def _on_heartbeat(self, can_id: int, data: bytearray, timestamp: float) -> None:
        state = cia301.heartbeat_state(bytes(data))
        node_id = can_id - cia301.HEARTBEAT
        if state is not None:
            self._heard.add(node_id)
            self._states.setdefault(node_id, []).append(state)

    def _on_master(self, can_id: int, data: bytearray, timestamp: float) -> None:
        self._masters.add(can_id)

    def _send_heartbeats(self) -> None:
        """Ends with the session: a heartbeat that outlives its master would keep the drives from stopping."""
        data = cia301.heartbeat(NmtState.OPERATIONAL)
        while not self._stop.wait(self._settings.host_heartbeat_period):
            self._bus.send(cia301.HEARTBEAT + self._settings.host_node_id, data)


def _well_formed(take: Callable[[int, bytearray, float], None]) -> Callable[[int, bytearray, float], None]:
    """Answers of a wrong length are no answers: canopen would unpack them all the same."""
    return lambda can_id, data, timestamp: take(can_id, data, timestamp) if len(data) == _ANSWER_LENGTH else None
