"""Describe an effect, except for its formulas, in one place: its class.

Model files and their messages, the composition, the notes of the live inverse, the diagnosis and the demo read this
description. The plant and the hidden cases of the tests do not use it, so that the two can be compared.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, TypeAlias, get_type_hints

import numpy as np

from tsa_ctrl.model import curvature
from tsa_ctrl.model.effects.search import Scales, Search, Value

Setting: TypeAlias = Value | curvature.Points  # the values of a file
Columns: TypeAlias = tuple[tuple[str, ...], ...]  # the log must have one column of each inner tuple


class Stage(Enum):
    """List the stages of the model at which effects act, in the order of composition."""

    VELOCITY = "measured velocity"
    MOTOR_TORQUE = "motor torque"
    BENDING = "bending angle"
    PRETENSION = "pretension"
    FRICTION = "friction coefficient"
    TENSION = "friction of one tendon by its tension"
    DIRECTION = "direction"
    TRANSMISSION = "transmission"
    LOAD = "load-dependent friction"
    BACKLASH = "backlash"
    LEVER = "lever arm"
    JOINT = "joint side"
    DELAY = "delay of the measurement"
    STRETCH = "stretch of the tendons"


class Kind(Enum):
    """List the kinds of model files (`[actuator] kind`)."""

    TENDON_SHEATH = "tendon_sheath"
    RIGID_DRIVE = "rigid_drive"
    GEARED_DRIVE = "geared_drive"

    @property
    def spoken(self) -> str:
        """Return the kind as text."""
        return {"tendon_sheath": "tendon-sheath", "rigid_drive": "plain drive"}.get(self.value, "geared drive")


class Motion(Enum):
    """List the recordings that separate effects with similar results, in the order of their cost."""

    SPEEDS = "reversals at several speeds (0.1 to 2 rad/s) over the same range"
    BOTH_WAYS = f"{SPEEDS}, in both directions"
    SIGNS = "load the joint with torques of both signs at several levels"
    RANGE = "move over the whole range of the joint"
    FREQUENCIES = f"{RANGE}, at two or more frequencies of motion"
    WARM = "heat and cool the drive while it moves, and log its temperature"
    BENDING = "repeat the same motion at two or more known bending angles (column theta) or known pretensions"
    JOINTS = "move each other joint alone over its range, then all together, and log their angles (columns q_j.NAME)"
    GAIN = "hang a known weight on the joint and hold it, to calibrate the torque gain"
    LONGER = "record the same motion several times as long"
    STIFFNESS = "measure the stiffness of a tendon separately, with a known weight on a known length"


@dataclass(frozen=True)
class Twins:
    """List effects (or `parameter_error`) that some logs cannot distinguish from another effect.

    `parted_by` lists the motions that separate them.
    """

    names: tuple[str, ...]
    parted_by: tuple[Motion, ...]


@dataclass(frozen=True)
class Parameter:
    """Define one parameter of an effect, as `Annotated[float, Parameter(unit, bounds)]` of its class.

    Name and default come from the annotated field. A parameter without a default is required, unless it is `optional`.
    """

    unit: str = "1"
    low: float = -math.inf
    high: float = math.inf
    low_open: bool = False
    high_open: bool = False
    optional: bool = False  # may be absent: its default depends on the model or the log
    choices: tuple[str, ...] = ()
    points: bool = False  # in addition to the choices, a curvature profile by points
    integer: bool = False
    fitted: bool = True  # False: set by the user, never estimated from a log
    text: bool = False  # a formula
    name: str = ""
    default: Setting | None = None

    def describe(self) -> str:
        """Return the allowed values as text, for error messages."""
        if self.text:
            return 'a formula in quotes, such as "k*sin(2*q_j)"'
        if self.choices:
            return " or ".join([*(f'"{choice}"' for choice in self.choices), *([curvature.POINTS] * self.points)])
        kind = "a whole number" if self.integer else "a number"
        bounds = []
        if self.low > -math.inf:
            bounds.append(f"{'above' if self.low_open else 'at least'} {self.low:g}")
        if self.high < math.inf:
            bounds.append(f"{'below' if self.high_open else 'at most'} {self.high:g}")
        return " ".join([kind, " and ".join(bounds)]).strip() + (f" ({self.unit})" if self.unit != "1" else "")

    def accepts(self, value: object) -> bool:
        if self.text:
            return isinstance(value, str)
        if self.choices:
            chosen = isinstance(value, str) and value in self.choices
            return chosen or (self.points and curvature.as_points(value) is not None)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            return False
        if self.integer and value != int(value):
            return False
        above = value > self.low if self.low_open else value >= self.low
        below = value < self.high if self.high_open else value <= self.high
        return above and below

    def taken(self, value: Any) -> Setting:
        """Return an accepted value in the type that the effect's class requires."""
        if self.text:
            return str(value)
        if self.choices:
            return value if isinstance(value, str) else curvature.as_points(value) or ()
        return int(value) if self.integer else float(value)


