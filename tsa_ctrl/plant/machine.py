"""Run the simulated machine: axes and their nodes on one or several buses, in real time and in one thread.

Time is CLOCK_MONOTONIC. The mechanics advance at every SYNC before the sensors are read. Without SYNC, a timer advances
them. Housekeeping runs directly after the answers to a SYNC, so that it does not delay the next one.
"""

from __future__ import annotations

import dataclasses
import random
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from tsa_ctrl.bus.wire.bus import ERROR_FLAG, Bus, BusFault, Frame, next_frame
from tsa_ctrl.bus.wire.link import set_up
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.plant.axis import Axis, Record
from tsa_ctrl.plant.cia301 import EmcyCode, Identity
from tsa_ctrl.plant.cia402 import PowerState
from tsa_ctrl.plant.dictionary import AbortCode, Access, Entry, Key, SdoAbort, Type
from tsa_ctrl.plant.drive import Drive
from tsa_ctrl.plant.drive_emulation import AXIS_OFFSET, DriveEmulation, objects, pdos, shifted
from tsa_ctrl.plant.faults import Changes, FaultKind, FaultPlan, Target, TransmitFaults, check_fault
from tsa_ctrl.plant.mechanism import Mechanism, build_mechanism
from tsa_ctrl.plant.node import Node, Send
from tsa_ctrl.plant.sensors import Encoder, TorqueSensor
from tsa_ctrl.plant.settings import AxisSettings, FaultSettings, PlantSettings

# A node has one or several CiA 402 drives. Their objects are 0x800 apart, and their PDOs 0x40.

DEVICE_TYPE = 0x00020192  # servo drive, CiA 402
_SEVERAL = 0xFFFF0000  # additional information of a device with several axes (CiA 301, 7.5.2.1)
_POWERED = (PowerState.SWITCHED_ON, PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE)


