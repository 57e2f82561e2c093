"""Read and check the controller's configuration, one strict file and the files that it names, before anything moves."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from tsa_ctrl import settings
from tsa_ctrl.arguments import path_of
from tsa_ctrl.bus.canopen.eds import check_plan
from tsa_ctrl.bus.drive import budget
from tsa_ctrl.bus.drive.budget import Load
from tsa_ctrl.bus.drive.network import axes_of, check_buses, check_node_ids
from tsa_ctrl.bus.drive.plan import drive_plan
from tsa_ctrl.bus.drive.profile import PER_MILLE, DriveProfile, drive_scale, load_profile
from tsa_ctrl.bus.settings import AxisNodes, BusSettings
from tsa_ctrl.control.bending import routing_of
from tsa_ctrl.control.estimator_selection import chosen
from tsa_ctrl.control.kalman import unsupported_reason as unsupported_by_sensor
from tsa_ctrl.control.law_design import Limits, Plan, design_law, reversal_speed
from tsa_ctrl.control.setpoint import SetPoint, largest
from tsa_ctrl.control.settings import (
    BendingSettings,
    DirectionSettings,
    EstimatorSettings,
    LawSettings,
    SetPointSettings,
    TemperatureSettings,
)
from tsa_ctrl.control.tension_estimator import unsupported_reason as unsupported_by_tension
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.actuator_file import ActuatorFile
from tsa_ctrl.model.parameters import TendonSheath, check_consistent, load_tendon_sheath
from tsa_ctrl.model.plausible import (
    check_against_command,
    check_against_motor,
    check_motion,
    check_set_point,
)
from tsa_ctrl.model.steady_sliding import sliding
from tsa_ctrl.model.stretch import unsupported_reason
from tsa_ctrl.safety.limiter import LimiterSettings
from tsa_ctrl.safety.settings import OscillationSettings, PassivitySettings, PlausibilitySettings
from tsa_ctrl.safety.use_class import SafetySettings, drive_clamps, longest_fault, wearer_limits, with_torque
from tsa_ctrl.sensors import process as serial
from tsa_ctrl.sensors.process import SerialSensorSettings
from tsa_ctrl.system.realtime import RealtimeSettings
from tsa_ctrl.system.torque_off import MonitorSettings

LOWEST_RATE, HIGHEST_RATE = 10.0, 4000.0  # Hz, limits of [controller] rate
PEAK = 3.0  # of the rated torque, peak torque that a drive can sustain for seconds
MARGIN = 0.05  # s, added to the longest time-out: to detect a fault, command the drive and let its torque fall
Name = Annotated[str, Meta(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,31}$")]


class ControllerSection(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[controller]: settings of the whole loop."""

    name: Name = "rig"
    rate: Annotated[float, Meta(ge=LOWEST_RATE, le=HIGHEST_RATE)] = 1000.0  # Hz of SYNC
    collect: Annotated[float, Meta(gt=0.05, le=0.9)] = 0.6  # share of the period in which the loop waits for answers
    settle_cycles: Annotated[int, Meta(ge=1, le=100_000)] = 100  # consecutive complete cycles before any enable
    stop_time: Annotated[float, Meta(gt=0.0, le=5.0)] = 0.3  # s in which the torque ramps to 0 at a stop
    after_fault: Literal["wait", "exit"] = "wait"  # stay latched until `tsa set recover 1` or `tsa stop`, or exit


class LogSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[log]: the files to which every cycle of every axis is written."""

    enabled: bool = True
    folder: str = "logs"  # relative to the configuration file
    file_size: Annotated[float, Meta(ge=1.0, le=1e6)] = 500.0  # MB at which the next file starts; one hour of one axis
    file_age: Annotated[float, Meta(ge=60.0, le=1e7)] | None = None  # s after which the next file starts
    folder_size: Annotated[float, Meta(ge=10.0, le=1e9)] | None = None  # MB above which the oldest logs are deleted


class SocketSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[socket]: the local socket of `tsa status`, `tsa set` and `tsa stop`."""

    path: str = ""  # default: $XDG_RUNTIME_DIR/tsa.sock, else /tmp/tsa-UID/tsa.sock
    group: str | None = None  # group that may also use the socket; default: only the user who started the daemon
    watch_group: str | None = None  # group that may read status, measurements and events


