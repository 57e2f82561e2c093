"""The list of safety bounds that are looser than shipped, of a whole configuration."""

from __future__ import annotations

import math
from collections.abc import Iterator

import msgspec

from tsa_ctrl.config import MARGIN, AxisSettings, Configuration, longest_fault
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.safety.bounds import Loose, Shipped, loose_bounds
from tsa_ctrl.safety.plausibility import DEFAULT_JOINT_TORQUE, DEFAULT_TORQUE
from tsa_ctrl.safety.use_class import wearer_speeds

GAIT_SPEED = 7.0  # rad/s, fastest motion of a knee in level walking (400 degrees per second); hip 4, ankle 5
STRONG_TORQUE = 50.0  # N*m at the joint: exoskeletons for walking give up to that at hip and knee
FULL_TURN = 2.0 * math.pi  # rad; no joint of a person turns that far, so that a larger travel is in degrees


def loose(configuration: Configuration) -> Iterator[tuple[str, Loose]]:
    """Yield the axis (empty for the whole file) and each bound that is looser than shipped."""
    file = configuration.file
    whole: dict[str, msgspec.Struct | None] = {
        "controller": file.controller,
        "realtime": file.realtime,
        "bus.supervision": file.bus.supervision,
        "safety": file.safety,
    }
    for found in loose_bounds(whole, {("safety", "zero_torque_within"): longest_fault(file)[0] + MARGIN}):
        yield "", found
    for axis, model in zip(file.axes, configuration.models, strict=True):
        sections: dict[str, msgspec.Struct | None] = {
            "axis.drive": axis.drive,
            "axis.encoder": axis.encoder,
            "axis.torque_sensor": axis.torque_sensor,
            "axis.setpoint": axis.setpoint,
            "axis.law": axis.law,
            "axis.limits": axis.limits,
            "axis.plausibility": axis.plausibility,
            "axis.passivity": axis.passivity,
        }
        for found in loose_bounds(sections, _shipped(axis, model, file.safety.worn)):
            yield axis.name, found


def loose_lines(configuration: Configuration) -> list[str]:
    """Return a line for each bound that is looser than shipped, for startup and `tsa status`."""
    return [f"looser than shipped: {_of(axis)}{found}" for axis, found in loose(configuration)]


def _of(axis: str) -> str:
    return f"axis '{axis}': " if axis else ""


def _shipped(axis: AxisSettings, model: TendonSheath, worn: bool) -> Shipped:
    """Return the defaults that follow from other settings; in class "worn" the speeds are those of a walking wearer."""
    geared = model.joint_pulley_radius / model.motor_pulley_radius
    shipped = {
        ("axis.limits", "torque"): STRONG_TORQUE / geared,
        ("axis.limits", "travel"): FULL_TURN,
        ("axis.plausibility", "torque"): DEFAULT_TORQUE * axis.limits.torque,
        ("axis.plausibility", "joint_torque"): DEFAULT_JOINT_TORQUE * axis.limits.torque * geared,
    }
    if worn:
        shipped |= {("axis.limits", key): value for key, value in wearer_speeds(GAIT_SPEED, geared, 0.0).items()}
    return shipped
