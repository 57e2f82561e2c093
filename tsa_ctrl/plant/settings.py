"""Define the settings of the simulated machine (`plant.toml`): strict keys, SI units, each default in one place."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec
from msgspec import Meta

from tsa_ctrl import settings
from tsa_ctrl.arguments import path_of
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.catalogue import CATALOGUE, check_effects

NodeId = Annotated[int, Meta(ge=1, le=127)]
Positive = Annotated[float, Meta(gt=0.0)]
NonNegative = Annotated[float, Meta(ge=0.0)]
# Limits beyond which a value is in another unit
Angle = Annotated[float, Meta(ge=-100.0, le=100.0)]  # rad
SignedTorque = Annotated[float, Meta(ge=-1e4, le=1e4)]  # N*m
Torque = Annotated[float, Meta(gt=0.0, le=1e4)]  # N*m
Load = Annotated[float, Meta(ge=0.0, le=1e4)]  # N*m
Seconds = Annotated[float, Meta(ge=0.0, le=3600.0)]
Ratio = Annotated[float, Meta(gt=0.0, le=1e4)]
Factor = Annotated[float, Meta(ge=0.0, le=10.0)]
Sign = Literal[1, -1]
Word = Annotated[int, Meta(ge=0, le=0xFFFFFFFF)]
Counts = Annotated[int, Meta(ge=1, le=1 << 31)]
Code = Annotated[int, Meta(ge=0, le=0xFFFF)]
ObjectName = Annotated[str, Meta(pattern=r"^0x[0-9A-Fa-f]{4}(:[0-9]{1,3})?$")]
ModeName = Literal["pp", "pv", "tq", "csp", "csv", "cst"]
LEG = Path(__file__).parent / "leg.xml"  # MJCF of a leg: hip, knee and ankle above the ground
HandRow = tuple[NonNegative, NonNegative, NonNegative, float]  # s, N*m/rad, N*m*s/rad, rad


class BusSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define the bus of the nodes."""

    name: str = ""  # required with several buses; each axis refers to its bus by name
    interface: str = "socketcan"  # or "datagram", or any python-can interface
    channel: Annotated[str, Meta(pattern=r"^[^\0]+$")] = "vcan0"
    bitrate: Annotated[int, Meta(ge=10_000, le=1_000_000)] = 1_000_000  # bit/s, for adapters that need it
    options: dict[str, str | int | float | bool] = {}  # further arguments for the python-can interface


class PhysicsSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define the table [physics]."""

    step: Annotated[float, Meta(ge=1e-6, le=1e-4)] = 1e-4  # s, longest sub-step
    record_period: Annotated[float, Meta(ge=1e-3, le=1.0)] = 1e-3  # s, between two rows of the record
    seed: int = 1  # of all noise
    priority: Annotated[int, Meta(ge=0, le=98)] = 60  # of SCHED_FIFO, if permitted; 0: never
    start: Literal["power_on", "first_enable"] = "power_on"  # when imposed motion and time-dependent effects begin


DriveKind = Literal["generic", "epos4", "elmo_gold", "technosoft_ipos", "kinco", "nanotec", "copley", "ingenia"]


class Quirks(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Describe how one drive deviates from CiA 301 and 402; the fields are keys of `[axis.drive]`.

    Each deviation was found on a real stack, and each default follows the standard. `absent`, `objects` and
    `read_only` imitate further deviations.
    """

    # object dictionary
    objects: dict[str, int] = {}  # other values at power-on, for example "0x6072:0" = 500
    absent: list[int | ObjectName] = []  # objects that this drive lacks, for example 0x60A9 or "0x1400:5"
    read_only: list[ObjectName] = []  # objects that cannot be written, for example "0x6007"
    fixed_mapping: bool = False  # true: the PDO mapping is the one that this controller requires, and is read-only
    heartbeat_consumers: Annotated[int, Meta(ge=1, le=8)] = 4  # number of entries of 0x1016
    modes: tuple[ModeName, ...] = ("cst",)  # modes that 0x6502 reports and 0x6060 accepts

    # startup
    boot_time: Seconds = 0.0  # time from reset or power-on to the boot-up message, s
    starts_itself: bool = False  # true: the drive enters the state operational after the boot-up without a command
    emcy_at_boot: Code = 0  # error code of an EMCY that follows the boot-up message; 0: no EMCY
    answer_time: Seconds = 0.0  # time from an SDO request to its response, s
    node_id_unset: bool = False  # true: the drive has no node id until LSS assigns one
    sync_producer: bool = False  # true: bit 30 of 0x1005 is set at power-on, and the drive sends a SYNC every 10 ms

    # watchdogs
    watchdogs: bool = True  # false: the drive accepts time-outs and reports when one expires, but keeps its torque
    watches_always: bool = False  # true: with 0x6007 = 1, a lost heartbeat is a fault even if the drive is disabled
    rpdo_timer_on_sync: bool = False  # true: the drive checks the RPDO event timer only at a SYNC
    node_guarding: bool = False  # true: node guarding (0x100C, 0x100D, remote frames) replaces the heartbeat
    guarding_toggles: bool = True  # false: the toggle bit of node guarding is constant

    # commands
    delay_periods: Annotated[int, Meta(ge=0, le=8)] = 0  # delay of a command in addition to the standard's, SYNCs

    # state machine
    mode_shows: Literal["written", "operational", "enabled"] = "written"  # when 0x6061 reports the mode, otherwise 0
    step_time: Seconds = 0.0  # least time between two transitions towards operation enabled, s
    statusword_bits: Code = 0  # bits of the statusword that are always set, for example the maker's bits 8, 14 and 15
    reports_following: bool = True  # false: bit 12 of the statusword is always 0
    safe_torque_off: bool = False  # true: safe torque off is active; the drive stays in switch on disabled, bit 4 is 0
    warns_when_enabled: Code = 0  # error code of an EMCY without a fault at every enable; 0: no EMCY


