"""Read the capabilities of a drive by SDO uploads alone: nothing is written or moved, and no SYNC is sent."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from tsa_ctrl.bus.canopen import cia301, cia402, objects
from tsa_ctrl.bus.canopen.objects import Object, Type
from tsa_ctrl.bus.canopen.pdo import PDO_OFFSET, Pdo
from tsa_ctrl.bus.drive.session import Session, another_master
from tsa_ctrl.errors import BusError

_NAME = Object(0x1008, 0, Type.U32, "device name")
_HARDWARE = Object(0x1009, 0, Type.U32, "hardware version")
_SOFTWARE = Object(0x100A, 0, Type.U32, "software version")
CURRENT_NOMINAL = Object(0x3001, 1, Type.U32, "nominal current")  # of an EPOS4
CURRENT_LIMIT = Object(0x3001, 2, Type.U32, "output current limit")

READ: tuple[Object, ...] = (
    objects.DEVICE_TYPE, objects.VENDOR_ID, objects.PRODUCT_CODE, objects.REVISION, objects.SERIAL_NUMBER,
    objects.ERROR_REGISTER, objects.ERROR_HISTORY_COUNT, objects.SYNC_COB_ID, objects.SYNC_PERIOD, objects.SYNC_WINDOW,
    objects.SYNC_COUNTER, objects.EMCY_COB_ID, objects.GUARD_TIME, objects.LIFE_TIME_FACTOR,
    objects.HEARTBEAT_CONSUMERS, objects.HEARTBEAT_PRODUCER, objects.ERROR_BEHAVIOUR, objects.RPDO_EVENT_TIMER,
    objects.CONNECTION_LOSS, objects.ERROR_CODE, objects.CONTROLWORD, objects.STATUSWORD, objects.QUICK_STOP_OPTION,
    objects.SHUTDOWN_OPTION, objects.DISABLE_OPTION, objects.HALT_OPTION, objects.FAULT_REACTION_OPTION, objects.MODE,
    objects.MODE_DISPLAY, objects.POSITION_ACTUAL, objects.VELOCITY_ACTUAL, objects.TARGET_TORQUE, objects.MAX_TORQUE,
    objects.RATED_TORQUE, objects.TORQUE_ACTUAL, objects.MAX_MOTOR_SPEED, objects.ENCODER_INCREMENTS,
    objects.ENCODER_REVOLUTIONS, objects.GEAR_MOTOR, objects.GEAR_SHAFT, objects.VELOCITY_UNIT,
    objects.INTERPOLATION_PERIOD, objects.INTERPOLATION_EXPONENT, objects.SUPPORTED_MODES, CURRENT_NOMINAL,
    CURRENT_LIMIT, *(influence.entry for influence in cia402.TORQUE_PATH if influence.entry != objects.RATED_TORQUE),
)  # fmt: skip
PATIENCE = 2.0  # s, for an answer: four times what bringing a drive up allows, as nothing moves meanwhile
_SLOTS = 8
_PDOS = 4
_NEEDED = (objects.STATUSWORD, objects.CONTROLWORD, objects.TARGET_TORQUE, objects.TORQUE_ACTUAL)


@dataclass
class Probe:
    """Hold the answers of one axis of a drive. `values`: of the objects that it has; `lengths`: bytes where they are
    unusual.
    """

    node_id: int
    slot: int
    values: dict[Object, int] = field(default_factory=dict)
    lengths: dict[Object, int] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    slots: list[int] = field(default_factory=list)  # axes of the device
    rpdos: int = 0
    tpdos: int = 0
    mapped: dict[str, list[int]] = field(default_factory=dict)  # entries of the first PDOs, as they are now
    slowest: float = 0.0  # s, of the answers
    emcys: list[str] = field(default_factory=list)
    sync_heard: bool = False

    def has(self, entry: Object) -> bool:
        return entry in self.values

    def get(self, entry: Object) -> int | None:
        return self.values.get(entry)

    @property
    def modes(self) -> int | None:
        return self.get(objects.SUPPORTED_MODES)

    @property
    def state(self) -> str:
        return cia402.decode(self.values.get(objects.STATUSWORD, 0)).value


def probe(session: Session, name: str, node_id: int, slot: int = 1) -> Probe:
    """Ask a node for all that a profile is made of; raises BusError if it is not a drive, or a master is active on the
    bus.

    `name`: of the bus. A node that makes SYNC itself may be asked; another master's frames end it.
    """
    heard = session.listen()
    if heard - {cia301.SYNC}:
        raise BusError(another_master(name, heard))
    found = Probe(node_id, slot, sync_heard=bool(heard))
    session.be_patient(node_id, PATIENCE)
    first = session.read(node_id, objects.DEVICE_TYPE)  # raises without an answer
    for entry in READ:
        _read(session, found, entry)
    for text in (_NAME, _HARDWARE, _SOFTWARE):
        found.texts[text.name] = session.read_text(node_id, text)
    missing = [entry for entry in _NEEDED if not found.has(entry)]
    if missing:
        lacks = ", ".join(str(entry) for entry in missing)
        raise BusError(
            f"node {node_id}: device type is 0x{first:08X}, and there is no {lacks}: this is no CiA 402 drive with "
            "torque; correct --node (or --slot, of a device with several axes)"
        )
    found.slots = [n for n in range(1, _SLOTS + 1) if session.ask(node_id, objects.STATUSWORD.of(n)) is not None]
    found.rpdos = _count(session, node_id, slot, received=True)
    found.tpdos = _count(session, node_id, slot, received=False)
    for pdo in (Pdo(1, True, ()), Pdo(1, False, ()), Pdo(2, False, ())):
        found.mapped[pdo.name] = _mapping(session, node_id, pdo.of(slot))
    found.emcys = [str(emergency) for emergency in session.emcys(node_id)]
    return found


def _read(session: Session, found: Probe, entry: Object) -> None:
    here = entry.of(found.slot)
    if entry is objects.RPDO_EVENT_TIMER:
        here = replace(here, index=here.index + PDO_OFFSET * (found.slot - 1))
    begin = session.clock()
    data = session.upload_if_there(found.node_id, here)
    found.slowest = max(found.slowest, session.clock() - begin)
    if data is None:
        return
    found.values[entry] = here.decode(data)
    if len(data) != entry.type.size:
        found.lengths[entry] = len(data)


def _count(session: Session, node_id: int, slot: int, received: bool) -> int:
    """PDOs from the first on that can be configured."""
    for number in range(1, _PDOS + 1):
        entry = Pdo(number, received, ()).of(slot).communication(1, Type.U32, "COB-ID")
        if session.read_if_there(node_id, entry) is None:
            return number - 1
    return _PDOS


def _mapping(session: Session, node_id: int, pdo: Pdo) -> list[int]:
    count = session.read_if_there(node_id, pdo.mapping(0)) or 0
    entries = [session.read_if_there(node_id, pdo.mapping(number)) for number in range(1, min(count, 8) + 1)]
    return [entry for entry in entries if entry is not None]
