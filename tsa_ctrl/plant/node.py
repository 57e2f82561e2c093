"""A CANopen node (CiA 301): NMT, SDO server, heartbeat produced and consumed, EMCY, PDOs. Raw frames, no threads.

A node is told what arrives (`receive`) and what time it is (`tick`); it answers through the `send` it was given.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum

from tsa_ctrl.plant.dictionary import AbortCode, Access, Entry, Key, ObjectDictionary, SdoAbort, Type
from tsa_ctrl.plant.pdo import PdoDefault, Rpdo, Tpdo
from tsa_ctrl.plant.sdo import SdoServer

Send = Callable[[int, bytes], bool]

_EMCY = struct.Struct("<HB5s")
_HISTORY = 8  # entries of 0x1003
_CONSUMERS = 4  # entries of 0x1016


class NmtState(IntEnum):
    """Values as in the heartbeat."""

    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(IntEnum):
    """Command specifier of NMT (CiA 301, 7.2.8.3.1); the plant has its own, so that it checks ours."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


class EmcyCode(IntEnum):
    """Emergency error codes of CiA 301 and 402 that the simulated nodes raise by themselves."""

    NO_ERROR = 0x0000
    HEARTBEAT = 0x8130  # life guard or heartbeat error
    PDO_TOO_SHORT = 0x8210
    PDO_TOO_LONG = 0x8220
    RPDO_TIMEOUT = 0x8250


ERROR_REGISTER_GENERIC = 0x01
ERROR_REGISTER_COMMUNICATION = 0x10


@dataclass(frozen=True, slots=True)
class Identity:
    """0x1000, 0x1008 and 0x1018 of a node."""

    device_type: int
    name: str
    vendor: int = 0x00000F0F
    product: int = 0
    revision: int = 0x00010000
    serial: int = 1


@dataclass(slots=True)
class Consumer:
    """One entry of 0x1016: supervision begins with the first heartbeat seen."""

    node_id: int = 0
    timeout: float = 0.0  # s
    last: float | None = None


