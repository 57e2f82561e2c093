"""List the objects written to each node before it may move.

Pure functions turn settings into a list of writes in order.
"""

from __future__ import annotations

from dataclasses import replace

from tsa_ctrl.bus.canopen import objects, pdo
from tsa_ctrl.bus.canopen.cia301 import COB_ID_INVALID, EMCY, SYNC
from tsa_ctrl.bus.canopen.cia402 import TORQUE_PATH, Mode
from tsa_ctrl.bus.canopen.objects import Object, Type, Write
from tsa_ctrl.bus.canopen.pdo import Pdo, Transmission
from tsa_ctrl.bus.drive.network import layout_of, torque_sensor_pdo
from tsa_ctrl.bus.drive.profile import PER_MILLE, REACTIONS, DriveProfile, DriveScale
from tsa_ctrl.bus.settings import (
    AxisNodes,
    BusSettings,
    DriveSettings,
    EncoderSettings,
    TorqueSensorSettings,
)
from tsa_ctrl.errors import UsageError

_NO_REMOTE = 0x40000000  # bit 30 of a TPDO's COB-ID: no remote frames; drives do not let others change it
_COB_ID_BITS = 0x7FFFFFFF  # all bits except "invalid"
_CONNECTION_LOSS = {"fault": 1, "disable_voltage": 2, "quick_stop": 3}  # values of 0x6007
_MILLISECONDS = -3  # exponent of 0x60C2 that every drive accepts; some accept no other
_MAX_EXPONENT, _MIN_EXPONENT = 0, -9
# Equivalent values if a drive rejects ours: with each of them the drive ends without torque.
_ENDS_WITHOUT_TORQUE = frozenset(range(5))  # 0x605A to 0x605E
_REACTS = frozenset({1, 2, 3})  # 0x6007: fault, disable voltage, quick stop
_FINE = {objects.ERROR_BEHAVIOUR: frozenset({0, 2})}  # pre-operational, stopped
_ANY = frozenset(range(1 << 16))  # event timer of a synchronous PDO, which has no effect; inhibit time of emergencies


def drive_plan(
    nodes: AxisNodes, profile: DriveProfile, scale: DriveScale, settings: BusSettings, period: float
) -> list[Write]:
    """Return the SDO writes that configure a drive for a SYNC period, s; reject contradictory settings."""
    drive = nodes.drive
    where = f"axis '{nodes.name}'"
    _check_timeouts(drive, settings, period, where)
    mantissa, exponent = interpolation_period(period)
    transmission = Transmission.EVERY_SYNC if settings.rpdo == "sync" else Transmission.ON_ARRIVAL
    layout = layout_of(drive, profile)
    options = [(entry, getattr(profile.reactions, key)) for entry, key in REACTIONS.items()]
    si_code = profile.units.velocity.si_code
    connection_loss = _CONNECTION_LOSS[drive.connection_loss]
    timer = replace(objects.RPDO_EVENT_TIMER, index=layout.command.communication(5, Type.U16, "").index)
    plan = [
        *_watching(drive, profile, settings),
        *sync_writes(period, profile.needs_sync_period),
        *emcy_writes(drive.node_id),
        Write(objects.CONNECTION_LOSS, connection_loss, optional=True, fine=_REACTS),
        *(
            Write(entry, value, optional=True, fine=_FINE.get(entry, _ENDS_WITHOUT_TORQUE))
            for entry, value in options
            if value != "keep"
        ),
        *pdo_writes(
            layout.command,
            layout.node_id,
            transmission,
            Write(timer, milliseconds(drive.rpdo_timeout), optional=True, watchdog=True),
        ),
        *pdo_writes(layout.motion, layout.node_id, layout.motion.every),
        *pdo_writes(layout.position, layout.node_id, layout.position.every),
        *spare_pdos(received=True, first=2, last=profile.rpdo_count, slot=drive.slot),
        *spare_pdos(received=False, first=3, last=profile.tpdo_count, slot=drive.slot),
        # Without 0x60A9 the unit of 0x606C cannot be verified. It is optional only if 0x606C is not used; otherwise the
        # profile must list it as absent.
        *([] if si_code is None else [Write(objects.VELOCITY_UNIT, si_code, optional=drive.differentiates)]),
        Write(objects.INTERPOLATION_PERIOD, mantissa, optional=True),
        Write(objects.INTERPOLATION_EXPONENT, exponent, optional=True),
        *([] if drive.polarity is None else [Write(objects.POLARITY, drive.polarity)]),
        _torque_clamp(profile, scale, where),
        Write(objects.MAX_MOTOR_SPEED, scale.max_speed_digits),
        *(Write(extra.entry, extra.raw) for extra in profile.extra),
        *(Write(each.entry, each.restored, optional=True) for each in TORQUE_PATH if each.restored is not None),
        Write(objects.TARGET_TORQUE, 0),
        Write(objects.MODE, Mode.CYCLIC_SYNC_TORQUE),
    ]
    return [replace(write, entry=write.entry.of(drive.slot)) for write in plan if profile.has(write.entry)]