class DriveSettings(Quirks, frozen=True, kw_only=True):
    """Define a CiA 402 drive and its power stage; `Quirks` has its deviations from the standard."""

    node_id: NodeId | None = None  # default: 1 + place of the axis
    slot: Annotated[int, Meta(ge=1, le=8)] = 1  # place in a device with several axes, which share a node id
    kind: DriveKind = "generic"  # the drive that it emulates, see `drive_emulation`
    name: str = "simulated drive"
    vendor: Word = 0x00000F0F
    product: Word = 0x0402
    serial_number: Word | None = None  # default: the node id
    rated_torque: Torque = 1.0  # N*m of the motor
    rated_torque_unit: Torque = 1e-3  # N*m per digit of 0x6076
    gear_ratio: Ratio = 1.0  # motor revolutions per revolution of the motor pulley
    counts_per_revolution: Counts = 65536  # of the motor, 0x6064
    velocity_exponent: Annotated[int, Meta(ge=-6, le=0)] = -3  # 0x606C in units of 10^exponent rpm
    torque_sign: Sign = 1
    position_sign: Sign = 1
    torque_time_constant: Seconds = 0.5e-3  # s, current loop
    peak_torque: Torque = 3.0  # N*m at the motor, limit of the power stage
    torque_noise: Load = 2e-3  # N*m at the pulley, standard deviation of 0x6077


class MotorSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define the table [axis.motor]."""

    inertia: NonNegative = 1e-4  # kg*m^2 at the motor pulley; 0: the torque acts on the tendons without delay
    damping: Positive = 1e-4  # N*m*s/rad


class TendonSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define the simulation of the tendon pair, and the places where the sheaths bend."""

    kind: Literal["full", "distributed"] = "full"
    curvature: Literal["uniform", "motor_end", "joint_end", "s_bent"] | list[tuple[float, float]] = "uniform"
    elements: Annotated[int, Meta(ge=1, le=1000)] = 40  # per tendon, distributed
    bristle_stiffness: NonNegative = 0.0  # N/m of one whole tendon on its liner, distributed; 0: rigid
    presliding: NonNegative = 0.0  # m of tendon until sticking turns into sliding, full; 0: from the elasticity


class JointSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define the load of the joint pulley; the delivered torque moves all loads except "imposed" and "held"."""

    load: Literal["imposed", "held", "free", "spring", "weight", "limb", "wearer"] = "imposed"
    inertia: Positive | None = None  # kg*m^2; default 0.02, of limb and wearer 0.05
    damping: NonNegative | None = None  # N*m*s/rad; default 0.05, of limb and wearer 0.1
    stiffness: NonNegative = 4.0  # N*m/rad, of the spring
    rest_angle: float = 0.0  # rad, of the spring
    weight_torque: Load | None = None  # N*m, m g l of weight, limb, wearer; default 1, of limb and wearer 4
    weight_phase: Angle = 0.0  # rad: torque m g l sin(q + phase)
    initial_angle: float = 0.0  # rad; where a held joint stays
    hand: list[HandRow] = []  # [s, N*m/rad, N*m*s/rad, rad], for loads that move; default none, for wearer a script
    hand_repeat: bool = True  # the script starts again at its end; otherwise it stays there


class MotionSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define the prescribed motion of the joint (load = "imposed")."""

    kind: Literal["gait", "sine", "file", "still"] = "gait"
    amplitude: Angle = 0.5  # rad, of the sine
    frequency: Annotated[float, Meta(ge=1e-3, le=1e3)] = 0.5  # Hz, of the sine
    offset: Angle = 0.0  # rad, mean of the sine, or the constant angle
    phase: Angle = 0.0  # rad, of the sine
    period: Annotated[float, Meta(ge=1e-2, le=1e3)] = 1.6  # s, of the gait cycle
    scale: float = 1.0  # of the gait profile or of the file
    file: str | None = None  # CSV with columns t, q_j and optionally omega_j
    repeat: bool = True  # repeat the file; otherwise the joint stays at its end
    ramp: Seconds = 1.0  # s, in which the motion grows from standstill


class EncoderSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define the table [axis.encoder]."""

    present: bool = True
    node_id: NodeId | None = None  # default: 32 + place of the axis
    name: str = "simulated encoder"
    vendor: Word = 0x00000F0F
    product: Word = 0x0406
    serial_number: Word | None = None  # default: the node id
    counts_per_revolution: Counts = 1 << 20
    sign: Sign = 1
    zero: Word = 0  # counts at q_j = 0


class TorqueSensorSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define the table [axis.torque_sensor]."""

    present: bool = True
    node_id: NodeId | None = None  # default: 64 + place of the axis
    name: str = "simulated torque sensor"
    vendor: Word = 0x00000F0F
    product: Word = 0x0404
    serial_number: Word | None = None  # default: the node id
    resolution: Torque = 1e-6  # N*m per digit of 0x9130:1
    sign: Sign = 1
    offset: SignedTorque = 0.0  # N*m
    noise: Load = 5e-3  # N*m, standard deviation


class PerturbationSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define factors on the actuator file's values, so that the true actuator is not nominal."""

    friction_coefficient: Factor = 1.0
    pretension: Factor = 1.0
    bending_angle: Factor = 1.0
    axial_stiffness: Annotated[float, Meta(gt=0.0, le=10.0)] = 1.0
    motor_pulley_radius: Annotated[float, Meta(gt=0.0, le=10.0)] = 1.0
    joint_pulley_radius: Annotated[float, Meta(gt=0.0, le=10.0)] = 1.0


class EnvironmentSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define changes around the sheaths while the plant runs: tables of [time in s, value], linear in between."""

    bending: list[tuple[float, float]] = []  # factor on the bending angle; the path length follows (3.50)
    temperature: list[tuple[float, float]] = []  # deg C; empty: 25


class FaultSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define one fault with the keys of the control socket; see `faults.FAULTS` for names and values."""

    name: str
    node: Literal["drive", "encoder", "torque_sensor"] = "drive"
    at: NonNegative = 0.0  # s from the plant's start, or from now on the control socket
    duration: NonNegative = 0.0  # s; 0: without end
    value: float | None = None  # depends on the fault


class MechanismSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define the table [mechanism]: the connection of the joints."""

    kind: Literal["joints", "mujoco"] = "joints"  # connected by the sheaths only, or by a limb of several joints
    model: str | None = None  # MJCF of the limb, relative to this file; default: the leg that comes with the program


class AxisSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define one drive, joint and pair of tendon-sheaths."""

    name: str
    bus: str | None = None  # name of its bus; default: the only one
    actuator: str = "actuator.toml"  # model file, relative to this file
    perturbation: PerturbationSettings = PerturbationSettings()
    tendon: TendonSettings = TendonSettings()
    drive: DriveSettings = DriveSettings()
    motor: MotorSettings = MotorSettings()
    joint: JointSettings = JointSettings()
    motion: MotionSettings = MotionSettings()
    encoder: EncoderSettings = EncoderSettings()
    torque_sensor: TorqueSensorSettings = TorqueSensorSettings()
    environment: EnvironmentSettings = EnvironmentSettings()
    effects: dict[str, dict[str, Any]] = {}
    fault: list[FaultSettings] = []


N = TypeVar("N", DriveSettings, EncoderSettings, TorqueSensorSettings)


class PlantSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Hold the content of a plant file."""

    bus: BusSettings = BusSettings()  # the first, if there are several
    other_buses: list[BusSettings] = msgspec.field(default_factory=list, name="[[bus]]")  # see `load_plant`
    physics: PhysicsSettings = PhysicsSettings()
    mechanism: MechanismSettings = MechanismSettings()
    axis: Annotated[list[AxisSettings], Meta(min_length=1, max_length=16)]

    @property
    def buses(self) -> tuple[BusSettings, ...]:
        """Return all buses, in the order of the file."""
        return (self.bus, *self.other_buses)

    def bus_number(self, axis: AxisSettings) -> int:
        """Return the place of an axis' bus in `buses`."""
        return next(place for place, bus in enumerate(self.buses) if axis.bus in (None, bus.name))


def load_plant(path: str | Path) -> PlantSettings:
    """Read and check `plant.toml`. Nodes of axis i without an id get 1 + i, 32 + i and 64 + i. Raises UsageError."""
    path = path_of(path, "plant file", "its path")
    data = settings.read_toml(path)
    listed = data.get("bus")
    others: list[BusSettings] = []
    if isinstance(listed, list) and listed and all(isinstance(table, dict) for table in listed):
        places = [f"{path}: {settings.named(f'bus[{index}]', data)}" for index in range(len(listed))]
        others = [settings.convert(table, BusSettings, place) for place, table in zip(places, listed, strict=True)][1:]
        data = {**data, "bus": listed[0]}
    plant = msgspec.structs.replace(settings.convert(data, PlantSettings, path), other_buses=others)
    _check_buses(plant, path)
    axes = [_completed(axis, place, path, plant.mechanism.kind == "mujoco") for place, axis in enumerate(plant.axis)]
    _check_unique(axes, path)
    return msgspec.structs.replace(plant, axis=axes, mechanism=_placed(plant, path))


def _check_buses(plant: PlantSettings, path: Path) -> None:
    """Raise UsageError unless each axis is on one bus, and each of several buses has a name and an axis."""
    names = [bus.name for bus in plant.buses]
    if len(names) > 1 and (not all(names) or len(set(names)) < len(names)):
        raise UsageError(f"{path}: [[bus]] names {', '.join(map(repr, names))}; give each bus its own name")
    for axis in plant.axis:
        if axis.bus is None and len(names) > 1:
            raise UsageError(f"{path}: axis '{axis.name}': names no bus; write bus with one of {', '.join(names)}")
        if axis.bus is not None and axis.bus not in names:
            known = ", ".join(filter(None, names)) or "a [bus] without a name"
            raise UsageError(f"{path}: axis '{axis.name}': there is no bus '{axis.bus}'; the file has {known}")
    for name in names if len(names) > 1 else []:
        if all(axis.bus != name for axis in plant.axis):
            raise UsageError(f"{path}: [[bus]] '{name}': no axis uses it; write bus = \"{name}\" in one, or remove it")


