"""List the unmet requirements for wearing the joint, and the safety bounds that are looser than shipped.

`verify-safety.toml` next to the controller file records the results of `tsa verify-safety` on this rig. They are valid
for one configuration (by hash) and for the nodes of the trials (by serial number).
"""

from __future__ import annotations

import hashlib
import json
import math
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path

import msgspec
import tomlkit

from tsa_ctrl import settings
from tsa_ctrl.bus.canopen import objects
from tsa_ctrl.config import MARGIN, AxisSettings, Configuration
from tsa_ctrl.control.law_design import reversal_speed
from tsa_ctrl.errors import UsageError, rounded_down
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.provenance import NODES, NodeIdentity
from tsa_ctrl.safety.bounds import SMALLER, WORN_FACTOR, Loose, Shipped, loose_bounds
from tsa_ctrl.safety.plausibility import DEFAULT_JOINT_TORQUE, DEFAULT_TORQUE
from tsa_ctrl.safety.use_class import longest_fault, wearer_speeds

RECORD = "verify-safety.toml"  # next to the controller file
GAIT_SPEED = 7.0  # rad/s, fastest motion of a knee in level walking (400 degrees per second); hip 4, ankle 5
STRONG_TORQUE = 50.0  # N*m at the joint: exoskeletons for walking deliver up to this torque at hip and knee
HALF_TURN = math.pi  # rad; no human joint rotates that far, so a larger travel is probably in degrees
# Sections that may change without another `tsa verify-safety`. Its trials run without friction compensation and with
# their own set-point, log and socket, and their results are valid in both classes of use.
_FREE = frozenset({"log", "socket", "realtime", "monitor"})
_FREE_OF_AXIS = frozenset({"model", "setpoint", "law", "direction", "estimator", "bending", "oscillation"})

Nodes = Mapping[str, Mapping[str, NodeIdentity]]  # by axis and by `NODES`