class DriveNode(Node):
    """Simulate one node with the identity, the communication deviations and the emulation of its first drive."""

    def __init__(self, drives: Sequence[Drive], send: Send) -> None:
        first = drives[0].settings
        assert first.node_id is not None
        self.drives = tuple(drives)
        several = len(drives) > 1
        device_type = DEVICE_TYPE & 0xFFFF | _SEVERAL if several else DEVICE_TYPE
        serial = first.node_id if first.serial_number is None else first.serial_number
        identity = Identity(device_type, first.name, first.vendor, first.product, serial=serial)
        entries, tpdos, rpdos = [], [], []
        for drive in drives:
            offset = (drive.settings.slot - 1) * AXIS_OFFSET
            for entry in objects(drive.settings):
                entries.append(dataclasses.replace(entry, index=entry.index + offset))
            if several:
                entries.append(Entry(0x67FF + offset, 0, Type.U32, Access.CONST, DEVICE_TYPE))
            sent, received = pdos(drive.settings)
            tpdos += sent
            rpdos += received
        self._controlwords = tuple(shifted((0x6040, 0), (d.settings.slot - 1) * AXIS_OFFSET) for d in drives)
        super().__init__(first.node_id, identity, entries, tpdos, rpdos, send, first)
        for drive in drives:
            drive.attach(self)
            self._impersonate(drive)
            self._apply_quirks(drive)
        for pdo in (*self.tpdos, *self.rpdos):
            try:
                pdo.compile()
            except SdoAbort:
                lost = ", ".join(
                    f"0x{index:04X}" for index, sub in pdo.keys if (index, sub) not in self.dictionary.entries
                )
                raise UsageError(
                    f"[axis.drive] absent: the PDO 0x{pdo.communication:04X} contains {lost} at power-on; remove it "
                    f"from absent, or add 0x{pdo.communication:04X} to absent"
                ) from None

    # methods of Node that act on every drive

    def power_on(self) -> None:
        for drive in self.drives:
            drive.power_on()

    def power_off(self) -> None:
        super().power_off()
        for drive in self.drives:
            drive.power_off()

    def sample(self) -> None:
        for drive in self.drives:
            drive.sample()

    def written(self, keys: Sequence[Key]) -> None:
        for drive, controlword in zip(self.drives, self._controlwords, strict=True):
            drive.written(controlword in keys)

    def connection_lost(self, overdue: bool) -> None:
        for drive in self.drives:
            drive.connection_lost(overdue)

    def communication_error(self, code: EmcyCode) -> None:
        taken = [drive.communication_error(code) for drive in self.drives]
        if not any(taken):
            super().communication_error(code)

    def tick(self, now: float) -> None:
        if self.powered:
            self.now = now
            for drive in self.drives:
                drive.tick()
        super().tick(now)

    # deviations of a make of drive, by its emulation or by the settings

    def _impersonate(self, drive: Drive) -> None:
        """Add the manufacturer's objects, and change standard objects as this make of drive does."""
        dictionary, emulation = self.dictionary, drive.emulation
        offset = (drive.settings.slot - 1) * AXIS_OFFSET
        for entry in emulation.added:
            dictionary.add(entry)
        for key, value in emulation.defaults.items():
            self._replace(shifted(key, offset), default=value)
        for key in emulation.read_only:
            self._replace(shifted(key, offset), access=Access.RO)
        for key in {*emulation.fixed, *emulation.off_only}:
            dictionary.on_write[shifted(key, offset)] = _guard(key, emulation, drive)
        for index, sub in emulation.absent:
            dictionary.remove(shifted((index, 0), offset)[0], sub)

    def _apply_quirks(self, drive: Drive) -> None:
        settings, dictionary = drive.settings, self.dictionary
        offset = (settings.slot - 1) * AXIS_OFFSET
        self._check_known("absent", settings.absent, offset)
        self._check_known("read_only", settings.read_only, offset)
        for absent in settings.absent:
            index, sub = (absent, None) if isinstance(absent, int) else _place(absent)
            dictionary.remove(shifted((index, 0), offset)[0], sub)
        for name, value in settings.objects.items():
            index, sub = _place(name)
            key = shifted((index, sub or 0), offset)
            if key not in dictionary.entries:
                raise UsageError(f"[axis.drive] objects: this drive has no {name}; correct index and sub-index")
            self._replace(key, default=value, plus_node=False)
        mapping = [f"0x{base + n:04X}" for base in (0x1600, 0x1A00) for n in range(4)] if settings.fixed_mapping else []
        for name in [*settings.read_only, *mapping]:
            index, sub = _place(name)
            for key in [key for key in dictionary.entries if key[0] == shifted((index, 0), offset)[0]]:
                if sub in (None, key[1]):
                    self._replace(key, access=Access.RO)

    def _check_known(self, key: str, names: Iterable[int | str], offset: int) -> None:
        """Raise UsageError if a name of an object in `[axis.drive] key` matches no object of the drive."""
        known = self.dictionary.entries
        for name in names:
            index, sub = (name, None) if isinstance(name, int) else _place(name)
            there = shifted((index, 0), offset)[0]
            if any(entry[0] == there and sub in (None, entry[1]) for entry in known):
                continue
            shown = f"0x{name:04X}" if isinstance(name, int) else name
            raise UsageError(
                f"[axis.drive] {key}: this drive has no {shown}; correct index and sub-index, or remove it "
                "(tsa plant --eds FILE lists its objects)"
            )

    def _replace(self, key: Key, **changes: object) -> None:
        entry = self.dictionary.entries[key]
        self.dictionary.add(dataclasses.replace(entry, **changes))  # type: ignore[arg-type]


def _guard(key: Key, emulation: DriveEmulation, drive: Drive) -> Callable[[int], None]:
    allowed, off_only = emulation.fixed.get(key), key in emulation.off_only

    def check(value: int) -> None:
        if allowed is not None and value not in allowed:
            raise SdoAbort(AbortCode.INVALID_VALUE)
        if off_only and drive.machine.state in _POWERED:
            raise SdoAbort(AbortCode.DEVICE_STATE)

    return check


def _place(name: str) -> tuple[int, int | None]:
    """Return the index and, if present, the sub-index of a name such as `"0x6076:0"` or `"0x6076"`."""
    index, colon, sub = name.partition(":")
    return int(index, 16), int(sub) if colon else None


SYNC = 0x080
TICK = 1e-3  # s between two checks of the timers
_AFTER_SYNC = 1.5e-3  # s; with a SYNC every millisecond, the timer never expires before the next SYNC
_UNUSED = 0x5F0  # identifier that no simulated node uses
_FLOOD_BURST = 2e-3  # s of a flood that are sent at once
_HEARD = 1024  # most frames of the master that a replay can repeat
_LONGEST_GAP = 0.25  # s that the mechanics catch up; a longer gap is skipped, because this computer stood still