def _watching(drive: DriveSettings, profile: DriveProfile, settings: BusSettings) -> list[Write]:
    """Return the writes that set up the mutual supervision of the drive and this computer."""
    if profile.supervision == "guarding":
        guard_time = milliseconds(settings.host_heartbeat_period)
        factor = max(1, round(milliseconds(drive.host_timeout) / guard_time))
        return [
            Write(objects.GUARD_TIME, guard_time, optional=True),
            Write(objects.LIFE_TIME_FACTOR, factor, optional=True, watchdog=True),
        ]
    consumer = settings.host_node_id << 16 | milliseconds(drive.host_timeout)
    return [
        Write(objects.HEARTBEAT_PRODUCER, milliseconds(drive.heartbeat_period)),
        Write(objects.HEARTBEAT_CONSUMER, consumer, optional=True, watchdog=True),
    ]


def sync_writes(period: float, needs_period: bool = False) -> list[Write]:
    """Return the writes that undo the SYNC settings of other tools: no counter, no window, no SYNC producer.

    If `needs_period`, the period (s) is written last, because the counter can be changed only while 0x1006 is 0 (CiA
    301).
    """
    writes = [
        Write(objects.SYNC_COB_ID, SYNC, optional=True, kept=COB_ID_INVALID),
        Write(objects.SYNC_PERIOD, 0, optional=True),
        Write(objects.SYNC_COUNTER, 0, optional=True),
        Write(objects.SYNC_WINDOW, 0, optional=True),
    ]
    if needs_period:
        writes.append(Write(objects.SYNC_PERIOD, round(1e6 * period)))
    return writes


def emcy_writes(node_id: int) -> list[Write]:
    """Return the writes that make a node send emergencies without delay and with the expected identifier.

    The identifier can be changed only while it is not valid. Source: CiA 301, 7.5.2.17 and 7.5.2.18.
    """
    return [
        Write(objects.EMCY_INHIBIT, 0, optional=True, fine=_ANY),
        Write(objects.EMCY_COB_ID, COB_ID_INVALID | EMCY + node_id, optional=True),
        Write(objects.EMCY_COB_ID, EMCY + node_id, optional=True),
    ]


def _torque_clamp(profile: DriveProfile, scale: DriveScale, where: str) -> Write:
    clamp, per_mille = profile.torque_clamp, scale.max_torque_digits
    if clamp is None:
        return Write(objects.MAX_TORQUE, per_mille)
    type_ = Type[clamp.type.upper()]
    entry = Object(clamp.index, clamp.subindex, type_, clamp.name)
    if clamp.rated_index is not None:
        rated = Object(clamp.rated_index, clamp.rated_subindex, type_, f"{clamp.name} at rated torque")
        return Write(entry, per_mille, rated=rated)
    assert clamp.rated is not None  # load_profile ensures this
    value = clamp.zero + int((clamp.rated - clamp.zero) * per_mille / PER_MILLE)  # rounded towards zero torque
    if not type_.low <= value <= type_.high:
        raise UsageError(
            f"{where}: max_torque is {per_mille} per mille of the rated torque, i.e. {value} in '{clamp.name}', "
            f"whose range is {type_.low} to {type_.high}; lower torque in [axis.limits], or correct rated in its "
            "profile's [torque_clamp]"
        )
    return Write(entry, value)