def _placed(plant: PlantSettings, path: Path) -> MechanismSettings:
    """Return the mechanism with the path of its model; raises UsageError for settings that exclude each other."""
    mechanism = plant.mechanism
    if mechanism.kind == "joints":
        if mechanism.model is not None:
            raise UsageError(f'{path}: [mechanism] kind "joints" has no model; remove model, or set kind = "mujoco"')
        return mechanism
    for axis in plant.axis:
        start = JointSettings(initial_angle=axis.joint.initial_angle, hand=axis.joint.hand)
        start = msgspec.structs.replace(start, hand_repeat=axis.joint.hand_repeat)
        for table, given, kept in (("joint", axis.joint, start), ("motion", axis.motion, MotionSettings())):
            if given != kept:
                raise UsageError(
                    f"{path}: axis '{axis.name}': [axis.{table}] describes a separate joint, and [mechanism] "
                    'kind "mujoco" a limb; allowed are initial_angle, hand and hand_repeat of [axis.joint]; '
                    "remove the rest"
                )
    model = LEG if mechanism.model is None else path.parent / mechanism.model
    return msgspec.structs.replace(mechanism, model=str(model))


ABSENT = frozenset({"pretension_per_joint_angle"})  # effects of model files that the plant does not simulate


def _completed(axis: AxisSettings, place: int, path: Path, on_limb: bool) -> AxisSettings:
    where = f"{path}: axis '{axis.name}'"
    if axis.motion.kind == "file" and axis.motion.file is None and axis.joint.load != "held":
        raise UsageError(f'{where}: [axis.motion] kind = "file" without file; give a CSV with columns t, q_j')
    _check_tables(axis, where, on_limb)
    return msgspec.structs.replace(
        axis,
        actuator=str(path.parent / axis.actuator),
        motion=msgspec.structs.replace(axis.motion, file=axis.motion.file and str(path.parent / axis.motion.file)),
        drive=_numbered(axis.drive, 1 + place),
        encoder=_numbered(axis.encoder, 32 + place),
        torque_sensor=_numbered(axis.torque_sensor, 64 + place),
        effects=check_effects(axis.effects, where),
    )


def _numbered(node: N, node_id: int) -> N:
    return node if node.node_id is not None else msgspec.structs.replace(node, node_id=node_id)


def _check_tables(axis: AxisSettings, where: str, on_limb: bool) -> None:
    for name in ABSENT.intersection(axis.effects):
        raise UsageError(f"{where}: [axis.effects.{name}] is not simulated by the plant; remove it")
    for name in ("bending", "temperature"):
        table = getattr(axis.environment, name)
        if any(a[0] >= b[0] for a, b in itertools.pairwise(table)):
            raise UsageError(f"{where}: [axis.environment] {name}: times must increase; sort the table")
    joint = axis.joint
    if any(a[0] >= b[0] for a, b in itertools.pairwise(joint.hand)):
        raise UsageError(f"{where}: [axis.joint] hand: times must increase; sort the table")
    if joint.hand and joint.load in ("imposed", "held") and not on_limb:
        raise UsageError(
            f'{where}: [axis.joint] hand cannot move a joint with load "{joint.load}"; remove hand, or '
            "choose a load that moves: free, spring, weight, limb, wearer"
        )
    if not isinstance(axis.tendon.curvature, str):
        points = [list(point) for point in axis.tendon.curvature]
        profile = CATALOGUE["elongation_coupling"].parameter("curvature_profile")
        if not profile.accepts(points):
            raise UsageError(f'{where}: [axis.tendon] curvature = {points}; give "s_bent" or {profile.describe()}')


def _check_unique(axes: list[AxisSettings], path: Path) -> None:
    used: dict[int | None, str] = {}
    slots: dict[tuple[int | None, int], str] = {}
    names: set[str] = set()
    for axis in axes:
        if axis.name in names:
            raise UsageError(f"{path}: two axes are called '{axis.name}'; give each a different name")
        names.add(axis.name)
        sensors = [node.node_id for node in (axis.encoder, axis.torque_sensor) if node.present]
        place = (axis.drive.node_id, axis.drive.slot)
        if place in slots:
            raise UsageError(
                f"{path}: axis '{axis.name}': slot {axis.drive.slot} of node {axis.drive.node_id} is already used by "
                f"axis '{slots[place]}'; give each axis of one device a different slot"
            )
        shared = any(node_id == axis.drive.node_id for node_id, _ in slots)
        slots[place] = axis.name
        for node_id in sensors if shared else [axis.drive.node_id, *sensors]:
            if node_id in used:
                raise UsageError(
                    f"{path}: axis '{axis.name}': node {node_id} is already {used[node_id]}; "
                    "give each node a different id"
                )
            used[node_id] = f"a node of axis '{axis.name}'"
