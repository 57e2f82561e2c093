"""The tables of an actuator model file, as a person writes them, with the allowed range of each value."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

Positive = Annotated[float, Meta(gt=0.0)]
NonNegative = Annotated[float, Meta(ge=0.0)]
Radius = Annotated[float, Meta(gt=0.0, le=1.0)]  # m; larger is a wrong unit
Length = Annotated[float, Meta(gt=0.0, le=100.0)]  # m
Angle = Annotated[float, Meta(ge=0.0, le=100.0)]  # rad; larger is in degrees


class ActuatorSection(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[actuator] of a tendon-sheath model file."""

    kind: Literal["tendon_sheath"] = "tendon_sheath"
    motor_pulley_radius: Radius  # r_M, m
    joint_pulley_radius: Radius  # r_J, m


class RigidDriveSection(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[actuator] of a drive without joint torque sensor."""

    kind: Literal["rigid_drive"]
    inertia: NonNegative | None = None  # J, kg*m^2
    coulomb_friction: NonNegative | None = None  # tau_c, N*m
    viscous_friction: NonNegative | None = None  # b, N*m*s/rad
    torque_offset: float | None = None  # c, N*m


class TendonSection(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[tendon]."""

    axial_stiffness: Positive  # E A, N
    unstrained_length: Length  # l_us, m
    diameter: Annotated[float, Meta(gt=0.0, le=0.1)]  # d, m
    series_stiffness: Positive | None = None  # k_s, N/m, per tendon
    series_position: Literal["motor", "joint"] | None = None  # the end at which it stands; "motor"


class SheathSection(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[sheath]."""

    friction_coefficient: Annotated[float, Meta(ge=0.0, le=5.0)]  # mu, 1
    bending_angle: Angle  # Theta, rad
    contact_offset: Annotated[float, Meta(ge=0.0, le=0.1)] = 0.0  # p, m
    unstrained_bending_angle: float | None = None  # Theta_us, rad (3.51)
    bending_centre: Annotated[float, Meta(gt=0.0, lt=1.0)] | None = None  # s_c, where no effect gives the whole course
    bending_course: tuple[tuple[float, float], ...] | None = None  # (of the length, of the bending) about that centre


class PretensionSection(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[pretension]."""

    value: NonNegative | None = None  # T_p0, N, at tau_M = 0 and at bending_angle
    length_change: Annotated[float, Meta(ge=0.0, le=1.0)] | None = None  # Delta l of (3.56), m: the tensioner


class UncertaintySection(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[uncertainty]: how far the nominal values may be off."""

    friction_angle: NonNegative = 0.25  # factor either way, minus 1
    pretension: NonNegative = 0.25
    axial_stiffness: NonNegative = 0.1  # E A, series spring included
    bending_centre: NonNegative = 0.05  # 1, absolute: s_c, where along the sheath the bends are


class ActuatorFile(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A model file of kind "tendon_sheath", as it is written."""

    actuator: ActuatorSection
    tendon: TendonSection
    sheath: SheathSection
    pretension: PretensionSection = PretensionSection()
    uncertainty: UncertaintySection = UncertaintySection()
    effects: dict[str, dict[str, Any]] = {}
    provenance: dict[str, Any] = {}


class RigidDriveFile(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A model file of kind "rigid_drive", as it is written."""

    actuator: RigidDriveSection
    effects: dict[str, dict[str, Any]] = {}
    provenance: dict[str, Any] = {}