class Node:
    """One node on the bus. Sub-classes add objects and say what an object means."""

    def __init__(
        self,
        node_id: int,
        identity: Identity,
        entries: Sequence[Entry],
        tpdos: Sequence[PdoDefault],
        rpdos: Sequence[PdoDefault],
        send: Send,
    ) -> None:
        self.node_id = node_id
        self.powered = True
        self.deaf = False  # RPDOs are lost on their way
        self.state = NmtState.BOOT_UP
        self.transmit: Send = send
        self.routes: dict[int, Callable[[bytes, float], None]] = {}
        self.reroute: Callable[[], None] = lambda: None
        self.dictionary = ObjectDictionary((*_communication(node_id, identity), *entries))
        self.values = self.dictionary.values
        self.sdo = SdoServer(self.dictionary)
        self.tpdos: list[Tpdo] = []
        self.rpdos: list[Rpdo] = []
        self.consumers = [Consumer() for _ in range(_CONSUMERS)]
        self.now = 0.0
        self._heartbeat_due = 0.0
        self._complete = False
        self.tpdos = [Tpdo(self.dictionary, i, default, self._changed) for i, default in enumerate(tpdos)]
        self.rpdos = [Rpdo(self.dictionary, i, default, self._changed) for i, default in enumerate(rpdos)]
        self._install_hooks()
        self._complete = True
        self._changed()

    # what a device adds

    def sample(self) -> None:
        """Write the measured values into the dictionary."""

    def written(self, keys: Sequence[Key]) -> None:
        """Process data were written by an RPDO."""

    def connection_lost(self) -> None:
        """The master is gone: heartbeat lost, or this node was taken out of operation."""

    def communication_error(self, code: EmcyCode) -> None:
        """An error on the bus that concerns this node; by default it is only reported."""
        self.emergency(code, ERROR_REGISTER_COMMUNICATION)

    def power_on(self) -> None:
        """Power-on values of the application's objects."""

    # NMT

    def boot(self, now: float) -> None:
        """Power on or reset node: everything to its power-on value, boot-up message, pre-operational."""
        self.now = now
        self.powered = True
        self.dictionary.restore(0x2000, 0x9FFF)
        self.values[0x1001, 0] = 0
        self._clear_history()
        self.power_on()
        self.reset_communication(now)

    def reset_communication(self, now: float) -> None:
        self.now = now
        self.sdo.reset()
        history = {key: value for key, value in self.values.items() if key[0] in (0x1001, 0x1003)}
        self.dictionary.restore(0x1000, 0x1FFF)
        self.values.update(history)
        self._communication_restored()
        for tpdo in self.tpdos:
            tpdo.syncs, tpdo.last = 0, b""
            tpdo.compile()
        for rpdo in self.rpdos:
            rpdo.pending = rpdo.received_at = None
            rpdo.compile()
        for place in range(_CONSUMERS):
            self._set_consumer(place, self.values[0x1016, place + 1])
        self._heartbeat_due = now
        self._send(0x700 + self.node_id, b"\x00")
        self._enter(NmtState.PRE_OPERATIONAL)

    def power_off(self) -> None:
        self.powered = False

    def _enter(self, state: NmtState) -> None:
        leaving = self.state is NmtState.OPERATIONAL and state is not NmtState.OPERATIONAL
        self.state = state
        for rpdo in self.rpdos:
            rpdo.pending = rpdo.received_at = None
        if leaving:
            self.connection_lost()

    def _nmt(self, data: bytes, now: float) -> None:
        if len(data) != 2 or data[1] not in (0, self.node_id):
            return
        command = data[0]
        if command == NmtCommand.START:
            self._enter(NmtState.OPERATIONAL)
        elif command == NmtCommand.STOP:
            self._enter(NmtState.STOPPED)
        elif command == NmtCommand.ENTER_PRE_OPERATIONAL:
            self._enter(NmtState.PRE_OPERATIONAL)
        elif command == NmtCommand.RESET_NODE:
            self._enter(NmtState.BOOT_UP)
            self.boot(now)
        elif command == NmtCommand.RESET_COMMUNICATION:
            self._enter(NmtState.BOOT_UP)
            self.reset_communication(now)

    # frames in

    def receive(self, can_id: int, data: bytes, now: float) -> None:
        """Take one frame from the bus; identifiers that are not in `routes` are of no concern to this node."""
        handler = self.routes.get(can_id)
        if handler is not None and self.powered:
            self.now = now
            handler(data, now)

    def _changed(self) -> None:
        if not self._complete:
            return
        routes: dict[int, Callable[[bytes, float], None]] = {
            0x000: self._nmt,
            self.values[0x1005, 0] & 0x7FF: self._sync,
            0x600 + self.node_id: self._sdo_request,
        }
        for rpdo in self.rpdos:
            if rpdo.valid:
                routes[rpdo.cob_id] = self._rpdo_handler(rpdo)
        for consumer in self.consumers:
            if consumer.node_id:
                routes[0x700 + consumer.node_id] = self._heartbeat_handler(consumer)
        self.routes = routes
        self.reroute()

    def _sdo_request(self, data: bytes, now: float) -> None:
        if self.state is NmtState.STOPPED:
            return
        self.sample()  # an SDO reads what is true now, not at the last SYNC
        answer = self.sdo.handle(data)
        if answer is not None:
            self._send(0x580 + self.node_id, answer)

    def _rpdo_handler(self, rpdo: Rpdo) -> Callable[[bytes, float], None]:
        def handle(data: bytes, now: float) -> None:
            if self.state is not NmtState.OPERATIONAL or self.deaf:
                return
            if len(data) < rpdo.packing.size:
                self.communication_error(EmcyCode.PDO_TOO_SHORT)
                return
            if len(data) > rpdo.packing.size:
                self.communication_error(EmcyCode.PDO_TOO_LONG)
            rpdo.received_at = now
            if rpdo.synchronous:
                rpdo.pending = data
            else:
                self._apply(rpdo, data)

        return handle

    def _apply(self, rpdo: Rpdo, data: bytes) -> None:
        written = rpdo.unpack(data)
        self.values.update(written)
        self.written([key for key, _ in written])

    def _sync(self, data: bytes, now: float) -> None:
        if self.state is not NmtState.OPERATIONAL:
            return
        for rpdo in self.rpdos:
            if rpdo.pending is not None:
                pending, rpdo.pending = rpdo.pending, None
                self._apply(rpdo, pending)
        self.sample()
        for tpdo in self.tpdos:
            if tpdo.due_on_sync():
                self._transmit(tpdo, now)

    def _heartbeat_handler(self, consumer: Consumer) -> Callable[[bytes, float], None]:
        def handle(data: bytes, now: float) -> None:
            consumer.last = now

        return handle

    # time

    def tick(self, now: float) -> None:
        """Timers: heartbeat, heartbeat consumers, RPDO time-outs, TPDOs by event."""
        if not self.powered:
            return
        self.now = now
        period = self.values[0x1017, 0] * 1e-3
        if period > 0.0 and now >= self._heartbeat_due:
            self._send(0x700 + self.node_id, bytes((self.state,)))
            self._heartbeat_due = max(self._heartbeat_due + period, now)
        for consumer in self.consumers:
            if consumer.last is not None and now - consumer.last > consumer.timeout:
                consumer.last = None
                self._heartbeat_lost()
        if self.state is not NmtState.OPERATIONAL:
            return
        for rpdo in self.rpdos:
            if rpdo.event_timer and rpdo.received_at is not None and now - rpdo.received_at > rpdo.event_timer:
                rpdo.received_at = None
                self.communication_error(EmcyCode.RPDO_TIMEOUT)
        events = [tpdo for tpdo in self.tpdos if tpdo.valid and not tpdo.synchronous]
        if events:
            self.sample()
            for tpdo in events:
                if tpdo.due_on_event(now):
                    self._transmit(tpdo, now)

    def _heartbeat_lost(self) -> None:
        self.emergency(EmcyCode.HEARTBEAT, ERROR_REGISTER_COMMUNICATION)
        behaviour = self.values.get((0x1029, 1), 0)
        was_operational = self.state is NmtState.OPERATIONAL
        if behaviour == 0 and was_operational:
            self._enter(NmtState.PRE_OPERATIONAL)
        elif behaviour == 2:
            self._enter(NmtState.STOPPED)
        if behaviour == 1 or not was_operational:
            self.connection_lost()

    def _communication_restored(self) -> None:
        """A new start ends communication errors; other errors stay in the error register."""
        others = self.values[0x1001, 0] & ~(ERROR_REGISTER_COMMUNICATION | ERROR_REGISTER_GENERIC)
        self.values[0x1001, 0] = others | ERROR_REGISTER_GENERIC if others else 0

    # frames out

    def _send(self, can_id: int, data: bytes) -> bool:
        return self.transmit(can_id, data) if self.powered else False

    def _transmit(self, tpdo: Tpdo, now: float) -> None:
        tpdo.last = tpdo.pack()
        tpdo.sent_at = now
        self._send(tpdo.cob_id, tpdo.last)

    def emergency(self, code: int, register: int, vendor: bytes = bytes(5)) -> None:
        """Send an EMCY and keep it in 0x1001 and 0x1003; code 0 says that the error is gone."""
        if code:
            self.values[0x1001, 0] |= register | ERROR_REGISTER_GENERIC
            for place in range(_HISTORY, 1, -1):
                self.values[0x1003, place] = self.values[0x1003, place - 1]
            self.values[0x1003, 1] = code
            self.values[0x1003, 0] = min(_HISTORY, self.values[0x1003, 0] + 1)
        else:
            self.values[0x1001, 0] = 0
        if self.state in (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL):
            self._send(0x80 + self.node_id, _EMCY.pack(code, self.values[0x1001, 0], vendor))

    # dictionary

    def _install_hooks(self) -> None:
        hooks = self.dictionary.on_write
        hooks[0x1003, 0] = self._write_history
        hooks[0x1005, 0] = self._write_sync
        hooks[0x1017, 0] = self._write_heartbeat
        for place in range(_CONSUMERS):
            hooks[0x1016, place + 1] = self._consumer_hook(place)

    def _write_history(self, value: int) -> None:
        if value:
            raise SdoAbort(AbortCode.INVALID_VALUE)
        self._clear_history()

    def _clear_history(self) -> None:
        for place in range(_HISTORY + 1):
            self.values[0x1003, place] = 0

    def _write_sync(self, value: int) -> None:
        if value & ~0x7FF:
            raise SdoAbort(AbortCode.INVALID_VALUE)  # these nodes produce no SYNC
        self.values[0x1005, 0] = value
        self._changed()

    def _write_heartbeat(self, value: int) -> None:
        self._heartbeat_due = self.now

    def _consumer_hook(self, place: int) -> Callable[[int], None]:
        return lambda value: self._set_consumer(place, value)

    def _set_consumer(self, place: int, value: int) -> None:
        node_id, timeout = value >> 16 & 0xFF, (value & 0xFFFF) * 1e-3
        if node_id > 127:
            raise SdoAbort(AbortCode.INVALID_VALUE)
        active = node_id != 0 and timeout > 0.0
        self.consumers[place] = Consumer(node_id, timeout) if active else Consumer()
        self._changed()