class AxisSettings(AxisNodes, frozen=True, kw_only=True):
    """[[axis]]: the nodes of one axis and all settings of its control."""

    name: Name
    model: str  # actuator model file, relative to the configuration file
    limits: LimiterSettings
    setpoint: SetPointSettings = SetPointSettings()
    law: LawSettings = LawSettings()
    direction: DirectionSettings = DirectionSettings()
    estimator: EstimatorSettings = EstimatorSettings()
    bending: BendingSettings = BendingSettings()
    temperature: TemperatureSettings = TemperatureSettings()
    passivity: PassivitySettings = PassivitySettings()
    oscillation: OscillationSettings | None = None  # accepted from earlier versions, without effect
    plausibility: PlausibilitySettings = PlausibilitySettings()
    serial: tuple[SerialSensorSettings, ...] = ()  # sensors on serial lines: joint torque, tendon tensions, bending

    @property
    def has_torque_sensor(self) -> bool:
        """Return True if the joint torque is measured, on the bus or on a serial line."""
        return self.torque_sensor is not None or any(sensor.quantity == "tau_j" for sensor in self.serial)


class ControllerFile(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """The contents of a controller file."""

    controller: ControllerSection = ControllerSection()
    bus: BusSettings = BusSettings()  # the first bus; all buses have the same keys except `bus.drive.network.OWN`
    other_buses: tuple[BusSettings, ...] = msgspec.field(default=(), name="[[bus]]")  # see `_with_buses`
    realtime: RealtimeSettings = RealtimeSettings()
    log: LogSettings = LogSettings()
    socket: SocketSettings = SocketSettings()
    safety: SafetySettings = SafetySettings()
    monitor: MonitorSettings = MonitorSettings()
    axes: tuple[AxisSettings, ...] = msgspec.field(name="axis")

    @property
    def buses(self) -> tuple[BusSettings, ...]:
        """Return all buses, in the order of the file."""
        return (self.bus, *self.other_buses)

    @property
    def slowest_bus(self) -> BusSettings:
        """Return the bus with the lowest bit rate, which also has the settings that all buses have in common."""
        return min(self.buses, key=lambda bus: bus.bitrate)

    @property
    def channels(self) -> str:
        """Return the channels of all buses as text."""
        return ", ".join(bus.channel for bus in self.buses)

    def bus_of(self, axis: AxisNodes) -> BusSettings:
        """Return the bus of an axis."""
        return next(bus for bus in self.buses if axis.bus in (None, bus.name))


@dataclass(frozen=True)
class Configuration:
    """A checked configuration with the contents of the files that it names."""

    path: Path
    file: ControllerFile
    text: str
    models: tuple[TendonSheath, ...]  # one per axis
    profiles: tuple[DriveProfile, ...]  # one per axis
    loads: tuple[Load, ...]  # one per bus
    estimators: tuple[str, ...]  # one per axis: reason for not using the elongation estimator; empty if it is used

    @cached_property
    def plans(self) -> tuple[Plan, ...]:
        """Return the derived times and gains of each axis' law. Raise UsageError for a damping without gain margin."""
        return tuple(
            plan_for(f"{self.path}: axis '{axis.name}'", axis, model, self.file)
            for axis, model in zip(self.file.axes, self.models, strict=True)
        )

    @property
    def load(self) -> Load:
        """Return the load of the bus with the highest load."""
        return max(self.loads, key=lambda load: load.worst)

    @property
    def period(self) -> float:
        """Return the period of the loop, s."""
        return 1.0 / self.file.controller.rate

    @property
    def zero_torque_within(self) -> float:
        """Return the longest time from a fault, hang or failure of this computer until all torques are zero, s."""
        given = self.file.safety.zero_torque_within
        return given if given is not None else longest_fault(self.file.axes, self.file.controller.stop_time)[0] + MARGIN

    @property
    def monitored(self) -> bool:
        """Return True if a monitor is required."""
        enabled = self.file.monitor.enabled
        return self.file.safety.worn if enabled is None else enabled

    @property
    def folder(self) -> Path:
        return self.path.parent

    @property
    def log_folder(self) -> Path:
        return self.folder / self.file.log.folder


def load_configuration(path: str | Path) -> Configuration:
    """Read and check a controller file. Raise UsageError with a message of one line for any error in it."""
    path = path_of(path, "controller file", "its path, or the result of load_configuration")
    data = settings.read_toml(path)
    data, others = _with_buses(path, data)
    listed = data.get("axis", [])
    tables = [table for table in listed if isinstance(table, dict)] if isinstance(listed, list) else []
    _check_filled(path, data, tables)
    file = msgspec.structs.replace(settings.convert(data, ControllerFile, path), other_buses=others)
    if not file.axes:
        raise UsageError(f"{path}: no [[axis]]; give at least one")
    _check_unique(path, file)
    _check_safety(path, file)
    folder = path.parent
    models = tuple(load_tendon_sheath(folder / axis.model) for axis in file.axes)
    profiles = tuple(load_profile(axis.drive.profile, folder) for axis in file.axes)
    file = with_limits(path, file, data["axis"], models)
    file, estimators = with_estimators(file, models)
    for axis, model in zip(file.axes, models, strict=True):
        _check_axis(f"{path}: axis '{axis.name}'", axis, model, file)
        SetPoint(axis.setpoint, 1.0 / file.controller.rate, folder)
        check_set_point(model, largest(axis.setpoint, folder), axis.limits.torque, f"{path}: axis '{axis.name}'")
    try:
        file, loads = _within_budget(file)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None
    configuration = Configuration(path, file, path.read_text(encoding="utf-8"), models, profiles, loads, estimators)
    if file.other_buses and configuration.monitored:
        raise UsageError(
            f'{path}: [monitor] and class "worn" work with one [bus], the file has {len(file.buses)}; put all axes on '
            'one bus, or use class "bench" and [monitor] enabled = false'
        )
    assert len(configuration.plans) == len(file.axes)  # derives the plans now, which raises UsageError if one is wrong
    return configuration


def _with_buses(path: Path, data: dict[str, Any]) -> tuple[dict[str, Any], tuple[BusSettings, ...]]:
    """Return the file's tables with the first bus as [bus], and the settings of the other buses."""
    listed = data.get("bus")
    if not isinstance(listed, list):
        return data, ()
    tables = [table for table in listed if isinstance(table, dict)]
    if not tables or len(tables) < len(listed):
        raise UsageError(f"{path}: bus is a list without tables; write [bus], or several [[bus]] with names")
    rates = [table["rate"] for table in tables if "rate" in table]
    if rates:
        found = ", ".join(str(rate) for rate in rates)
        raise UsageError(
            f"{path}: [[bus]] rate {found}: one cycle runs over all buses at [controller] rate; remove rate, or give "
            "the axes of a bus with another rate a controller file and a daemon with another [socket] path"
        )
    places = [settings.named(f"bus[{index}]", data) for index in range(len(tables))]
    others = [
        settings.convert(table, BusSettings, f"{path}: {place}") for place, table in zip(places, tables, strict=True)
    ]
    return {**data, "bus": tables[0]}, tuple(others[1:])


def _within_budget(file: ControllerFile) -> tuple[ControllerFile, tuple[Load, ...]]:
    """Return the file with the torque sensors' `every`, and the load of each bus. Raise UsageError for a full bus."""
    rate = file.controller.rate
    fitted = {axis.name: axis for bus in file.buses for axis in budget.fitted(bus, axes_of(bus, file.axes), rate)}
    file = msgspec.structs.replace(file, axes=tuple(fitted[axis.name] for axis in file.axes))
    return file, tuple(budget.check(bus, axes_of(bus, file.axes), rate) for bus in file.buses)


def _check_filled(path: Path, data: dict[str, Any], axes: list[dict[str, Any]]) -> None:
    """Report every empty value of the file and its models in one message."""
    named = dict.fromkeys(path.parent / axis["model"] for axis in axes if isinstance(axis.get("model"), str))
    models = [(model, settings.read_toml(model), ActuatorFile) for model in named if model.is_file()]
    settings.check_filled([(path, data, ControllerFile), *models])


def with_limits(
    path: Path, file: ControllerFile, tables: list[dict[str, Any]], models: tuple[TendonSheath, ...]
) -> ControllerFile:
    """Return the file with complete limits and clamps.

    Args:
        path: controller file, for messages.
        file: controller file.
        tables: the [[axis]] tables as written, which show the keys that the file has.
        models: model of each axis.

    Raises:
        UsageError: Limits contradict each other or the drive's clamps.
    """
    axes = []
    for axis, table, model in zip(file.axes, tables, models, strict=True):
        geared = model.joint_pulley_radius / model.motor_pulley_radius
        try:
            speed = reversal_speed(model, axis.law.turn, 1.0 / file.controller.rate)
            limits = wearer_limits(with_torque(axis.limits, axis.drive), table["limits"], file.safety, geared, speed)
            drive = drive_clamps(axis.drive, table["drive"], limits)
        except ValueError as error:
            raise UsageError(f"{path}: axis '{axis.name}': {error}") from None
        axes.append(msgspec.structs.replace(axis, limits=limits, drive=drive))
    return msgspec.structs.replace(file, axes=tuple(axes))


def with_estimators(file: ControllerFile, models: tuple[TendonSheath, ...]) -> tuple[ControllerFile, tuple[str, ...]]:
    """Return the file with an estimator for each axis, and the reasons for not using the elongation estimator."""
    axes, notes = [], []
    for axis, model in zip(file.axes, models, strict=True):
        follows = axis.bending.source != "fixed"
        has_temperature = axis.temperature.source != "none"
        estimator, note = chosen(
            axis.estimator, model, axis.encoder is not None, axis.has_torque_sensor, follows, has_temperature
        )
        if routing_of(axis.bending, model.routing) is not None and axis.estimator.kind in (None, "fixed"):
            # The model file has a routing, which determines friction and pretension.
            estimator, note = msgspec.structs.replace(estimator, kind="map"), ""
        axes.append(msgspec.structs.replace(axis, estimator=estimator))
        notes.append(note)
    return msgspec.structs.replace(file, axes=tuple(axes)), tuple(notes)


def check_drives(configuration: Configuration) -> None:
    """Raise UsageError if a drive's EDS, if there is one, shows that its configuration cannot be written."""
    file = configuration.file
    try:
        for axis, profile in zip(file.axes, configuration.profiles, strict=True):
            scale = drive_scale(axis.drive, profile, f"axis '{axis.name}'")
            plan = drive_plan(axis, profile, scale, file.bus, configuration.period)
            check_plan(profile.eds, plan)
    except UsageError as error:
        raise UsageError(f"{configuration.path}: {error}") from None


def _check_safety(path: Path, file: ControllerFile) -> None:
    given = file.safety.zero_torque_within
    longest, why = longest_fault(file.axes, file.controller.stop_time)
    if given is not None and given <= longest:
        raise UsageError(
            f"{path}: [safety] zero_torque_within {given:g} s is not above {why}; lower that, or raise "
            "zero_torque_within"
        )


def _check_unique(path: Path, file: ControllerFile) -> None:
    """Raise UsageError if two axes have the same name, or share a node id that one device cannot use for both."""
    names = Counter(axis.name for axis in file.axes)
    for name, number in names.items():
        if number > 1:
            raise UsageError(f"{path}: {number} axes are named '{name}'; give each its own name")
    try:
        check_buses(file.buses, file.axes)
        check_node_ids(file.bus, file.axes)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None


def _check_axis(where: str, axis: AxisSettings, model: TendonSheath, file: ControllerFile) -> None:
    """Raise UsageError for contradictions between the sections of one axis, its model and the bus."""
    drive, period = axis.drive, 1.0 / file.controller.rate
    if drive.rpdo_timeout < 2.0 * period:
        raise UsageError(
            f"{where}: drive.rpdo_timeout {drive.rpdo_timeout:g} s is less than two periods of "
            f"{file.controller.rate:g} Hz; raise it"
        )
    most = max(PEAK * drive.rated_torque * drive.gear_ratio, axis.limits.torque)
    check_consistent(model)
    half_loop, rated = abs(sliding(model).motor_half_loop), drive.rated_torque * drive.gear_ratio
    check_against_motor(model, half_loop, most, axis.law.motor_inertia, where)
    check_against_command(model, half_loop, rated / PER_MILLE, axis.law.compensation > 0.0, where)
    limits, r_j = axis.limits, model.joint_pulley_radius
    check_motion(
        model,
        limits.travel,
        {
            "joint_speed": (limits.joint_speed, r_j),
            "over_speed": (limits.over_speed, r_j),
            "motor_over_speed": (limits.motor_over_speed, model.motor_pulley_radius),
        },
        where,
    )
    serial.check_all(axis.serial, where, {"tau_j"} if axis.torque_sensor is not None else set())
    estimator, bending, measured = axis.estimator, axis.bending, {sensor.quantity for sensor in axis.serial}
    if estimator.kind == "sensor" and not axis.has_torque_sensor:
        raise UsageError(
            f'{where}: estimator.kind "sensor" without [axis.torque_sensor] or a serial sensor of tau_j; give one, '
            "or another kind"
        )
    if axis.law.feedback > 0.0 and not axis.has_torque_sensor:
        raise UsageError(
            f"{where}: law.feedback {axis.law.feedback:g} Hz without [axis.torque_sensor] or a serial sensor of tau_j; "
            "give one, or law.feedback = 0"
        )
    if estimator.kind == "tension" and (reason := unsupported_by_tension(estimator.attribute, measured)):
        raise UsageError(f'{where}: estimator.kind "tension" {reason}')
    if estimator.kind == "stretch":
        _check_stretch(where, axis, model)
    if estimator.kind in ("sensor", "motor", "tension") and estimator.use:
        # Kind "tension" uses only the effects at the motor, and none of them depends on the temperature.
        reason = unsupported_by_sensor(model, axis.temperature.source != "none" or estimator.kind == "tension")
        if reason:
            raise UsageError(
                f'{where}: estimator.kind "{estimator.kind}" with use = true: {reason}, or write use = false'
            )
    if model.routing is not None:
        _check_routing(where, axis, model, file)
    routed = routing_of(bending, model.routing) is not None
    if (estimator.kind == "map") != (bending.source != "fixed" or routed):
        raise UsageError(
            f'{where}: estimator.kind "{estimator.kind}" with bending.source "{bending.source}"; '
            'kind "map" needs the source "command", "joints" or "sensor", and no other kind uses them'
        )
    if (axis.temperature.source == "serial") != ("temperature" in measured):
        raise UsageError(
            f'{where}: temperature.source "{axis.temperature.source}"; the source "serial" and an [[axis.serial]] of '
            "temperature belong together; give both or neither"
        )
    if (bending.source == "sensor") != ("theta" in measured):
        raise UsageError(
            f'{where}: bending.source "sensor" and an [[axis.serial]] of theta belong together; give both or neither'
        )
    if estimator.kind != "fixed" and model.bending_angle == 0.0:
        raise UsageError(
            f'{where}: estimator.kind "{estimator.kind}" with a model whose bending_angle is 0; use "fixed"'
        )
    if estimator.kind == "map" and "configuration_dependent_bending" in model.effects:
        raise UsageError(
            f'{where}: both estimator.kind "map" and the model\'s configuration_dependent_bending change the bending '
            "angle; keep one of them"
        )
    names = {other.name for other in file.axes}
    for name in bending.gains:
        if name not in names:
            raise UsageError(f"{where}: bending.gains names axis '{name}'; available: {', '.join(sorted(names))}")


def joint_ranges(axes: Iterable[AxisSettings]) -> dict[str, tuple[float, float]]:
    """Return the travel (rad) of each axis that has one, by name."""
    return {axis.name: axis.limits.travel for axis in axes if axis.limits.travel is not None}


def _check_routing(where: str, axis: AxisSettings, model: TendonSheath, file: ControllerFile) -> None:
    """Raise UsageError for wrong joints in `[routing]` of the model file, or wrong wrap angles within their travel."""
    routing, bending = model.routing, axis.bending
    assert routing is not None
    if bending.gains:
        raise UsageError(
            f"{where}: both [axis.bending] gains and [routing] of {model.source} say how joints bend the sheath; "
            "remove [axis.bending] gains and source"
        )
    for name in bending.unmeasured:
        if name not in routing.joints:
            raise UsageError(
                f"{where}: bending.unmeasured names joint '{name}'; [routing] of {model.source} has "
                f"{', '.join(routing.joints)}"
            )
    if axis.estimator.kind not in ("map", "fixed"):
        raise UsageError(
            f'{where}: estimator.kind "{axis.estimator.kind}" cannot follow the joints of [routing] in {model.source}; '
            'remove kind, or write "map"'
        )
    routing.check_joints([*(other.name for other in file.axes), *bending.unmeasured], f"{where}: {model.source}")
    ranges = {**joint_ranges(file.axes), **bending.unmeasured}
    routing.check_travel(model.bending_angle, ranges, f"{where}: {model.source}")


def _check_stretch(where: str, axis: AxisSettings, model: TendonSheath) -> None:
    """Raise UsageError unless the tendon elongation is measured and shows the joint torque."""
    if axis.encoder is None:
        raise UsageError(
            f'{where}: estimator.kind "stretch" without [axis.encoder]; the elongation is the difference of two '
            "angles; give one, or another kind"
        )
    reason = unsupported_reason(model)
    if reason:
        raise UsageError(f'{where}: estimator.kind "stretch": {reason}; or choose another kind')


def plan_for(where: str, axis: AxisSettings, model: TendonSheath, file: ControllerFile) -> Plan:
    """Return times and gains of an axis' law. Raise UsageError for a damping without gain margin."""
    law, drive, encoder, period = axis.law, axis.drive, axis.encoder, 1.0 / file.controller.rate
    return design_law(
        model,
        period=period,
        transport=period if file.bus.rpdo == "sync" else file.controller.collect * period,
        late=1.0 / (2.0 * math.pi * drive.velocity_cutoff) if drive.differentiates else 0.0,
        has_encoder=encoder is not None,
        limits=Limits.of(axis.limits, drive.max_speed, model, encoder is not None),
        delay=law.delay,
        turn=law.turn,
        lead=law.lead,
        inertia=law.motor_inertia,
        ringing=law.ringing,
        damping=law.damping,
        filtered=0.0 if encoder is None else 1.0 / (2.0 * math.pi * encoder.velocity_cutoff),
        where=where,
    )
