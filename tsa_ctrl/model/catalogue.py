"""The catalogue of effects as data: one name each, parameters with unit and bounds, order of composition.

Source: the catalogue of effects by which measured data differ from (3.55)-(3.56). What an effect computes stands in
`tsa_ctrl.model.effects`; this table is what model files, reports and the diagnosis agree on.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType
from typing import Any

from tsa_ctrl.errors import UsageError

Value = float | int | str


class Stage(Enum):
    """Where an effect enters; the order of the members is the order of composition."""

    VELOCITY = "measured velocity"
    MOTOR_TORQUE = "motor torque"
    PRETENSION = "bending angle and pretension"
    FRICTION = "friction coefficient"
    DIRECTION = "direction"
    TRANSMISSION = "transmission"
    LOAD = "load-dependent friction"
    BACKLASH = "backlash"
    JOINT = "joint side"
    DELAY = "delay of the measurement"


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect: `default` None means required, unless `optional`."""

    name: str
    unit: str
    low: float = -math.inf
    high: float = math.inf
    low_open: bool = False
    high_open: bool = False
    default: Value | None = None
    optional: bool = False  # may be absent: its default depends on the model or the log
    choices: tuple[str, ...] = ()
    integer: bool = False
    fitted: bool = True  # False: given, never estimated from a log

    def describe(self) -> str:
        """Allowed values in words, for error messages."""
        if self.choices:
            return " or ".join(f'"{choice}"' for choice in self.choices)
        kind = "a whole number" if self.integer else "a number"
        bounds = []
        if self.low > -math.inf:
            bounds.append(f"{'above' if self.low_open else 'at least'} {self.low:g}")
        if self.high < math.inf:
            bounds.append(f"{'below' if self.high_open else 'at most'} {self.high:g}")
        return " ".join([kind, " and ".join(bounds)]).strip() + (f" ({self.unit})" if self.unit != "1" else "")

    def accepts(self, value: object) -> bool:
        if self.choices:
            return isinstance(value, str) and value in self.choices
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            return False
        if self.integer and value != int(value):
            return False
        above = value > self.low if self.low_open else value >= self.low
        below = value < self.high if self.high_open else value <= self.high
        return above and below


@dataclass(frozen=True)
class EffectSpec:
    """One effect: its name, stage and parameters, and the log columns without which it cannot be computed.

    `columns` is a tuple of alternatives lists: each entry is a tuple of names of which one must be there.
    """

    name: str
    stage: Stage
    summary: str
    parameters: tuple[Parameter, ...] = ()
    columns: tuple[tuple[str, ...], ...] = ()
    memory: bool = False
    excludes: tuple[str, ...] = field(default=())
    rigid_drive: bool = True  # has a meaning for a plain drive (kind = "rigid_drive")

    def parameter(self, name: str) -> Parameter:
        return next(p for p in self.parameters if p.name == name)


def _non_negative(name: str, unit: str, **more: Any) -> Parameter:
    return Parameter(name, unit, low=0.0, **more)


def _positive(name: str, unit: str, **more: Any) -> Parameter:
    return Parameter(name, unit, low=0.0, low_open=True, **more)


_Q = (("q_j",),)

