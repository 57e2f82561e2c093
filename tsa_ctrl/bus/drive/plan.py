"""What is written to each node before it may move: pure functions from settings to a list of writes, in order."""

from __future__ import annotations

from collections.abc import Sequence

from tsa_ctrl.bus.canopen import objects, pdo
from tsa_ctrl.bus.canopen.cia301 import COB_ID_INVALID, SYNC
from tsa_ctrl.bus.canopen.cia402 import Mode
from tsa_ctrl.bus.canopen.objects import Object, Type, Write
from tsa_ctrl.bus.canopen.pdo import Pdo, Transmission
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.drive.scale import DriveScale
from tsa_ctrl.bus.settings import AxisNodes, BusSettings, DriveSettings, EncoderSettings, NodeSettings
from tsa_ctrl.errors import UsageError

_NO_REMOTE = 0x40000000  # bit 30 of a TPDO's COB-ID: no remote frames; drives insist on their own choice
_COB_ID_BITS = 0x7FFFFFFF  # all but "invalid"
_CONNECTION_LOSS = {"fault": 1, "disable_voltage": 2, "quick_stop": 3}  # values of 0x6007
_MAX_EXPONENT, _MIN_EXPONENT = 0, -9


def drive_plan(
    nodes: AxisNodes, profile: DriveProfile, scale: DriveScale, settings: BusSettings, period: float
) -> list[Write]:
    """Writes of a drive at a SYNC period in s; raises UsageError when the settings contradict each other."""
    drive = nodes.drive
    where = f"axis '{nodes.name}'"
    _check_timeouts(drive, settings, period, where)
    mantissa, exponent = interpolation_period(period)
    transmission = Transmission.EVERY_SYNC if settings.rpdo == "sync" else Transmission.ON_ARRIVAL
    consumer = settings.host_node_id << 16 | milliseconds(drive.host_timeout)
    reactions = profile.reactions
    options = (
        (objects.ERROR_BEHAVIOUR, reactions.communication_error),
        (objects.QUICK_STOP_OPTION, reactions.quick_stop),
        (objects.SHUTDOWN_OPTION, reactions.shutdown),
        (objects.DISABLE_OPTION, reactions.disable_operation),
        (objects.HALT_OPTION, reactions.halt),
        (objects.FAULT_REACTION_OPTION, reactions.fault),
    )
    si_code = profile.units.velocity.si_code
    plan = [
        Write(objects.HEARTBEAT_PRODUCER, milliseconds(drive.heartbeat_period)),
        Write(objects.SYNC_COB_ID, SYNC, optional=True, kept=COB_ID_INVALID),
        Write(objects.HEARTBEAT_CONSUMER, consumer, optional=True, watchdog=True),
        Write(objects.CONNECTION_LOSS, _CONNECTION_LOSS[drive.connection_loss], optional=True),
        *(Write(entry, value, optional=True) for entry, value in options if value != "keep"),
        *pdo_writes(
            pdo.COMMAND,
            drive.node_id,
            transmission,
            Write(objects.RPDO_EVENT_TIMER, milliseconds(drive.rpdo_timeout), optional=True, watchdog=True),
        ),
        *pdo_writes(pdo.MOTION, drive.node_id, Transmission.EVERY_SYNC),
        *pdo_writes(pdo.POSITION, drive.node_id, Transmission.EVERY_SYNC),
        *spare_pdos(received=True, first=2, last=profile.rpdo_count),
        *spare_pdos(received=False, first=3, last=profile.tpdo_count),
        # Without it the unit of 0x606C would only be believed: then the profile must say that the drive lacks it.
        *(
            []
            if si_code is None
            else [Write(objects.VELOCITY_UNIT, si_code, optional=drive.velocity_source != "drive")]
        ),
        Write(objects.INTERPOLATION_PERIOD, mantissa, optional=True),
        Write(objects.INTERPOLATION_EXPONENT, exponent, optional=True),
        _torque_clamp(profile, scale),
        Write(objects.MAX_MOTOR_SPEED, scale.max_speed_digits),
        *(
            Write(Object(extra.index, extra.subindex, Type[extra.type.upper()], extra.name), extra.value)
            for extra in profile.extra
        ),
        Write(objects.TARGET_TORQUE, 0),
        Write(objects.MODE, Mode.CYCLIC_SYNC_TORQUE),
    ]
    return [write for write in plan if profile.has(write.entry)]