def sensor_plan(node: EncoderSettings | TorqueSensorSettings, period: float) -> list[Write]:
    """Return the SDO writes that configure a sensor for a SYNC period, s."""
    layout = pdo.ENCODER if isinstance(node, EncoderSettings) else torque_sensor_pdo(node)
    return [
        Write(objects.HEARTBEAT_PRODUCER, milliseconds(node.heartbeat_period)),
        *sync_writes(period),
        *emcy_writes(node.node_id),
        *pdo_writes(layout, node.node_id, layout.every),
        *spare_pdos(received=False, first=2, last=4),
    ]


def pdo_writes(layout: Pdo, node_id: int, transmission: int, *timers: Write) -> list[Write]:
    """Return the mapping procedure (CiA 301) as writes: disable, count 0, map, count, transmission, timers, enable."""
    cob_id = layout.communication(1, Type.U32, "COB-ID")
    kept = 0 if layout.received else _NO_REMOTE
    writes = [
        Write(cob_id, COB_ID_INVALID | layout.cob_id(node_id), kept=kept),
        Write(layout.mapping(0), 0),
        *(Write(layout.mapping(number), entry.mapping) for number, entry in enumerate(layout.objects, start=1)),
        Write(layout.mapping(0), len(layout.objects)),
        Write(layout.communication(2, Type.U8, "transmission type"), transmission),
        *timers,
    ]
    if not layout.received:
        writes.append(Write(layout.communication(3, Type.U16, "inhibit time"), 0, optional=True))
        writes.append(Write(layout.communication(5, Type.U16, "event timer"), 0, optional=True, fine=_ANY))
    writes.append(Write(cob_id, layout.cob_id(node_id), kept=kept))
    return writes


def spare_pdos(received: bool, first: int, last: int, slot: int = 1) -> list[Write]:
    """Return writes that disable unused PDOs, because they would only add to the bus load."""
    return [
        Write(
            Pdo(number, received, ()).of(slot).communication(1, Type.U32, "COB-ID"),
            COB_ID_INVALID,
            optional=True,
            kept=_COB_ID_BITS,
        )
        for number in range(first, last + 1)
    ]


def is_rate(rate: float) -> bool:
    """Return True if the period of this rate (Hz) can be written to a drive."""
    try:
        interpolation_period(1.0 / rate)
    except UsageError:
        return False
    return True


def interpolation_period(period: float) -> tuple[int, int]:
    """Return `period` (s) as mantissa (u8) and exponent (i8) of 0x60C2; raise UsageError if it cannot be represented.

    Whole milliseconds use the exponent -3, because some drives accept no other.
    """
    for exponent in (_MILLISECONDS, *range(_MAX_EXPONENT, _MIN_EXPONENT - 1, -1)):
        mantissa = round(period / 10.0**exponent)
        if 1 <= mantissa <= 255 and abs(mantissa * 10.0**exponent - period) < 1e-6 * period:
            return mantissa, exponent
    raise UsageError(
        f"rate {1.0 / period:g} Hz: a period of {period:g} s cannot be written to the drive (0x60C2 is 1 to 255 times "
        "a power of ten of a second); choose a rate such as 1000, 800, 500, 400, 250 or 200 Hz"
    )


def milliseconds(seconds: float) -> int:
    """Return a time as whole milliseconds, at least 1."""
    return max(1, round(1e3 * seconds))


def _check_timeouts(drive: DriveSettings, settings: BusSettings, period: float, where: str) -> None:
    if drive.rpdo_timeout < 2.0 * period:
        raise UsageError(
            f"{where}: drive rpdo_timeout {drive.rpdo_timeout:g} s is shorter than two periods of {period:g} s; "
            f"set it to at least {2.0 * period:g} s"
        )
    if drive.host_timeout < 2.0 * settings.host_heartbeat_period:
        raise UsageError(
            f"{where}: drive host_timeout {drive.host_timeout:g} s is shorter than two heartbeat periods "
            f"({settings.host_heartbeat_period:g} s each); set it to at least "
            f"{2.0 * settings.host_heartbeat_period:g} s"
        )