@dataclass
class AxisNodes:
    """Hold one axis and its nodes by kind, each with its transmit function."""

    axis: Axis
    drive: Drive
    encoder: Encoder | None
    torque_sensor: TorqueSensor | None
    by_kind: dict[str, Node]
    transmit: dict[str, TransmitFaults]

    @property
    def nodes(self) -> tuple[Node, ...]:
        """Return the nodes, the drive first; a node of several axes belongs to each of them."""
        return tuple(self.by_kind[kind] for kind in ("drive", "encoder", "torque_sensor") if kind in self.by_kind)

    def kind_of(self, fault: FaultSettings, where: str) -> FaultKind:
        """Return the kind of a fault; raises UsageError, with a text that begins with `where`, if it is impossible."""
        where = f"{where}axis '{self.axis.name}'"
        kind = check_fault(fault, where)
        for part in (fault.node, kind.needs):
            if isinstance(part, str) and part not in self.by_kind:
                name = part.replace("_", " ")
                raise UsageError(f"{where}: fault {fault.name}: the axis has no {name}; choose another fault")
        if not isinstance(kind.needs, str) and kind.needs not in self.drive.values:
            raise UsageError(
                f"{where}: fault {fault.name}: the drive has no 0x{kind.needs[0]:04X}; choose another fault, or remove "
                "the object from [axis.drive] absent"
            )
        return kind


@dataclass
class Counts:
    """Hold the counts of a run."""

    syncs: int = 0
    frames: int = 0
    skipped: float = 0.0  # s of real time that the mechanics skipped


def build_axes(
    plant: PlantSettings, sends: Sequence[Send], clock: Callable[[], float], where: str = "plant"
) -> list[AxisNodes]:
    """Return the axes with their nodes before boot.

    The noise of each follows from the plant's seed. `sends` has one function per bus. Raises UsageError, with a text
    that begins with `where`, for an impossible drive.
    """
    units: list[AxisNodes] = []
    devices: dict[int | None, list[AxisNodes]] = {}
    for place, settings in enumerate(plant.axis):
        unit = _build_axis(settings, plant, sends[plant.bus_number(settings)], clock, place)
        units.append(unit)
        devices.setdefault(settings.drive.node_id, []).append(unit)
    for members in devices.values():
        transmit = members[0].transmit["drive"]
        try:
            node = DriveNode([unit.drive for unit in members], transmit)
        except UsageError as error:
            raise UsageError(f"{where}: axis '{members[0].axis.name}': {error}") from None
        for unit in members:
            unit.by_kind["drive"] = node
            unit.transmit["drive"] = transmit
    return units


def _build_axis(
    settings: AxisSettings, plant: PlantSettings, send: Send, clock: Callable[[], float], place: int
) -> AxisNodes:
    """Return one axis with the nodes of its sensors; its drive is not yet in a node."""
    axis = Axis(settings, plant.physics, on_limb=plant.mechanism.kind == "mujoco")

    def noise(number: int) -> random.Random:
        return random.Random(plant.physics.seed * 1000 + place * 10 + number)

    transmit = {
        kind: TransmitFaults(send, clock, noise(5 + i)) for i, kind in enumerate(("drive", "encoder", "torque_sensor"))
    }
    drive = Drive(settings.drive, axis.readings, axis.command, noise(0))
    encoder = sensor = None
    nodes: dict[str, Node] = {}
    if settings.encoder.present:
        nodes["encoder"] = encoder = Encoder(settings.encoder, axis.readings, noise(2), transmit["encoder"])
    if settings.torque_sensor.present:
        sensor = TorqueSensor(settings.torque_sensor, axis.readings, noise(1), transmit["torque_sensor"])
        nodes["torque_sensor"] = sensor
    return AxisNodes(axis, drive, encoder, sensor, nodes, transmit)


