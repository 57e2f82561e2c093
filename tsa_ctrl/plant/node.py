"""Simulate a CANopen node (CiA 301): NMT, SDO server, heartbeat or node guarding, SYNC, EMCY, PDOs and LSS.

The caller calls `receive` with each frame and `tick` with the time; the node answers through `send`. There are no
threads. The SDO server handles one expedited or segmented transfer at a time. It aborts a block transfer, which is
optional in CiA 301, with 0x05040001, as many drives do.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tsa_ctrl.bus.wire.bus import REMOTE_FLAG
from tsa_ctrl.plant.cia301 import (
    REGISTER_COMMUNICATION,
    Consumers,
    EmcyCode,
    ErrorLog,
    Guarding,
    Identity,
    NmtCommand,
    NmtState,
    Storage,
    SyncPort,
    communication_objects,
)
from tsa_ctrl.plant.dictionary import AbortCode, Entry, Key, ObjectDictionary, SdoAbort
from tsa_ctrl.plant.pdo import PdoDefault, Rpdo, Tpdo
from tsa_ctrl.plant.settings import Quirks

_HEADER = struct.Struct("<BHB4s")
_MAX_DOWNLOAD = 4096  # bytes; more is rejected, as in a node with little memory
_ABORT = 0x80


@dataclass(slots=True)
class _Transfer:
    key: Key
    data: bytearray
    toggle: int = 0
    upload: bool = True
    size: int | None = None


class SdoServer:
    """Respond to SDO requests with frames of 8 bytes, and hold the state of one segmented transfer."""

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self._transfer: _Transfer | None = None

    def reset(self) -> None:
        self._transfer = None

    def handle(self, request: bytes) -> list[bytes]:
        """Return the responses to one request frame; an abort or a frame without 8 bytes gets none."""
        if len(request) != 8:
            return []
        if request[0] == _ABORT:
            self.reset()
            return []
        try:
            return [self._answer(request)]
        except SdoAbort as abort:
            running = self._transfer if request[0] >> 5 in (0, 3) else None
            key = running.key if running is not None else _HEADER.unpack(request)[1:3]
            self.reset()
            return [_HEADER.pack(_ABORT, *key, struct.pack("<I", abort.code))]

    def _answer(self, request: bytes) -> bytes:
        command, index, sub, data = _HEADER.unpack(request)
        specifier = command >> 5
        if specifier == 1:
            return self._start_download((index, sub), command, data)
        if specifier == 0:
            return self._download_segment(command, request[1:])
        if specifier == 2:
            return self._start_upload((index, sub))
        if specifier == 3:
            return self._upload_segment(command)
        raise SdoAbort(AbortCode.UNKNOWN_COMMAND)

    def _start_download(self, key: Key, command: int, data: bytes) -> bytes:
        expedited, sized = command & 0x02, command & 0x01
        entry = self._dictionary.find(key)
        if expedited:
            size = 4 - ((command >> 2) & 0x03) if sized else entry.type.size
            self._dictionary.write(key, data[:size])
        else:
            announced = int.from_bytes(data, "little") if sized else None
            if announced is not None and announced > _MAX_DOWNLOAD:
                raise SdoAbort(AbortCode.OUT_OF_MEMORY)
            self._transfer = _Transfer(key, bytearray(), upload=False, size=announced)
        return _HEADER.pack(0x60, *key, bytes(4))

    def _download_segment(self, command: int, data: bytes) -> bytes:
        transfer = self._running(upload=False, toggle=command >> 4 & 1)
        transfer.data += data[: 7 - (command >> 1 & 0x07)]
        if len(transfer.data) > _MAX_DOWNLOAD:
            raise SdoAbort(AbortCode.OUT_OF_MEMORY)
        if command & 0x01:
            if transfer.size is not None and transfer.size != len(transfer.data):
                raise SdoAbort(AbortCode.LENGTH)
            self._dictionary.write(transfer.key, bytes(transfer.data))
            self._transfer = None
        answer = 0x20 | transfer.toggle << 4
        transfer.toggle ^= 1
        return bytes((answer, 0, 0, 0, 0, 0, 0, 0))

    def _start_upload(self, key: Key) -> bytes:
        data = self._dictionary.read(key)
        if 0 < len(data) <= 4:
            return _HEADER.pack(0x43 | (4 - len(data)) << 2, *key, data.ljust(4, b"\0"))
        self._transfer = _Transfer(key, bytearray(data), upload=True)
        return _HEADER.pack(0x41, *key, struct.pack("<I", len(data)))

    def _upload_segment(self, command: int) -> bytes:
        transfer = self._running(upload=True, toggle=command >> 4 & 1)
        part = bytes(transfer.data[:7])
        del transfer.data[:7]
        last = not transfer.data
        answer = transfer.toggle << 4 | (7 - len(part)) << 1 | last
        transfer.toggle ^= 1
        if last:
            self._transfer = None
        return bytes((answer,)) + part.ljust(7, b"\0")

    def _running(self, *, upload: bool, toggle: int) -> _Transfer:
        transfer = self._transfer
        if transfer is None or transfer.upload is not upload:
            raise SdoAbort(AbortCode.UNKNOWN_COMMAND)
        if toggle != transfer.toggle:
            raise SdoAbort(AbortCode.TOGGLE_BIT)
        return transfer


REQUEST, ANSWER = 0x7E5, 0x7E4
_SWITCH, _NODE_ID, _BIT_TIMING, _STORE = 0x04, 0x11, 0x13, 0x17
_SELECT = range(0x40, 0x44)
_SELECTED = 0x44
_INQUIRE = range(0x5A, 0x5E)
_INQUIRE_NODE_ID = 0x5E
_OUT_OF_RANGE, _NOT_SUPPORTED = 1, 1
_UNCONFIGURED = 255


class LssSlave:
    """Implement an LSS slave (CiA 305), through which the master assigns a node id.

    LSS uses two CAN identifiers that no other service uses. `identity`: vendor, product, revision, serial number.
    `assigned` is called when a new id becomes valid.
    """

    def __init__(
        self, identity: tuple[int, int, int, int], send: Callable[[int, bytes], bool], assigned: Callable[[int], None]
    ) -> None:
        self._identity = identity
        self._send = send
        self._assigned = assigned
        self._configuring = False
        self._matched = 0
        self._pending: int | None = None
        self.node_id: int | None = None
        self.stored: int | None = None  # survives a power cycle

    def receive(self, data: bytes, now: float) -> None:
        if len(data) != 8:
            return
        command = data[0]
        if command == _SWITCH:
            self._switch(data[1] == 1)
        elif command in _SELECT:
            self._select(command - _SELECT.start, int.from_bytes(data[1:5], "little"))
        elif self._configuring:
            self._configure(command, data)

    def _switch(self, configuring: bool) -> None:
        self._configuring = configuring
        if not configuring and self.node_id is None and self._pending is not None:
            self.node_id = self._pending
            self._assigned(self.node_id)

    def _select(self, place: int, value: int) -> None:
        """Process one of the four selection numbers, which must arrive in order and match this node."""
        self._matched = place + 1 if self._matched == place and self._identity[place] == value else 0
        if self._matched == len(self._identity):
            self._matched = 0
            self._configuring = True
            self._answer(bytes((_SELECTED,)))

    def _configure(self, command: int, data: bytes) -> None:
        if command == _NODE_ID:
            good = 1 <= data[1] <= 127
            if good:
                self._pending = data[1]
            self._answer(bytes((command, 0 if good else _OUT_OF_RANGE, 0)))
        elif command == _BIT_TIMING:
            self._answer(bytes((command, _NOT_SUPPORTED, 0)))
        elif command == _STORE:
            self.stored = self._pending
            self._answer(bytes((command, 0, 0)))
        elif command in _INQUIRE:
            self._answer(struct.pack("<BI", command, self._identity[command - _INQUIRE.start]))
        elif command == _INQUIRE_NODE_ID:
            self._answer(bytes((command, self.node_id or _UNCONFIGURED)))

    def _answer(self, data: bytes) -> None:
        self._send(ANSWER, data.ljust(8, b"\0"))


Send = Callable[[int, bytes], bool]
Handler = Callable[[bytes, float], None]
PdoDefaults = Sequence[tuple[int, PdoDefault]]  # number from 0, and the PDO at power-on

_HEARTBEAT = 0x700  # + node


class Node:
    """Simulate one node on the bus. Subclasses add objects and define their meaning."""

    def __init__(
        self,
        node_id: int,
        identity: Identity,
        entries: Sequence[Entry],
        tpdos: PdoDefaults,
        rpdos: PdoDefaults,
        send: Send,
        quirks: Quirks | None = None,
    ) -> None:
        self.quirks = quirks or Quirks()
        self.node_id = node_id
        self.powered = True
        self.deaf = False  # all RPDOs to this node are lost
        self.lost_in_a_row = 0  # RPDOs that are lost before one is received
        self._lost = 0
        self.unhearing = False  # all frames to this node are lost
        self.state = NmtState.BOOT_UP
        self.transmit: Send = send
        self.routes: dict[int, Handler] = {}
        self.reroute: Callable[[], None] = lambda: None
        self.now = 0.0
        self._heartbeat_due = 0.0
        self._boot_due: float | None = None
        self._answers: deque[tuple[float, bytes]] = deque()
        self._complete = False
        self.dictionary = ObjectDictionary((*communication_objects(identity, self.quirks), *entries), node_id)
        self.values = self.dictionary.values
        self.sdo = SdoServer(self.dictionary)
        self.errors = ErrorLog(self.dictionary, self._send)
        self.storage = Storage(self.dictionary)
        self.lss = LssSlave(identity.numbers, self._send, self._named) if self.quirks.node_id_unset else None
        self._sync_port = SyncPort(self.dictionary, self._changed)
        guarded = self.quirks.node_guarding
        self._consumers = Consumers(self.dictionary, 0 if guarded else self.quirks.heartbeat_consumers, self._changed)
        self.guarding = Guarding(self.dictionary, self.quirks.guarding_toggles) if guarded else None
        self.dictionary.on_write[0x1017, 0] = self._write_heartbeat
        self.tpdos = [Tpdo(self.dictionary, number, default, self._changed) for number, default in tpdos]
        self.rpdos = [
            Rpdo(self.dictionary, number, default, self._changed, self.quirks.delay_periods)
            for number, default in rpdos
        ]
        self._by_sync: tuple[Tpdo, ...] = ()  # sent on a SYNC
        self._by_event: tuple[Tpdo, ...] = ()  # sent on an event
        self._complete = True
        self._changed()

    # methods that a subclass overrides

    def sample(self) -> None:
        """Write the measured values into the dictionary."""

    def written(self, keys: Sequence[Key]) -> None:
        """React to process data: an RPDO has written the objects `keys`."""

    def connection_lost(self, overdue: bool) -> None:
        """React to a lost master: its heartbeat is `overdue`, or this node has left the state operational."""

    def communication_error(self, code: EmcyCode) -> None:
        """React to a bus error that concerns this node; by default it is only reported."""
        self.emergency(code, REGISTER_COMMUNICATION)

    def power_on(self) -> None:
        """Restore the power-on values of the application's objects."""

    # NMT

    def boot(self, now: float) -> None:
        """Power on or reset the node: restore all power-on values, send the boot-up message, enter pre-operational."""
        self.now = now
        self.powered = True
        self.dictionary.restore(0x2000, 0x9FFF)
        self.errors.clear()
        self.power_on()
        self.reset_communication(now)

    def reset_communication(self, now: float) -> None:
        """Restore the power-on values of the communication objects; the boot-up message follows after its delay."""
        self.now = now
        self.sdo.reset()
        self._answers.clear()
        history = {key: value for key, value in self.values.items() if key[0] in (0x1001, 0x1003)}
        self.dictionary.restore(0x1000, 0x1FFF)
        self.values.update(history)
        self.errors.communication_restored()
        self._sync_port.restore(now)
        for tpdo in self.tpdos:
            tpdo.syncs, tpdo.last = 0, b""
            tpdo.compile()
        for rpdo in self.rpdos:
            rpdo.forget()
            rpdo.compile()
        self._consumers.restore()
        if self.guarding is not None:
            self.guarding.restore()
        self._boot_due = now + self.quirks.boot_time
        if self.quirks.boot_time > 0.0 or self._unnamed:
            self._enter(NmtState.BOOT_UP)
        else:
            self._boot_up(now)
        self._changed()

    def power_off(self) -> None:
        self.powered = False

    @property
    def _unnamed(self) -> bool:
        return self.lss is not None and self.lss.node_id is None

    def _named(self, node_id: int) -> None:
        """Boot with the node id that LSS has assigned."""
        self.node_id = self.dictionary.node_id = node_id
        self.boot(self.now)

    def _boot_up(self, now: float) -> None:
        self._boot_due = None
        self._heartbeat_due = now
        self._send(_HEARTBEAT + self.node_id, b"\x00")
        self._enter(NmtState.PRE_OPERATIONAL)
        if self.quirks.emcy_at_boot:
            self.emergency(self.quirks.emcy_at_boot, REGISTER_COMMUNICATION)
        if self.quirks.starts_itself:
            self._enter(NmtState.OPERATIONAL)

    def _enter(self, state: NmtState) -> None:
        leaving = self.state is NmtState.OPERATIONAL and state is not NmtState.OPERATIONAL
        self.state = state
        for rpdo in self.rpdos:
            rpdo.forget()
        if leaving:
            self.connection_lost(overdue=False)

    def _nmt(self, data: bytes, now: float) -> None:
        if len(data) != 2 or data[1] not in (0, self.node_id):
            return
        command = data[0]
        if command == NmtCommand.RESET_NODE:
            self._enter(NmtState.BOOT_UP)
            self.boot(now)
        elif command == NmtCommand.RESET_COMMUNICATION:
            self._enter(NmtState.BOOT_UP)
            self.reset_communication(now)
        elif self.state is NmtState.BOOT_UP:
            return
        elif command == NmtCommand.START:
            self._enter(NmtState.OPERATIONAL)
        elif command == NmtCommand.STOP:
            self._enter(NmtState.STOPPED)
        elif command == NmtCommand.ENTER_PRE_OPERATIONAL:
            self._enter(NmtState.PRE_OPERATIONAL)

    # frames in

    def receive(self, can_id: int, data: bytes, now: float) -> None:
        """Process one frame from the bus; a frame whose identifier is not in `routes` is ignored."""
        handler = self.routes.get(can_id)
        if handler is not None and self.powered and not self.unhearing:
            self.now = now
            handler(data, now)

    def _changed(self) -> None:
        if not self._complete:
            return
        valid = [tpdo for tpdo in self.tpdos if tpdo.valid]
        self._by_sync = tuple(tpdo for tpdo in valid if tpdo.synchronous)
        self._by_event = tuple(tpdo for tpdo in valid if not tpdo.synchronous)
        self.routes = {} if self.lss is None else {REQUEST: self.lss.receive}
        if not self._unnamed:
            self.routes[0x000] = self._nmt
            self.routes[self._sync_port.identifier] = self._sync
            self.routes[0x600 + self.node_id] = self._sdo_request
            for rpdo in self.rpdos:
                if rpdo.valid:
                    self.routes[rpdo.cob_id] = self._rpdo_handler(rpdo)
            self.routes.update(self._consumers.handlers())
            if self.guarding is not None:
                self.routes[REMOTE_FLAG | _HEARTBEAT + self.node_id] = self._guard_request
        self.reroute()

    def _sdo_request(self, data: bytes, now: float) -> None:
        if self.state in (NmtState.STOPPED, NmtState.BOOT_UP):
            return
        self.sample()  # an SDO reads the present value, not the one at the last SYNC
        for answer in self.sdo.handle(data):
            if self.quirks.answer_time > 0.0:
                self._answers.append((now + self.quirks.answer_time, answer))
            else:
                self._send(0x580 + self.node_id, answer)

    def _guard_request(self, data: bytes, now: float) -> None:
        if self.guarding is not None and self.state is not NmtState.BOOT_UP:
            self._send(_HEARTBEAT + self.node_id, self.guarding.answer(self.state, now))

    def _rpdo_handler(self, rpdo: Rpdo) -> Handler:
        def handle(data: bytes, now: float) -> None:
            if self.state is not NmtState.OPERATIONAL or self.deaf:
                return
            if self.lost_in_a_row:
                self._lost = (self._lost + 1) % (self.lost_in_a_row + 1)
                if self._lost:
                    return
            if len(data) < rpdo.packing.size:
                self.communication_error(EmcyCode.PDO_TOO_SHORT)
                return
            if len(data) > rpdo.packing.size:
                self.communication_error(EmcyCode.PDO_TOO_LONG)
            if rpdo.synchronous and self._sync_port.closed(now):
                return
            acting = rpdo.take(data, now)
            if acting is not None:
                self._apply(rpdo, acting)

        return handle

    def _apply(self, rpdo: Rpdo, data: bytes) -> None:
        written = rpdo.unpack(data)
        self.values.update(written)
        self.written([key for key, _ in written])

    def _sync(self, data: bytes, now: float) -> None:
        if self.state not in (NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL):
            return
        if not self._sync_port.hear(data, now):
            self.communication_error(EmcyCode.SYNC_LENGTH)
        elif self.state is NmtState.OPERATIONAL:
            self._synchronise(now)

    def _synchronise(self, now: float) -> None:
        """Apply the RPDOs that waited for this SYNC, sample, and send the synchronous TPDOs."""
        for rpdo in self.rpdos:
            acting = rpdo.due()
            if acting is not None:
                self._apply(rpdo, acting)
        if self.quirks.rpdo_timer_on_sync:
            self._look_at_rpdos(now)
        self.sample()
        for tpdo in self._by_sync:
            if tpdo.due_on_sync():
                self._transmit(tpdo, now)

    # time

    def tick(self, now: float) -> None:
        """Run the timers: boot-up, delayed answers, heartbeat, SYNC, supervision, RPDO timeouts, event-driven TPDOs."""
        if not self.powered or self._unnamed:
            return
        self.now = now
        if self._boot_due is not None:
            if now < self._boot_due:
                return
            self._boot_up(now)
        self.errors.release(now)
        while self._answers and self._answers[0][0] <= now:
            self._send(0x580 + self.node_id, self._answers.popleft()[1])
        period = self.values.get((0x1017, 0), 0) * 1e-3
        if period > 0.0 and now >= self._heartbeat_due:
            self._send(_HEARTBEAT + self.node_id, bytes((self.state,)))
            self._heartbeat_due = max(self._heartbeat_due + period, now)
        if self._consumers.overdue(now) or (self.guarding is not None and self.guarding.overdue(now)):
            self._heartbeat_lost()
        if self.state is not NmtState.STOPPED and self._sync_port.made(now):
            self._send(self._sync_port.identifier, b"")
            self._sync(b"", now)
        if self.state is not NmtState.OPERATIONAL:
            return
        if self._sync_port.overdue(now):
            self.communication_error(EmcyCode.COMMUNICATION)
        if not self.quirks.rpdo_timer_on_sync:
            self._look_at_rpdos(now)
        self._send_events(now)

    def _look_at_rpdos(self, now: float) -> None:
        for rpdo in self.rpdos:
            if rpdo.event_timer and rpdo.received_at is not None and now - rpdo.received_at > rpdo.event_timer:
                rpdo.received_at = None
                self.communication_error(EmcyCode.RPDO_TIMEOUT)

    def _send_events(self, now: float) -> None:
        if self._by_event:
            self.sample()
            for tpdo in self._by_event:
                if tpdo.due_on_event(now):
                    self._transmit(tpdo, now)

    def _heartbeat_lost(self) -> None:
        self.emergency(EmcyCode.HEARTBEAT, REGISTER_COMMUNICATION)
        behaviour = self.values.get((0x1029, 1), 0)
        self.connection_lost(overdue=True)
        if behaviour == 0 and self.state is NmtState.OPERATIONAL:
            self._enter(NmtState.PRE_OPERATIONAL)
        elif behaviour == 2:
            self._enter(NmtState.STOPPED)

    # frames out

    def _send(self, can_id: int, data: bytes) -> bool:
        return self.transmit(can_id, data) if self.powered else False

    def _transmit(self, tpdo: Tpdo, now: float) -> None:
        tpdo.last = tpdo.pack()
        tpdo.sent_at = now
        self._send(tpdo.cob_id, tpdo.last)

    def emergency(self, code: int, register: int, vendor: bytes = bytes(5)) -> None:
        """Send an EMCY and store it in 0x1001 and 0x1003; code 0 reports the end of the error."""
        heard = self.state in (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL)
        self.errors.report(code, register, vendor, heard, self.now)

    def _write_heartbeat(self, value: int) -> None:
        self._heartbeat_due = self.now
