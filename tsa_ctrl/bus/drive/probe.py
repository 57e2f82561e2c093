"""Read the capabilities of a drive by SDO uploads, and write them as a profile with comments for its completion.

The probe writes nothing to the drive, moves nothing, and sends no SYNC.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from tsa_ctrl.bus.canopen import cia301, cia402, objects
from tsa_ctrl.bus.canopen.objects import Object, Type
from tsa_ctrl.bus.canopen.pdo import PDO_OFFSET, Pdo
from tsa_ctrl.bus.drive.profile import REACTIONS, VelocityUnit
from tsa_ctrl.bus.drive.session import Session, another_master
from tsa_ctrl.errors import BusError

_NAME = Object(0x1008, 0, Type.U32, "device name")
_HARDWARE = Object(0x1009, 0, Type.U32, "hardware version")
_SOFTWARE = Object(0x100A, 0, Type.U32, "software version")

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
    objects.INTERPOLATION_PERIOD, objects.INTERPOLATION_EXPONENT, objects.SUPPORTED_MODES,
    *(influence.entry for influence in cia402.TORQUE_PATH if influence.entry != objects.RATED_TORQUE),
)  # fmt: skip
PATIENCE = 2.0  # s, for an answer: four times the limit of the bring-up, because nothing moves during a probe
_SLOTS = 8
_PDOS = 4
_NEEDED = (objects.STATUSWORD, objects.CONTROLWORD, objects.TARGET_TORQUE, objects.TORQUE_ACTUAL)


@dataclass
class Probe:
    """The answers of one axis of a drive.

    Attributes:
        values: raw values of the objects that the drive has.
        lengths: length in bytes of each answer that differs from the size of the object's type.
        unreadable: objects that the drive has and refuses to send.
    """

    node_id: int
    slot: int
    values: dict[Object, int] = field(default_factory=dict)
    lengths: dict[Object, int] = field(default_factory=dict)
    unreadable: list[Object] = field(default_factory=list)
    texts: dict[str, str] = field(default_factory=dict)
    slots: list[int] = field(default_factory=list)  # axes of the device
    rpdos: int = 0
    tpdos: int = 0
    mapped: dict[str, list[int]] = field(default_factory=dict)  # mapping entries of the first PDOs, as found
    slowest: float = 0.0  # s, longest answer time
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
    """Return all values for a profile of a drive.

    Args:
        session: an open session.
        name: name of the bus in messages.
        node_id: node id of the drive.
        slot: place of the axis in its device.

    Raises:
        BusError: the node is not a torque drive, or another master is active. SYNC alone is tolerated, because the
            drive may generate it.
    """
    heard = session.listen()
    if heard - {cia301.SYNC}:
        raise BusError(another_master(name, heard))
    found = Probe(node_id, slot, sync_heard=bool(heard))
    session.be_patient(node_id, PATIENCE)
    first = session.read(node_id, objects.DEVICE_TYPE)  # raises BusError without an answer
    for entry in READ:
        _read(session, found, entry)
    for text in (_NAME, _HARDWARE, _SOFTWARE):
        found.texts[text.name] = session.read_text(node_id, text)
    missing = [entry for entry in _NEEDED if not found.has(entry) and entry.of(slot) not in found.unreadable]
    if missing:
        lacks = ", ".join(str(entry) for entry in missing)
        raise BusError(
            f"node {node_id}: device type is 0x{first:08X}, and {lacks} is missing: it is not a CiA 402 drive with "
            "torque mode; correct --node (or --slot, for a device with several axes)"
        )
    found.slots = [n for n in range(1, _SLOTS + 1) if session.ask(node_id, objects.STATUSWORD.of(n)) is not None]
    found.rpdos = _count(session, found, received=True)
    found.tpdos = _count(session, found, received=False)
    for pdo in (Pdo(1, True, ()), Pdo(1, False, ()), Pdo(2, False, ())):
        found.mapped[pdo.name] = _mapping(session, found, pdo.of(slot))
    found.emcys = [str(emergency) for emergency in session.emcys(node_id)]
    return found


def _read(session: Session, found: Probe, entry: Object) -> None:
    here = entry.of(found.slot)
    if entry is objects.RPDO_EVENT_TIMER:
        here = replace(here, index=here.index + PDO_OFFSET * (found.slot - 1))
    begin = session.clock()
    data = session.upload_if_there(found.node_id, here, found.unreadable)
    found.slowest = max(found.slowest, session.clock() - begin)
    if data is None:
        return
    found.values[entry] = here.decode(data)
    if len(data) != entry.type.size:
        found.lengths[entry] = len(data)


def _count(session: Session, found: Probe, received: bool) -> int:
    """Return the number of consecutive PDOs that can be configured, from the first one."""
    for number in range(1, _PDOS + 1):
        entry = Pdo(number, received, ()).of(found.slot).communication(1, Type.U32, "COB-ID")
        if session.upload_if_there(found.node_id, entry, found.unreadable) is None:
            return number - 1
    return _PDOS


def _mapping(session: Session, found: Probe, pdo: Pdo) -> list[int]:
    node_id, unreadable = found.node_id, found.unreadable
    count = session.read_if_readable(node_id, pdo.mapping(0), unreadable) or 0
    numbers = range(1, min(count, 8) + 1)
    entries = [session.read_if_readable(node_id, pdo.mapping(number), unreadable) for number in numbers]
    return [entry for entry in entries if entry is not None]


_ASK = "FINISH: "
_MODES = (  # bits of 0x6502
    (0, "profile position"),
    (2, "profile velocity"),
    (3, "profile torque"),
    (5, "homing"),
    (7, "cyclic position"),
    (8, "cyclic velocity"),
    (9, "cyclic torque"),
)
_USUAL = range(5)  # a drive may reject a change from any other value
_OPTIONAL = (
    objects.SYNC_PERIOD, objects.SYNC_WINDOW, objects.SYNC_COUNTER, objects.EMCY_COB_ID, objects.CONNECTION_LOSS,
    objects.INTERPOLATION_PERIOD, objects.INTERPOLATION_EXPONENT, objects.SUPPORTED_MODES, objects.ERROR_BEHAVIOUR,
    objects.RPDO_EVENT_TIMER,
)  # fmt: skip


def profile_text(found: Probe, where: str) -> str:
    """Return the text of a profile, which loads unchanged or lists the values to complete first.

    `where` is the interface and the channel.
    """
    return "\n".join(_lines(found, where)) + "\n"


def _lines(found: Probe, where: str) -> Iterator[str]:
    texts = found.texts
    name = texts.get("device name") or "unknown drive"
    yield f"# Written by tsa drive probe: node {found.node_id} on {where}, read without any motion."
    yield f"# Complete each line with {_ASK.strip()}: drives do not report this value, or not reliably."
    yield f"name = {json.dumps(name, ensure_ascii=False)}"
    version = ", ".join(f"{key} {texts[key]}" for key in ("hardware version", "software version") if texts.get(key))
    yield f"sources = [{json.dumps(f'values that the drive reported: {version or name}', ensure_ascii=False)}]"
    yield from _state(found)
    yield ""
    yield from _absent(found)
    yield from _modes(found)
    yield from _watchdogs(found)
    yield from _sync(found)
    yield from _timing(found)
    yield f"rpdo_count = {max(1, found.rpdos)}"
    yield f"tpdo_count = {max(2, found.tpdos)}"
    if found.rpdos < 1 or found.tpdos < 2:
        yield f"# {_ASK}it has {found.rpdos} RPDOs and {found.tpdos} TPDOs; one and two are needed"
    for pdo, entries in found.mapped.items():
        yield f"# {pdo} now maps: {', '.join(f'0x{entry:08X}' for entry in entries) or 'nothing'}"
    yield ""
    yield from _identity(found)
    yield ""
    yield from _units(found)
    yield from _torque_path(found)
    yield ""
    yield from _reactions(found)
    yield from _clamp(found)
    yield ""
    yield from _for_the_controller(found)


def _state(found: Probe) -> Iterator[str]:
    statusword = found.get(objects.STATUSWORD)
    if statusword is not None:
        yield f"# The drive was in state {found.state}, statusword 0x{statusword:04X}."
    code = found.get(objects.ERROR_CODE)
    if code:
        yield f"# Its error code was 0x{code:04X} ({cia301.text(code)})."
    for said in found.emcys:
        yield f"# It sent {said} during the probe."
    if len(found.slots) > 1:
        yield f"# The device has axes in slots {', '.join(map(str, found.slots))}; this is slot {found.slot}."
    for entry, length in found.lengths.items():
        yield f"# {_ASK}0x{entry.index:04X}:{entry.subindex} has {length} bytes instead of the usual {entry.type.size}"
    for entry in found.unreadable:
        yield f"# {_ASK}{entry} cannot be read and counts as absent; correct the lines below if it is needed"


def _absent(found: Probe) -> Iterator[str]:
    """Yield the absent objects that a profile must declare, and the other absent objects as a comment."""
    needed = [
        objects.MAX_TORQUE, objects.MAX_MOTOR_SPEED, objects.VELOCITY_UNIT, objects.RATED_TORQUE, objects.ERROR_CODE,
    ]  # fmt: skip
    names = [entry.name for entry in needed if not found.has(entry)]
    if not found.has(objects.SUPPORTED_MODES):
        names.append(objects.SUPPORTED_MODES.name)
    yield f"absent = {json.dumps(names)}"
    others = [entry.name for entry in _OPTIONAL if not found.has(entry) and entry.name not in names]
    if others:
        yield f"# Also absent, but not needed: {', '.join(others)}"


def _modes(found: Probe) -> Iterator[str]:
    modes = found.modes
    if modes is None:
        yield f"# {_ASK}it does not report its modes (0x6502); mode 10 (cyclic synchronous torque) is needed"
    else:
        yield f"# Modes 0x{modes:08X}: {', '.join(name for bit, name in _MODES if modes >> bit & 1) or 'none known'}"
        if not modes & cia402.CST_SUPPORTED:
            yield f"# {_ASK}no cyclic synchronous torque (bit 9): this controller cannot use it as it is"
    asked, shown = found.get(objects.MODE), found.get(objects.MODE_DISPLAY)
    if asked and shown != asked:
        yield f"# 0x6060 is {asked} and 0x6061 shows {shown} in state {found.state}: it shows its mode later"
        yield f'mode_shows = "enabled"          # {_ASK}or "operational"'
        return
    yield 'mode_shows = "written"          # else "operational" or "enabled"; startup reports if it must be changed'


def _watchdogs(found: Probe) -> Iterator[str]:
    consumers = found.get(objects.HEARTBEAT_CONSUMERS)
    held = found.get(objects.RPDO_EVENT_TIMER)
    names = []
    if consumers:
        names.append(f"{consumers} entries of the heartbeat consumer 0x1016")
    if held is not None:
        names.append("the RPDO event timer 0x1400:5")
    if found.has(objects.LIFE_TIME_FACTOR):
        names.append("life guarding 0x100D")
    yield f"# Watchdogs: {', '.join(names) or 'none'}; try them with tsa verify-safety."
    reaction = found.get(objects.CONNECTION_LOSS)
    yield "# Reaction to a lost connection 0x6007: " + ("absent" if reaction is None else f"{reaction} as found")
    if not found.has(objects.HEARTBEAT_PRODUCER):
        yield 'supervision = "guarding"        # the drive has no heartbeat 0x1017'
    elif not consumers and held is None and found.has(objects.LIFE_TIME_FACTOR):
        yield 'supervision = "guarding"        # its only watchdog is life guarding 0x100D'


def _sync(found: Probe) -> Iterator[str]:
    raw = found.get(objects.SYNC_COB_ID)
    if (raw is not None and raw & cia301.PRODUCES_SYNC) or found.sync_heard:
        yield "produces_sync = true            # 0x1005 bit 30 was set: it sends SYNC; startup disables that"
    for entry in (objects.SYNC_PERIOD, objects.SYNC_COUNTER, objects.SYNC_WINDOW):
        if found.get(entry):
            yield f"# {entry} is {found.get(entry)}; startup sets it to 0"
    if found.get(objects.SYNC_PERIOD):
        yield f"needs_sync_period = false       # {_ASK}true, if its manual requires the period in 0x1006"


def _torque_path(found: Probe) -> Iterator[str]:
    """Yield the objects that act on the torque, because their values may explain missing or unwanted torque."""
    for influence in cia402.TORQUE_PATH:
        value = found.get(influence.entry)
        if value is None:
            continue
        change = "" if influence.restored in (None, value) else f"; startup sets it to {influence.restored}"
        unit = f" {influence.unit}" if influence.unit else ""
        yield f"# {influence.entry} is {value}{unit}; it {influence.effect.value}{change}"


def _timing(found: Probe) -> Iterator[str]:
    patience = max(0.5, round(3.0 * found.slowest, 1))
    yield f"answer_timeout = {patience:g}            # s; its slowest answer took {1e3 * found.slowest:.0f} ms"
    yield "boot_timeout = 3.0              # s; boot time not measured: that would have reset the drive"


def _identity(found: Probe) -> Iterator[str]:
    yield "[identity]"
    vendor, product = found.get(objects.VENDOR_ID), found.get(objects.PRODUCT_CODE)
    if vendor is not None:
        yield f"vendor_id = 0x{vendor:08X}"
    yield f"product_codes = [{'' if product is None else f'0x{product:08X}'}]"


def _units(found: Probe) -> Iterator[str]:
    yield "[units]"
    rated = found.get(objects.RATED_TORQUE)
    if rated is not None:
        yield f"# {_ASK}0x6076 is {rated}: {rated * 1e-3:g} N*m in the standard's mN*m, {rated * 1e-6:g} N*m in uN*m,"
        yield "# and some count the peak value: compare with the motor's data sheet."
    yield "rated_torque = 1e-3             # N*m per digit of 0x6076"
    yield f"torque = 1000.0                 # {_ASK}digits of 0x6071 at rated torque, if it is not per mille"
    yield from _velocity(found)
    speed = found.get(objects.MAX_MOTOR_SPEED)
    if speed is not None:
        yield f"# 0x6080 is {speed}: compare with the motor's maximum in rpm."
    yield f'max_speed = "rpm"               # {_ASK}unit of 0x6080'


def _velocity(found: Probe) -> Iterator[str]:
    code = found.get(objects.VELOCITY_UNIT)
    if code is None:
        yield f"# {_ASK}the drive lacks 0x60A9: see its manual for the unit of 0x606C, drives/generic.toml for its name"
        yield 'velocity = "counts/s"'
        return
    known = {unit.si_code: unit for unit in VelocityUnit if unit.si_code is not None}
    unit = known.get(code)
    name = unit.value if unit is not None else "unknown unit"
    yield f"# 0x60A9 is 0x{code:08X}: {name}; finer is better near zero."
    yield 'velocity = "mrpm"               # value for 0x60A9; coarser if startup reports that it is rejected'


def _reactions(found: Probe) -> Iterator[str]:
    yield '[reactions]                      # 0: the motor coasts; "keep": unchanged; comments: values as found'
    for entry, key in REACTIONS.items():
        value = found.get(entry)
        if value is None:
            yield f'{key} = "keep"'.ljust(32) + "# the drive has no such object"
        else:
            wanted = '"keep"' if key == "halt" or value not in _USUAL else "0"
            yield f"{key} = {wanted}".ljust(32) + f"# {value} as found"


def _clamp(found: Probe) -> Iterator[str]:
    if found.has(objects.MAX_TORQUE):
        return
    yield ""
    yield f"# {_ASK}the drive lacks 0x6072: give the object that limits the torque, and the one that holds its value at"
    yield "# rated torque (or the values: rated = ..., zero = ... at no torque); the file does not load without them."
    yield "# [torque_clamp]"
    yield "# index = 0x3001"
    yield "# subindex = 2"
    yield "# rated_index = 0x3001"
    yield "# rated_subindex = 1"
    yield '# type = "u32"'
    yield '# name = "name of this object"'


def _for_the_controller(found: Probe) -> Iterator[str]:
    """Yield the keys for [axis.drive] as comments, because they are specific to this drive and its motor."""
    yield "# For [axis.drive] in the controller file:"
    yield f"#   node_id = {found.node_id}"
    if found.slot > 1:
        yield f"#   slot = {found.slot}"
    serial = found.get(objects.SERIAL_NUMBER)
    if serial:
        yield f"#   serial_number = {serial}"
    rated, current = found.get(objects.RATED_TORQUE), found.get(objects.RATED_CURRENT)
    if rated is not None:
        yield f"#   rated_torque = {rated * 1e-3:g}  # N*m, if the unit above is right"
    elif current is not None:
        yield f"#   rated_torque = ...  # N*m: torque constant times rated current, {current * 1e-3:g} A from 0x6075"
    increments, turns = found.get(objects.ENCODER_INCREMENTS), found.get(objects.ENCODER_REVOLUTIONS)
    if increments and turns:
        yield f"#   counts_per_revolution = {increments // turns}  # 0x608F"
    motor, shaft = found.get(objects.GEAR_MOTOR), found.get(objects.GEAR_SHAFT)
    if motor and shaft and motor != shaft:
        yield f"#   its own gear 0x6091 is {motor}:{shaft}; this controller requires positions and torques of the motor"
    if found.get(objects.POLARITY):
        yield f"#   its polarity 0x607E is 0x{found.get(objects.POLARITY):02X}: the drive reverses some signs"