_SPECS = (
    EffectSpec(
        "velocity_lag",
        Stage.VELOCITY,
        "the measured velocity lags behind the true one",
        (_non_negative("time_constant", "s"),),
        (("omega_j",),),
    ),
    EffectSpec(
        "torque_constant_error",
        Stage.MOTOR_TORQUE,
        "the drive's torque has a wrong scale",
        (Parameter("relative_error", "1", low=-0.5, high=0.5),),
    ),
    EffectSpec(
        "torque_ripple",
        Stage.MOTOR_TORQUE,
        "cogging or torque ripple of the motor",
        (
            _non_negative("amplitude", "N*m"),
            Parameter("cycles_per_revolution", "1", low=1, integer=True),
            Parameter("phase", "rad", low=-math.pi, high=math.pi, default=0.0),
        ),
        (("q_m",),),
    ),
    EffectSpec(
        "motor_side_friction",
        Stage.MOTOR_TORQUE,
        "Coulomb friction in the motor and its gear",
        (_non_negative("coulomb", "N*m"),),
        rigid_drive=False,
    ),
    EffectSpec(
        "configuration_dependent_bending",
        Stage.PRETENSION,
        "the sheath's bending follows the joint angle",
        (Parameter("bending_per_joint_angle", "rad/rad"),),
        _Q,
        rigid_drive=False,
    ),
    EffectSpec(
        "stiffness_nonlinearity",
        Stage.PRETENSION,
        "the tendon stiffens with tension",
        (Parameter("quadratic", "1"),),
        rigid_drive=False,
    ),
    EffectSpec(
        "pretension_relaxation",
        Stage.PRETENSION,
        "the pretension creeps away with time",
        (
            _non_negative("relaxed_fraction", "1", high=1.0, high_open=True),
            _positive("time_constant", "s"),
            Parameter("law", "1", default="exponential", choices=("exponential", "logarithmic"), fitted=False),
            Parameter("start_time", "s", optional=True, fitted=False),
        ),
        rigid_drive=False,
    ),
    EffectSpec(
        "stribeck_friction",
        Stage.FRICTION,
        "friction falls with speed at low speed",
        (
            _non_negative("static_excess", "1"),
            _positive("stribeck_velocity", "rad/s"),
            Parameter("shape", "1", low=0.5, high=2.0, default=2.0),
        ),
    ),
    EffectSpec(
        "thermal_friction_drift",
        Stage.FRICTION,
        "friction follows the temperature",
        (
            Parameter("temperature_coefficient", "1/K"),
            Parameter("reference_temperature", "°C", default=25.0, fitted=False),
        ),
        (("temperature",),),
    ),
    EffectSpec(
        "tension_dependent_friction",
        Stage.FRICTION,
        "the friction coefficient falls as tension grows",
        (
            _non_negative("exponent", "1", high=1.0),
            _positive("reference_tension", "N", optional=True, fitted=False),
        ),
        rigid_drive=False,
    ),
    EffectSpec(
        "presliding_hysteresis",
        Stage.DIRECTION,
        "friction builds up over a displacement after a reversal",
        (
            _positive("presliding_distance", "rad"),
            Parameter("elements", "1", low=1, integer=True, default=1),
            Parameter("displacement", "1", optional=True, choices=("motor", "joint"), fitted=False),
        ),
        (("q_m", "q_j", "omega_j"),),
        memory=True,
    ),
    EffectSpec(
        "sheath_asymmetry",
        Stage.TRANSMISSION,
        "the two sheaths have different friction angles",
        (Parameter("relative_difference", "1", low=-2.0, high=2.0, low_open=True, high_open=True),),
        rigid_drive=False,
    ),
    EffectSpec(
        "tendon_slack",
        Stage.TRANSMISSION,
        "a tendon cannot push",
        rigid_drive=False,
    ),
    EffectSpec(
        "elongation_coupling",
        Stage.TRANSMISSION,
        "the full model (3.53): friction along the sheath couples into the pretension",
        (Parameter("curvature_profile", "1", choices=("uniform", "motor_end"), fitted=False),),
        excludes=("tendon_slack", "sheath_asymmetry", "tension_dependent_friction"),
        rigid_drive=False,
    ),
    EffectSpec(
        "load_dependent_friction",
        Stage.LOAD,
        "friction in the joint grows with its load",
        (_non_negative("coefficient", "1", high=1.0, high_open=True),),
    ),
    EffectSpec(
        "backlash",
        Stage.BACKLASH,
        "play after each reversal",
        (_positive("gap", "rad"),),
        _Q,
        memory=True,
        rigid_drive=False,  # there is no tendon part that play could take away
    ),
    EffectSpec(
        "viscous_friction",
        Stage.JOINT,
        "friction proportional to speed",
        (_non_negative("coefficient", "N*m*s/rad"),),
    ),
    EffectSpec(
        "direction_asymmetric_friction",
        Stage.JOINT,
        "friction proportional to speed that differs by direction",
        (Parameter("viscous_difference", "N*m*s/rad"),),
    ),
    EffectSpec(
        "inertia",
        Stage.JOINT,
        "torque that accelerates a mass",
        (_non_negative("inertia", "kg*m^2"),),
    ),
    EffectSpec(
        "gravity_load",
        Stage.JOINT,
        "a weight on the joint",
        (_non_negative("amplitude", "N*m"), Parameter("phase", "rad", default=0.0)),
        _Q,
    ),
    EffectSpec(
        "joint_stiffness",
        Stage.JOINT,
        "a spring at the joint",
        (_non_negative("stiffness", "N*m/rad"), Parameter("rest_angle", "rad", default=0.0)),
        _Q,
    ),
    EffectSpec(
        "torque_offset",
        Stage.JOINT,
        "a constant torque or an offset of a sensor",
        (Parameter("offset", "N*m"),),
    ),
    EffectSpec(
        "transport_delay",
        Stage.DELAY,
        "the measured joint torque is late",
        (_non_negative("delay", "s"),),
        memory=True,
    ),
)

CATALOGUE: Mapping[str, EffectSpec] = MappingProxyType({spec.name: spec for spec in _SPECS})


def check_effects(effects: Mapping[str, Mapping[str, Any]], where: str) -> dict[str, dict[str, Value]]:
    """Validate `[effects.NAME]` tables and fill in constant defaults, in the order of composition.

    Raises UsageError naming the effect, the parameter, what was found and what is allowed.
    """
    for name in effects:
        if name not in CATALOGUE:
            near = difflib.get_close_matches(name, CATALOGUE, n=1, cutoff=0.5)
            advice = f"did you mean '{near[0]}'?" if near else f"known effects are {', '.join(CATALOGUE)}"
            raise UsageError(f"{where}: [effects.{name}]: unknown effect; {advice}")
    checked: dict[str, dict[str, Value]] = {}
    for spec in CATALOGUE.values():
        if spec.name not in effects:
            continue
        clash = [other for other in spec.excludes if other in effects]
        if clash:
            raise UsageError(
                f"{where}: [effects.{spec.name}] cannot be combined with {_listed(clash)}; remove one of them"
            )
        checked[spec.name] = _check_parameters(spec, effects[spec.name], f"{where}: [effects.{spec.name}]")
    return checked


def _check_parameters(spec: EffectSpec, given: Mapping[str, Any], where: str) -> dict[str, Value]:
    if not isinstance(given, Mapping):
        raise UsageError(f"{where}: found {given!r}; write a table [effects.{spec.name}]")
    known = [p.name for p in spec.parameters]
    for key in given:
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1, cutoff=0.4)
            advice = f"did you mean '{near[0]}'?" if near else f"known keys are {', '.join(known) or 'none'}"
            raise UsageError(f"{where}: unknown key '{key}'; {advice}")
    values: dict[str, Value] = {}
    for parameter in spec.parameters:
        value = given.get(parameter.name, parameter.default)
        if value is None:
            if parameter.optional:
                continue
            raise UsageError(f"{where}: key '{parameter.name}' is missing; give {parameter.describe()}")
        if not parameter.accepts(value):
            raise UsageError(f"{where}: {parameter.name} = {value!r}; allowed is {parameter.describe()}")
        values[parameter.name] = value if parameter.choices else int(value) if parameter.integer else float(value)
    return values


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f"[effects.{name}]" for name in names)