class Machine:
    """Simulate all axes and their nodes; `run` returns when its `stop` function returns True."""

    def __init__(
        self,
        plant: PlantSettings,
        bus: Bus,
        clock: Callable[[], float] = time.monotonic,
        switch: Callable[[str, bool | None], None] = set_up,
        others: Sequence[Bus] = (),
    ) -> None:
        """Build axes, nodes and mechanics.

        Args:
            plant: settings of the machine.
            bus: the first bus.
            clock: returns the time, s.
            switch: brings the interface with this name up (True) or down, or only checks (None) that this is
                permitted; raises OSError if it is not.
            others: the other buses, if the plant has several.
        """
        self._switch = switch
        self.plant = plant
        self.buses = (bus, *others)
        self.clock = clock
        self.counts = Counts()
        self.axes = build_axes(plant, [each.send for each in self.buses], clock)
        self.mechanism: Mechanism = build_mechanism(plant, [unit.axis for unit in self.axes])
        self.nodes = tuple({id(node): node for unit in self.axes for node in unit.nodes}.values())
        self._transmit = tuple({id(out): out for unit in self.axes for out in unit.transmit.values()}.values())
        self.faults = FaultPlan()
        self.changes = Changes()
        self.flood_rate = 0.0  # frames/s with an unused identifier
        self.housekeeping: Callable[[float], None] = lambda now: None
        self.recorder: Record | None = None
        self._flood_due = 0.0
        self._heard: deque[tuple[float, int, bytes, int]] = deque(maxlen=_HEARD)  # SYNC and RPDOs
        self._epoch = clock()
        self._routes: list[dict[int, tuple[Node, ...]]] = [{} for _ in self.buses]
        numbers = {id(node): plant.bus_number(unit.axis.settings) for unit in self.axes for node in unit.nodes}
        self._by_bus = [[node for node in self.nodes if numbers[id(node)] == n] for n in range(len(self.buses))]
        self._next_tick = self._epoch
        self.mechanism.advance(1e-9)  # compiles the mechanics, or loads their compiled code
        for unit in self.axes:
            unit.drive.before_change = self._bring_up(unit.axis)
        for node in self.nodes:
            node.reroute = self._reroute
        self._reroute()

    def start(self) -> None:
        """Boot every node, and schedule the configured faults."""
        self._epoch = self.clock()
        self._next_tick = self._epoch
        for node in self.nodes:
            node.boot(self._epoch)
        for unit in self.axes:
            for fault in unit.axis.settings.fault:
                self.faults.schedule(self._epoch + fault.at, self.beginning(unit.axis.name, fault))

    def run(self, stop: Callable[[], bool]) -> None:
        """Answer frames and advance time until `stop` returns True; raises BusError if an interface is gone."""
        while not stop():
            place, frame = next_frame(self.buses, max(0.0, self.due - self.clock()))
            self.step(frame, self.clock(), place)
            if frame is None:
                for bus in self.buses:
                    if bus.fault is not None:
                        self._bus_fault(bus, bus.fault)

    @property
    def due(self) -> float:
        """Return the clock time of the next event that needs no frame, s."""
        due = self._next_tick
        for each in self._transmit:
            if each.waiting and each.waiting[0][0] < due:
                due = each.waiting[0][0]
        return due

    def step(self, frame: Frame | None, now: float, place: int = 0) -> None:
        """Process everything due at `now`, and a frame that has arrived on the bus at `place`."""
        for each in self._transmit:
            if each.waiting:
                each.release(now)
        if frame is not None:
            self.handle(*frame, now, place)
        if now >= self._next_tick:
            self.tick(now)

    def handle(self, can_id: int, data: bytes, now: float, place: int = 0) -> None:
        """Process one frame from the bus at `place`."""
        self.counts.frames += 1
        if can_id & ERROR_FLAG:
            return
        if can_id == SYNC or 0x200 <= can_id < 0x580:
            self._heard.append((now, can_id, data, place))
        if can_id == SYNC:
            self.counts.syncs += place == 0
            self.advance(now)
        for node in self._routes[place].get(can_id, ()):
            node.receive(can_id, data, now)
        if can_id == SYNC and place == len(self.buses) - 1:  # the nodes of every bus have answered
            self.tick(now)
            self._next_tick = now + _AFTER_SYNC

    def tick(self, now: float) -> None:
        """Advance mechanics, faults and node timers to `now`, and write the record."""
        self._next_tick = now + TICK
        self.advance(now)
        self.faults.tick(now)
        if self.flood_rate > 0.0:
            self._flood(now)
        for node in self.nodes:
            node.tick(now)
        self._record(now)
        self.housekeeping(now)

    def begin_fault(self, axis: str | None, fault: FaultSettings, now: float) -> None:
        """Start a fault `fault.at` s from now; axis None is the first axis. Raises UsageError."""
        begin = self.beginning(axis, fault)
        if fault.at > 0.0:
            self.faults.schedule(now + fault.at, begin)
        else:
            begin(now)

    def beginning(self, axis: str | None, fault: FaultSettings) -> Callable[[float], None]:
        """Return the function that starts a fault at the given time, s of the clock. Raises UsageError."""
        named = {unit.axis.name: unit for unit in self.axes}
        unit = self.axes[0] if axis is None else named.get(axis)
        if unit is None:
            raise UsageError(f"axis '{axis}': no such axis; the axes are {', '.join(named)}")
        kind = unit.kind_of(fault, "")
        value = kind.value if fault.value is None else fault.value
        if kind.switches:  # an error at the start of the fault would stop the plant
            self.set_interface(None, self.plant.bus_number(unit.axis.settings))

        def begin(now: float) -> None:
            target = Target(
                self,
                unit.axis,
                unit.drive,
                unit.encoder,
                unit.torque_sensor,
                unit.nodes,
                unit.by_kind[fault.node],
                unit.transmit[fault.node],
                value,
                fault.duration,
                now,
                self.plant.bus_number(unit.axis.settings),
            )
            self.faults.start(kind, target)

        return begin

    def inject(self, can_id: int, data: bytes, place: int = 0) -> bool:
        """Send any frame on the bus at `place`."""
        return self.buses[place].send(can_id, data)

    def later(self, at: float, action: Callable[[float], None]) -> None:
        """Call `action(now)` in the first tick at or after `at`."""
        self.faults.schedule(at, action)

    def set_interface(self, up: bool | None, place: int = 0) -> None:
        """Take the interface of a bus down or up; raises UsageError if the user lacks the permission.

        `up` None only checks the permission.
        """
        name = self.buses[place].name
        try:
            self._switch(name, up)
        except OSError as error:
            raise UsageError(
                f"fault interface_down: {name} cannot be switched ({error.strerror or error}); run the "
                "plant on a network interface with the right to administer it (CAP_NET_ADMIN), or choose another fault"
            ) from None

    def replay_commands(self, since: float, now: float) -> None:
        """Process the master's frames since the time `since` (s) again."""
        stale = [(can_id, data, place) for at, can_id, data, place in self._heard if at >= since]
        for can_id, data, place in stale:
            self.handle(can_id, data, now, place)

    def _flood(self, now: float) -> None:
        if self._flood_due < now - _FLOOD_BURST:
            self._flood_due = now - _FLOOD_BURST
        while self._flood_due <= now:
            for bus in self.buses:
                bus.send(_UNUSED, bytes(8))
            self._flood_due += 1.0 / self.flood_rate

    def advance(self, now: float) -> None:
        behind = now - self._epoch - self.axes[0].axis.time
        if behind > _LONGEST_GAP:
            self.counts.skipped += behind
            self._epoch += behind
        self.mechanism.advance(now - self._epoch)

    def _bring_up(self, axis: Axis) -> Callable[[float], None]:
        return lambda now: self.mechanism.bring_up(axis, min(now - self._epoch, axis.time + _LONGEST_GAP))

    def _reroute(self) -> None:
        for place, nodes in enumerate(self._by_bus):
            routes: dict[int, list[Node]] = {}
            for node in nodes:
                for can_id in node.routes:
                    routes.setdefault(can_id, []).append(node)
            self._routes[place] = {can_id: tuple(there) for can_id, there in routes.items()}

    def _record(self, now: float) -> None:
        recorder = self.recorder
        if recorder is None or not recorder.due(self.axes[0].axis.time):
            return
        for place, unit in enumerate(self.axes):
            state = int(unit.drive.machine.state)
            recorder.row((now, unit.axis.time, place, self.faults.active, state, *unit.axis.truth()))
        recorder.flush(now)

    def _bus_fault(self, bus: Bus, fault: BusFault) -> None:
        if fault is BusFault.INTERFACE_GONE:
            raise BusError(f"bus {bus.name}: {fault.value}; recreate the interface and restart the plant")
        time.sleep(TICK)
        bus.clear_fault()