def non_negative(unit: str, **more: Any) -> Parameter:
    """Return a parameter that must be at least 0."""
    return Parameter(unit, low=0.0, **more)


def positive(unit: str, **more: Any) -> Parameter:
    """Return a parameter that must be above 0."""
    return Parameter(unit, low=0.0, low_open=True, **more)


@dataclass(frozen=True)
class Draw:
    """Define the range of a value that the demo chooses at random, between `low` and `high`.

    With `signed`, either sign is possible. With `whole`, the value is a whole number below `high`.
    """

    low: float
    high: float
    signed: bool = False
    whole: bool = False

    def value(self, rng: np.random.Generator) -> float:
        if self.whole:
            return int(rng.integers(int(self.low), int(self.high)))
        sign = rng.choice([-1.0, 1.0]) if self.signed else 1.0
        return float(sign * rng.uniform(self.low, self.high))


def _always(_: Scales) -> str:
    return ""


@dataclass(frozen=True, kw_only=True)
class Specification:
    """Describe one effect: its name, stage and summary, the signals that it needs, and how it is inverted and hidden.

    Attributes:
        search: returns the variants that a fit tries.
        unresolved: the reason if no variant can be tried on a log.
        untestable: the reason why a log with certain signals cannot show it; empty if it can.
        asks: the motion to record in that case.
        twins: effects with the same appearance in some logs; only one effect of each pair lists the other.
        companion: another effect that often acts together with this one. The intervals of the parameters include the
            values that they have if it acts as well.
        columns: columns that a log must have.
        live_columns: signals that the loop must measure, from the effect's parameters, if they differ from `columns`.
        feedforward: the limit of the live inverse, with {parameter} in the text; empty if the inverse is exact.
        demo: values that `tsa demo` may hide in its rig, a tenth to a third of the rig's friction torque.
    """

    name: str
    stage: Stage
    summary: str
    search: Search
    equation: str  # the change of the model by this effect
    twins: tuple[Twins, ...] = ()
    unresolved: str = "the log does not resolve the scale on which it acts"
    untestable: Callable[[Scales], str] = _always
    asks: Motion | None = None
    companion: str = ""
    columns: Columns = ()
    live_columns: Callable[[Mapping[str, Setting]], Columns] | None = None
    excludes: tuple[str, ...] = ()
    constants: Parameter | None = None  # bounds of further numeric parameters with any name
    hypothesis: bool = True  # False: the user's own formula, which no diagnosis proposes
    kinds: tuple[Kind, ...] = tuple(Kind)  # model files that may contain the effect
    feedforward: str = ""
    demo: Mapping[str, Draw | Setting] | None = None
    parameters: tuple[Parameter, ...] = ()  # of the class
    effect: Callable[..., Any] = field(default=dict)  # the class

    @classmethod
    def of(cls, effect: type[Any]) -> Specification:
        """Return the specification of an effect's class, with the parameters of its fields."""
        own: Specification = effect.specification
        return dataclasses.replace(own, parameters=_parameters(effect), effect=effect)

    def parameter(self, name: str) -> Parameter:
        """Return the parameter with this name; an unknown name has the bounds of the effect's further constants."""
        other = dataclasses.replace(self.constants or Parameter(), name=name)
        return next((p for p in self.parameters if p.name == name), other)

    @property
    def named(self) -> bool:
        """Return True if the effect accepts further parameters with any name."""
        return self.constants is not None

    def build(self, parameters: Mapping[str, Setting]) -> Any:
        """Return the effect with checked parameters; parameters that its class does not have become `constants`."""
        if not self.named:
            return self.effect(**parameters)
        known = {p.name for p in self.parameters}
        own = {name: value for name, value in parameters.items() if name in known}
        rest = tuple((name, value) for name, value in parameters.items() if name not in known)
        return self.effect(**own, constants=rest)

    def parted_from(self, other: str) -> tuple[Motion, ...]:
        """Return the motions that separate this effect from another; empty if `twins` does not list the other."""
        return next((twins.parted_by for twins in self.twins if other in twins.names), ())

    def needed_live(self, parameters: Mapping[str, Setting]) -> Columns:
        """Return the signals that the loop must measure.

        Effects that act only on the elongation need none, because the control law does not use them.
        """
        if self.stage is Stage.STRETCH:
            return ()
        return self.columns if self.live_columns is None else self.live_columns(parameters)


def _parameters(effect: type[Any]) -> tuple[Parameter, ...]:
    hints = get_type_hints(effect, include_extras=True)
    found = []
    for entry in dataclasses.fields(effect):
        if not hasattr(hints[entry.name], "__metadata__"):
            continue  # not a parameter of the file
        parameter: Parameter = hints[entry.name].__metadata__[0]
        default = None if entry.default is dataclasses.MISSING else entry.default
        found.append(dataclasses.replace(parameter, name=entry.name, default=default))
    return tuple(found)