def _communication(node_id: int, identity: Identity) -> list[Entry]:
    return [
        Entry(0x1000, 0, Type.U32, Access.CONST, identity.device_type),
        Entry(0x1001, 0, Type.U8, Access.RO, mappable=True),
        Entry(0x1003, 0, Type.U8),
        *(Entry(0x1003, place, Type.U32, Access.RO) for place in range(1, _HISTORY + 1)),
        Entry(0x1005, 0, Type.U32, default=0x80),
        Entry(0x1006, 0, Type.U32),
        Entry(0x1008, 0, Type.TEXT, Access.CONST, identity.name),
        Entry(0x1009, 0, Type.TEXT, Access.CONST, "simulated"),
        Entry(0x100A, 0, Type.TEXT, Access.CONST, "1"),
        Entry(0x1014, 0, Type.U32, Access.RO, 0x80 + node_id),
        Entry(0x1016, 0, Type.U8, Access.CONST, _CONSUMERS),
        *(Entry(0x1016, place, Type.U32) for place in range(1, _CONSUMERS + 1)),
        Entry(0x1017, 0, Type.U16),
        Entry(0x1018, 0, Type.U8, Access.CONST, 4),
        Entry(0x1018, 1, Type.U32, Access.CONST, identity.vendor),
        Entry(0x1018, 2, Type.U32, Access.CONST, identity.product),
        Entry(0x1018, 3, Type.U32, Access.CONST, identity.revision),
        Entry(0x1018, 4, Type.U32, Access.CONST, identity.serial),
        Entry(0x1029, 0, Type.U8, Access.CONST, 1),
        Entry(0x1029, 1, Type.U8, default=0, high=2),
    ]