def _torque_clamp(profile: DriveProfile, scale: DriveScale) -> Write:
    clamp = profile.torque_clamp
    if clamp is None:
        return Write(objects.MAX_TORQUE, scale.max_torque_digits)
    type_ = Type[clamp.type.upper()]
    rated = Object(clamp.rated_index, clamp.rated_subindex, type_, f"{clamp.name} at rated torque")
    return Write(Object(clamp.index, clamp.subindex, type_, clamp.name), scale.max_torque_digits, rated=rated)


def encoder_plan(encoder: EncoderSettings) -> list[Write]:
    """Writes of a joint encoder."""
    return _sensor_plan(encoder, pdo.ENCODER)


def torque_sensor_plan(sensor: NodeSettings) -> list[Write]:
    """Writes of a torque sensor."""
    return _sensor_plan(sensor, pdo.TORQUE_SENSOR)


def _sensor_plan(node: NodeSettings, layout: Pdo) -> list[Write]:
    return [
        Write(objects.HEARTBEAT_PRODUCER, milliseconds(node.heartbeat_period)),
        *pdo_writes(layout, node.node_id, Transmission.EVERY_SYNC),
        *spare_pdos(received=False, first=2, last=4),
    ]


def pdo_writes(layout: Pdo, node_id: int, transmission: Transmission, *timers: Write) -> list[Write]:
    """The mapping procedure of CiA 301: disable, count 0, map, count, transmission and timers, enable."""
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
        writes.append(Write(layout.communication(5, Type.U16, "event timer"), 0, optional=True))
    writes.append(Write(cob_id, layout.cob_id(node_id), kept=kept))
    return writes


def spare_pdos(received: bool, first: int, last: int) -> list[Write]:
    """Switch off the PDOs that nobody uses: they would only load the bus."""
    return [
        Write(
            Pdo(number, received, ()).communication(1, Type.U32, "COB-ID"),
            COB_ID_INVALID,
            optional=True,
            kept=_COB_ID_BITS,
        )
        for number in range(first, last + 1)
    ]


def interpolation_period(period: float) -> tuple[int, int]:
    """`period` (s) as mantissa (u8) and exponent (i8) of 0x60C2; raises UsageError when it is not such a number."""
    for exponent in range(_MAX_EXPONENT, _MIN_EXPONENT - 1, -1):
        mantissa = round(period / 10.0**exponent)
        if mantissa > 255:
            break
        if mantissa and abs(mantissa * 10.0**exponent - period) < 1e-6 * period:
            return mantissa, exponent
    raise UsageError(
        f"rate {1.0 / period:g} Hz: a period of {period:g} s cannot be written to the drive (0x60C2 is 1 to 255 times "
        "a power of ten of a second); choose a rate such as 1000, 800, 500, 400, 250 or 200 Hz"
    )


def milliseconds(seconds: float) -> int:
    """Whole milliseconds, at least 1."""
    return max(1, round(1e3 * seconds))


def _check_timeouts(drive: DriveSettings, settings: BusSettings, period: float, where: str) -> None:
    if drive.rpdo_timeout < 2.0 * period:
        raise UsageError(
            f"{where}: drive rpdo_timeout {drive.rpdo_timeout:g} s is less than two periods of {period:g} s; "
            f"give at least {2.0 * period:g} s"
        )
    if drive.host_timeout < 2.0 * settings.host_heartbeat_period:
        raise UsageError(
            f"{where}: drive host_timeout {drive.host_timeout:g} s is less than two of our heartbeats "
            f"({settings.host_heartbeat_period:g} s); give at least {2.0 * settings.host_heartbeat_period:g} s"
        )


def check_node_ids(settings: BusSettings, axes: Sequence[AxisNodes]) -> None:
    """Raises UsageError when two nodes of one bus have one id, or a node has the host's."""
    seen: dict[int, str] = {settings.host_node_id: "[bus] host_node_id"}
    for axis in axes:
        for role, node in (("drive", axis.drive), ("encoder", axis.encoder), ("torque_sensor", axis.torque_sensor)):
            if node is None:
                continue
            name = f"axis '{axis.name}' {role}"
            if node.node_id in seen:
                raise UsageError(
                    f"{name}: node_id {node.node_id} is also that of {seen[node.node_id]}; every node needs its own"
                )
            seen[node.node_id] = name