class SignAndGain(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """The result of the test on the locked joint of one axis."""

    date: str  # ISO 8601
    gain: float  # 1, measured torque over the torque of the model
    sensor: str  # sensor that measured the torque


class SafetyRecord(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """The contents of `verify-safety.toml`."""

    configuration: str  # `fingerprint`
    nodes: dict[str, dict[str, NodeIdentity]]  # by axis and by `NODES`
    watchdogs: str = ""  # ISO 8601, date at which the trials of the watchdogs passed
    held: dict[str, SignAndGain] = {}  # tests on the locked joint by axis


def fingerprint(configuration: Configuration) -> str:
    """Return the SHA-256 of all settings on which the trials of `tsa verify-safety` depend."""
    data = {key: value for key, value in msgspec.to_builtins(configuration.file).items() if key not in _FREE}
    data["safety"].pop("class")
    for key in ("name", "after_fault"):
        data["controller"].pop(key)
    data["axis"] = [
        {key: value for key, value in axis.items() if key not in _FREE_OF_AXIS}
        | {"radii": [model.motor_pulley_radius, model.joint_pulley_radius], "profile": msgspec.to_builtins(profile)}
        for axis, model, profile in zip(data["axis"], configuration.models, configuration.profiles, strict=True)
    ]
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


def read_record(configuration: Configuration) -> SafetyRecord | None:
    """Return the record, or None if the file does not exist.

    Raises:
        UsageError: The file is damaged.
    """
    path = configuration.folder / RECORD
    return settings.load(path, SafetyRecord) if path.exists() else None


def add_to_record(
    configuration: Configuration, nodes: Nodes, watchdogs: str = "", held: Mapping[str, SignAndGain] | None = None
) -> Path:
    """Add passed results to the record, and drop the results of another configuration or of other nodes.

    Args:
        configuration: configuration that passed.
        nodes: nodes of the trials.
        watchdogs: date at which the trials of the watchdogs passed, ISO 8601.
        held: results of the test on the locked joint, by axis.

    Raises:
        UsageError: The file cannot be written.
    """
    known = {axis: dict(found) for axis, found in nodes.items()}
    before = read_record(configuration)
    if before is None or before.configuration != fingerprint(configuration) or before.nodes != known:
        before = SafetyRecord(configuration=fingerprint(configuration), nodes=known)
    after = msgspec.structs.replace(
        before, watchdogs=watchdogs or before.watchdogs, held=before.held | dict(held or {})
    )
    path = configuration.folder / RECORD
    head = "# Written by tsa verify-safety. Any change of the configuration that matters invalidates it.\n"
    settings.write_text(path, head + tomlkit.dumps(msgspec.to_builtins(after)))
    return path


def missing(configuration: Configuration) -> list[str]:
    """Return the requirements of class "worn" that the files do not meet, each with its remedy.

    The list is empty in class "bench".
    """
    if not configuration.file.safety.worn:
        return []
    found = []
    if configuration.file.safety.wearer_speed is None:
        found.append("the wearer's speed (give [safety] wearer_speed)")
    if not configuration.monitored:
        found.append("the monitor (remove [monitor] enabled = false)")
    for axis, model in zip(configuration.file.axes, configuration.models, strict=True):
        found += [f"axis '{axis.name}': {lacking}" for lacking in _lacking(configuration, axis, model)]
    found += [
        f'{_of(axis)}{bound}: class "worn" allows {_most(bound)} (change it)'
        for axis, bound in loose(configuration)
        if bound.unfit_to_wear
    ]
    return [*found, *_not_shown(configuration)]


def _lacking(configuration: Configuration, axis: AxisSettings, model: TendonSheath) -> Iterator[str]:
    safety, limits = configuration.file.safety, axis.limits
    measured = {sensor.quantity for sensor in axis.serial}
    if axis.torque_sensor is None and "tau_j" not in measured and not {"t1", "t3"} <= measured:
        yield "a joint torque sensor or both load cells (add [axis.torque_sensor], or [[axis.serial]] tau_j, or t1, t3)"
    if limits.travel is None:
        yield "the travel (give [axis.limits] travel, or [safety] travel)"
    elif len(configuration.file.axes) > 1 and not _has_travel(configuration, axis.name):
        yield "its own travel, because the file has several axes (give [axis.limits] travel)"
    if safety.wearer_speed is not None:
        geared = model.joint_pulley_radius / model.motor_pulley_radius
        derived = wearer_speeds(safety.wearer_speed, geared, reversal_speed(model, axis.law.turn, configuration.period))
        for key, most in derived.items():
            if getattr(limits, key) > most * (1.0 + 1e-9):
                yield (
                    f"limits.{key} {getattr(limits, key):g} rad/s is above {rounded_down(most, 4)} rad/s, which "
                    "follows from wearer_speed (leave it out, or lower it)"
                )
    if axis.drive.pdo == "lean":
        yield 'the comparison of 0x606C with 0x6064 (remove pdo = "lean"; lower the rate if the bit rate then needs it)'
    wanted = [name for name in NODES if name == "drive" or axis.encoder is not None]
    absent = [name for name in wanted if name not in model.origin.nodes]
    if absent:
        yield f"the serial number of its {' and '.join(absent)} in {axis.model} (tsa tune on this joint writes it)"


def _has_travel(configuration: Configuration, name: str) -> bool:
    """Return True if the file has a separate travel for the axis."""
    tables = {table["name"]: table for table in tomllib.loads(configuration.text)["axis"]}
    return "travel" in tables[name]["limits"]


def _not_shown(configuration: Configuration) -> Iterator[str]:
    """Yield the trials of this configuration that are missing in the record."""
    record = read_record(configuration)
    where = f"{configuration.folder / RECORD}"
    if record is not None and record.configuration != fingerprint(configuration):
        yield f"a record for this configuration: {where} is for another one (tsa verify-safety, and with --held)"
        return
    if record is None or not record.watchdogs:
        yield f"a passed tsa verify-safety in {where} (run it, joint free)"
    for axis in configuration.file.axes:
        if record is None or axis.name not in record.held:
            yield f"axis '{axis.name}': a test of sign and gain in {where} (run tsa verify-safety --held, joint held)"


def missing_on_bus(configuration: Configuration, nodes: Nodes, has_inputs: bool) -> list[str]:
    """Return the requirements that the nodes on the bus do not meet, each with its remedy.

    Args:
        configuration: configuration of the run.
        nodes: nodes that a bring-up found.
        has_inputs: True if a drive has digital inputs (0x60FD).
    """
    safety, found = configuration.file.safety, []
    if safety.emergency_stop is not None and not has_inputs:
        found.append(
            f"the emergency stop: no drive has {objects.DIGITAL_INPUTS} (leave [safety] emergency_stop out, and wire "
            "the stop to the drive's safe-torque-off input)"
        )
    if not safety.worn:
        return found
    if safety.emergency_stop is None and has_inputs:
        found.append(
            f"the emergency stop: a drive has {objects.DIGITAL_INPUTS} (give its bit as [safety] emergency_stop)"
        )
    record = read_record(configuration)
    for axis, each in nodes.items():
        for name, node in each.items():
            tested = None if record is None else record.nodes.get(axis, {}).get(name)
            difference = "the record has no such node" if tested is None else tested.difference(node)
            if difference:
                found.append(
                    f"axis '{axis}': {RECORD} is of another {name}: {difference} (run tsa verify-safety again)"
                )
    return found


def require(configuration: Configuration, lacking: list[str]) -> None:
    """Raise UsageError with all unmet requirements in one line, if there are any."""
    if lacking:
        of_class = f'[safety] class = "{configuration.file.safety.use_class}"'
        raise UsageError(f"{configuration.path}: {of_class} lacks {len(lacking)}: {'; '.join(lacking)}")


def loose(configuration: Configuration) -> Iterator[tuple[str, Loose]]:
    """Yield each bound that is looser than shipped with the name of its axis, which is empty for the whole file."""
    file = configuration.file
    whole: dict[str, msgspec.Struct | None] = {
        "controller": file.controller,
        "realtime": file.realtime,
        "bus": file.bus,
        "bus.supervision": file.bus.supervision,
        "safety": file.safety,
    }
    for found in loose_bounds(
        whole, {("safety", "zero_torque_within"): longest_fault(file.axes, file.controller.stop_time)[0] + MARGIN}
    ):
        yield "", found
    for axis, model in zip(file.axes, configuration.models, strict=True):
        sections: dict[str, msgspec.Struct | None] = {
            "axis.drive": axis.drive,
            "axis.encoder": axis.encoder,
            "axis.torque_sensor": axis.torque_sensor,
            "axis.setpoint": axis.setpoint,
            "axis.direction": axis.direction,
            "axis.law": axis.law,
            "axis.estimator": axis.estimator if axis.estimator.use or axis.estimator.kind == "map" else None,
            "axis.limits": axis.limits,
            "axis.plausibility": axis.plausibility,
            "axis.passivity": axis.passivity,
        }
        for found in loose_bounds(sections, _shipped(configuration, axis, model)):
            yield axis.name, found
        for sensor in axis.serial:
            for found in loose_bounds({"axis.serial": sensor}, {}):
                yield axis.name, found


def loose_lines(configuration: Configuration) -> list[str]:
    """Return a line for each bound that is looser than shipped, for startup and `tsa status`."""
    lines = [f"looser than shipped: {_of(axis)}{found}" for axis, found in loose(configuration)]
    lines += [
        f"axis '{axis.name}': the drive has no {objects.MAX_MOTOR_SPEED} (by its profile): the controller alone "
        "limits the speed of the motor"
        for axis, profile in zip(configuration.file.axes, configuration.profiles, strict=True)
        if not profile.has(objects.MAX_MOTOR_SPEED)
    ]
    return lines


def _of(axis: str) -> str:
    return f"axis '{axis}': " if axis else ""


def _most(bound: Loose) -> str:
    if bound.unit == "":
        return "only the shipped value"
    if math.isnan(bound.shipped):
        return "only what follows from the model"
    unit = "" if bound.unit == "1" else f" {bound.unit}"
    if bound.key in SMALLER:
        return f"{bound.shipped / WORN_FACTOR:.4g}{unit} at least"
    return f"{WORN_FACTOR * bound.shipped:.4g}{unit} at most"


def _shipped(configuration: Configuration, axis: AxisSettings, model: TendonSheath) -> Shipped:
    """Return the defaults that follow from other settings. In class "worn" the speeds fit a walking wearer."""
    geared = model.joint_pulley_radius / model.motor_pulley_radius
    shipped = {
        ("axis.limits", "torque"): STRONG_TORQUE / geared,
        ("axis.limits", "travel"): HALF_TURN,
        ("axis.plausibility", "torque"): DEFAULT_TORQUE * axis.limits.torque,
        ("axis.plausibility", "joint_torque"): DEFAULT_JOINT_TORQUE * axis.limits.torque * geared,
    }
    if configuration.file.safety.worn:
        speeds = wearer_speeds(GAIT_SPEED, geared, reversal_speed(model, axis.law.turn, configuration.period))
        shipped |= {("axis.limits", key): value for key, value in speeds.items()}
    return shipped
