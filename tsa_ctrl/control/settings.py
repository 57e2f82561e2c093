"""Define the settings of an axis's control law, as read from [axis] of the controller file.

They are separate from the classes that use them, because mypyc, which compiles those classes, ignores `frozen` and
`forbid_unknown_fields` of a `msgspec.Struct`.
"""

from __future__ import annotations

from enum import Enum
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

MOST_TORQUE = 1000.0  # N*m; a larger value is in another unit
Torque = Annotated[float, Meta(ge=-MOST_TORQUE, le=MOST_TORQUE)]  # N*m
Frequency = Annotated[float, Meta(gt=0.0, le=200.0)]  # Hz
Seconds = Annotated[float, Meta(gt=0.0, le=86_400.0)]
Memory = Annotated[float, Meta(gt=0.0, le=3600.0)]
Time = Annotated[float, Meta(gt=0.0, le=0.2)]  # s
Angle = Annotated[float, Meta(ge=0.0, le=100.0)]  # rad; a larger value is in degrees


class Component(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define one sine of a multi-sine."""

    amplitude: Torque  # N*m
    frequency: Frequency  # Hz
    phase: Annotated[float, Meta(ge=-7.0, le=7.0)] = 0.0  # rad


class SetPointSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define the table [axis.setpoint]."""

    kind: Literal["constant", "sine", "multi_sine", "chirp", "step", "file", "socket"] = "constant"
    offset: Torque = 0.0  # N*m, added to every kind
    amplitude: Torque = 0.0  # N*m: of sine, chirp and step
    frequency: Frequency = 0.5  # Hz: of a sine, or at the start of a chirp
    end_frequency: Frequency = 5.0  # Hz: at the end of a chirp
    duration: Seconds = 20.0  # s: of one chirp, which is repeated
    at: Annotated[float, Meta(ge=0.0, le=86_400.0)] = 1.0  # s: time of a step
    components: tuple[Component, ...] = ()  # of multi_sine
    file: str = ""  # CSV or Parquet with columns t (s) and tau_j_des (N*m), relative to the configuration file
    loop: bool = False  # start the file again at its end; otherwise the set-point goes to 0
    timeout: Annotated[float, Meta(gt=0.0, le=60.0)] = 0.2  # s: a socket set-point older than this goes to 0
    rate: Annotated[float, Meta(gt=0.0, le=10_000.0)] = 50.0  # N*m/s: fastest change of the set-point

    def __post_init__(self) -> None:
        if (self.kind == "file") != bool(self.file):
            raise ValueError(f'kind "{self.kind}" with file "{self.file}"; give both kind "file" and a file')
        if (self.kind == "multi_sine") != bool(self.components):
            raise ValueError(
                f'kind "{self.kind}" with {len(self.components)} components; '
                'components belong to kind "multi_sine", which needs at least one'
            )


class DirectionSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define the table [axis.direction]."""

    zone: Annotated[float, Meta(gt=0.0, le=100.0)] = 0.005  # joint speed that counts as 0, rad/s; more for few counts
    play: Annotated[float, Meta(gt=0.0, le=1e-3)] = 1e-6  # m of tendon by which the desired torque must reverse


class LawSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define [axis.law]; missing keys follow from the model file, the bus and the motor inertia, see `law_design`."""

    compensation: Annotated[float, Meta(ge=0.0, le=1.2)] = 0.95  # 1, share of the friction term
    fade_in: Annotated[float, Meta(ge=0.0, le=60.0)] = 1.0  # s after every enable
    slew: Annotated[float, Meta(gt=0.0, le=10_000.0)] = 10_000.0  # N*m/s, rate limit of the friction term at the motor
    settle: Annotated[float, Meta(ge=0.0, le=0.5)] = 0.03  # 1, share of the term that is removed at rest
    motor_inertia: Annotated[float, Meta(gt=0.0, le=1.0)] | None = None  # kg*m^2 at the motor pulley
    delay: Time | None = None  # s from a measurement to the acting torque
    turn: Time | None = None  # s, duration of a friction reversal
    lead: Annotated[float, Meta(ge=0.0, le=0.03)] | None = None  # s by which the joint velocity is extrapolated
    ringing: Annotated[float, Meta(gt=0.0, le=2000.0)] | None = None  # Hz of the motor on its tendons
    damping: Annotated[float, Meta(ge=0.0, le=100.0)] | None = None  # N*m*s/rad, of that ringing
    feedback: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.0  # Hz, bandwidth of the torque sensor's correction; 0: none


class BendingSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define the table [axis.bending]."""

    source: Literal["fixed", "command", "joints", "sensor"] = "fixed"
    offset: Angle | None = None  # rad, Theta with all joints at 0; default: the model file's bending_angle
    gains: dict[str, Annotated[float, Meta(ge=-10.0, le=10.0)]] = {}  # rad/rad by axis name
    range: Annotated[float, Meta(ge=0.0, le=0.9)] = 0.0  # 1, largest unmeasured change of the bending, up or down
    unmeasured: dict[str, tuple[float, float]] = {}  # rad, range of each joint of [routing] that no axis measures

    def __post_init__(self) -> None:
        if (self.source == "joints") != bool(self.gains):
            raise ValueError(
                f'source "{self.source}" with {len(self.gains)} gains; '
                'gains (rad/rad by axis name) belong to source "joints", which needs at least one'
            )
        if self.source in ("fixed", "sensor") and self.offset is not None:
            whence = "the model file" if self.source == "fixed" else "its sensor"
            raise ValueError(f'source "{self.source}" takes the angle from {whence}; remove offset, or change source')
        for name, (low, high) in self.unmeasured.items():
            if not low < high:
                raise ValueError(f"unmeasured.{name} = [{low:g}, {high:g}]; give [lowest, highest] rad of the joint")


class TemperatureSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define the table [axis.temperature]."""

    source: Literal["none", "serial"] = "none"  # "serial": [[axis.serial]] of the quantity "temperature"


class Attribution(Enum):
    """List the causes to which a change of the friction torque can be attributed.

    FRICTION: the friction coefficient; T_p is constant. PRETENSION: the tensioner; x is constant. BENDING: the bending
    angle; x = mu Theta and T_p = T_p0 + k_t (p + d/2)(Theta - Theta_0) change together, (3.52), (3.56).
    """

    FRICTION = "friction"
    PRETENSION = "pretension"
    BENDING = "bending"


class EstimatorSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define the table [axis.estimator]."""

    # None: "sensor" or "stretch" if the sensors and the model permit it, otherwise "fixed" (`estimator_selection`)
    kind: Literal["fixed", "map", "sensor", "motor", "stretch", "tension"] | None = None
    # True if the law uses the estimate, which is logged in any case ("map" is always used). None: True only if `kind`
    # is None as well.
    use: bool | None = None
    attribute: Attribution = Attribution.BENDING  # quantity that changes: "friction", "pretension", "bending"
    # 1, largest factor of that quantity up or down, minus 1. Kind "map": largest additional bending over that of the
    # model file.
    bounds: Annotated[float, Meta(gt=0.0, le=3.0)] = 0.6
    # 1/s of nominal: fastest change of either parameter (kind "stretch": rise; "map": after a jump)
    rate: Annotated[float, Meta(gt=0.0, le=10.0)] = 0.2
    memory: Memory = 4.0  # s of admitted motion after which old data have little weight
    least_speed: Annotated[float, Meta(gt=0.0, le=100.0)] = 0.1  # rad/s of the joint; slower motion is not admitted
    settle: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.05  # s after a reversal, whose data are not admitted
    residual: Annotated[float, Meta(gt=0.0, le=1000.0)] = 0.2  # N*m RMS of the fit above which it is invalid
    known_load: Annotated[float, Meta(ge=-1000.0, le=1000.0)] = 0.0  # N*m at the joint, kind "motor"; 0: unloaded
    most_acceleration: Annotated[float, Meta(gt=0.0, le=1e6)] = 10.0  # rad/s^2, kind "motor": not admitted above
