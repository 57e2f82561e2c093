"""Define the tables of an actuator model file, with the allowed range of each value."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from tsa_ctrl.model.routing import TURNS, RoutingSection

# The description of a range is part of the error: the unit, the reason for the range, and the likely mistake.
Radius = Annotated[
    float, Meta(ge=1e-3, le=0.5, description="m; pulleys of joints are 1 mm to 0.5 m; divide millimetres by 1000")
]
Stiffness = Annotated[float, Meta(gt=0.0, description="N; multiply kilonewtons by 1000")]
SeriesStiffness = Annotated[
    float,
    Meta(ge=1.0, le=1e9, description="N/m; omit it without a spring; multiply N/mm by 1000"),
]
Length = Annotated[
    float, Meta(ge=0.01, le=20.0, description="m; tendons are 10 mm to 20 m long; divide millimetres by 1000")
]
Diameter = Annotated[
    float,
    Meta(ge=2e-5, le=0.01, description="m; a tendon of 0.02 mm is one fibre, one of 10 mm a rope; divide mm by 1000"),
]
MOST_FRICTION = 0.8  # 1
Friction = Annotated[
    float,
    Meta(
        ge=0.0,
        le=MOST_FRICTION,
        description="1; dry steel on steel has 0.8; x is this times bending_angle",
    ),
]
Angle = Annotated[
    float, Meta(ge=0.0, le=TURNS, description="rad; a sheath is wound by three turns at most; degrees times 0.01745")
]
SignedAngle = Annotated[float, Meta(ge=-TURNS, le=TURNS, description="rad; degrees times 0.01745")]
Offset = Annotated[
    float,
    Meta(ge=0.0, le=0.02, description="m; the tendon lies inside its sheath, at most 20 mm wide; divide mm by 1000"),
]
LengthChange = Annotated[
    float, Meta(ge=0.0, le=0.5, description="m; travel of a tensioner; divide millimetres by 1000")
]
Pretension = Annotated[
    float, Meta(ge=0.0, le=20e3, description="N; 20 kN is the weight of 2 t; gram-force times 0.00981, kgf times 9.81")
]
Share = Annotated[float, Meta(ge=0.0, le=10.0, description="1, a factor minus 1; divide per cent by 100")]


class ActuatorSection(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define [actuator] of a tendon-sheath model file."""

    kind: Literal["tendon_sheath"] = "tendon_sheath"
    motor_pulley_radius: Radius  # r_M, m
    joint_pulley_radius: Radius  # r_J, m


# Limits of a drive, from the motor of a small joint to the largest that a log may contain
Inertia = Annotated[float, Meta(ge=0.0, le=1e3, description="kg*m^2; multiply g*cm^2 by 1e-7")]
Torque = Annotated[float, Meta(ge=0.0, le=500.0, description="N*m; divide N*mm by 1000")]
SignedTorque = Annotated[float, Meta(ge=-500.0, le=500.0, description="N*m; divide N*mm by 1000")]
Damping = Annotated[float, Meta(ge=0.0, le=1e3, description="N*m*s/rad; divide N*mm*s/rad by 1000")]
Ratio = Annotated[
    float, Meta(ge=0.01, le=1e4, description="motor turns per joint turn; gears of joints have up to some hundred")
]


class RigidDriveSection(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define [actuator] of a drive without joint torque sensor."""

    kind: Literal["rigid_drive"]
    inertia: Inertia | None = None  # J, kg*m^2
    coulomb_friction: Torque | None = None  # tau_c, N*m
    viscous_friction: Damping | None = None  # b, N*m*s/rad
    torque_offset: SignedTorque | None = None  # c, N*m


class GearedDriveSection(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define [actuator] of a drive with a gear and a joint torque sensor, without tendons."""

    kind: Literal["geared_drive"]
    ratio: Ratio  # N, motor turns per joint turn
    efficiency: Annotated[float, Meta(gt=0.0, le=1.0, description="1; divide per cent by 100")] | None = None  # eta
    coulomb_friction: Torque | None = None  # tau_c, N*m at the joint
    viscous_friction: Damping | None = None  # b, N*m*s/rad at the joint


class TendonSection(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define the table [tendon]."""

    axial_stiffness: Stiffness  # E A, N
    unstrained_length: Length  # l_us, m
    diameter: Diameter  # d, m
    series_stiffness: SeriesStiffness | None = None  # k_s, N/m, per tendon
    series_position: Literal["motor", "joint"] | None = None  # the end with the spring; default "motor"


class SheathSection(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define the table [sheath]."""

    friction_coefficient: Friction  # mu, 1
    bending_angle: Angle  # Theta, rad
    contact_offset: Offset = 0.0  # p, m
    unstrained_bending_angle: SignedAngle | None = None  # Theta_us, rad (3.51)
    bending_centre: Annotated[float, Meta(ge=0.0, le=1.0)] | None = None  # s_c, if no effect has a profile
    bending_course: tuple[tuple[float, float], ...] | None = None  # fractions (length, bending) about that centre


class PretensionSection(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define the table [pretension]."""

    value: Pretension | None = None  # T_p0, N, at tau_M = 0 and at bending_angle
    length_change: LengthChange | None = None  # Delta l of (3.56), m: the tensioner


class UncertaintySection(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define the table [uncertainty]: the largest errors of the nominal values."""

    friction_angle: Share = 0.25  # factor up or down, minus 1
    pretension: Share = 0.25
    axial_stiffness: Share = 0.1  # E A, series spring included
    bending_centre: Share = 0.05  # 1, absolute error of s_c, the centre of the bends along the sheath


class ActuatorFile(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define a model file of kind "tendon_sheath"."""

    actuator: ActuatorSection
    tendon: TendonSection
    sheath: SheathSection
    pretension: PretensionSection = PretensionSection()
    uncertainty: UncertaintySection = UncertaintySection()
    routing: RoutingSection | None = None  # joints that bend the sheaths; None: no joint does
    effects: dict[str, dict[str, Any]] = {}
    provenance: dict[str, Any] = {}


class RigidDriveFile(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define a model file of kind "rigid_drive"."""

    actuator: RigidDriveSection
    effects: dict[str, dict[str, Any]] = {}
    provenance: dict[str, Any] = {}


class GearedDriveFile(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define a model file of kind "geared_drive"."""

    actuator: GearedDriveSection
    effects: dict[str, dict[str, Any]] = {}
    provenance: dict[str, Any] = {}
