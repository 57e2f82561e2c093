"""Describe the search of a fit for an effect: coordinates of its parameters, and start values of the nonlinear ones.

Coordinates are scaled so that the effect at 1 is about as large as the torque. An amplitude with a phase is replaced by
a pair (cosine, sine), because the effect is linear in this pair.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TypeAlias

import numpy as np

from tsa_ctrl.model.functions import Array

Value: TypeAlias = float | int | str  # the values that a fit sets
Parameters: TypeAlias = Callable[[Array], dict[str, Value]]
INF = math.inf
FEW_SAMPLES = 1.5  # samples: a shorter lag or delay acts only where the direction is unknown, and is not visible


@dataclass(frozen=True)
class Coordinate:
    """Define one free parameter of a fit in its own scale, with its bounds and the step of finite differences."""

    name: str
    low: float
    high: float
    step: float = 1e-4


@dataclass(frozen=True)
class Variant:
    """Define the search for an effect with fixed discrete choices.

    `starts` has start vectors of `coordinates`. The coordinates with the indices `amplitude` are 0 there, so that the
    effect vanishes. Its response is nearly linear in them. Without an amplitude, a start is the complete effect.
    """

    effect: str
    coordinates: tuple[Coordinate, ...]
    starts: tuple[tuple[float, ...], ...]
    amplitude: tuple[int, ...]
    parameters: Parameters
    label: str = ""
    unidentifiable: tuple[str, ...] = ()  # parameters that no log of this base model determines
    full_strength: tuple[tuple[float, ...], ...] = ()  # further starts, for effects far from linear in their strength


@dataclass(frozen=True)
class Scales:
    """Hold the sizes of the signals of some logs, which scale coordinates and place grids."""

    torque: float  # RMS of the predicted torque's change, N*m
    motor_torque: float  # RMS of the motor torque's change, N*m
    largest_motor_torque: float  # N*m
    speed: float  # 95th percentile of the speeds in motion, rad/s
    speed_noise: float  # rad/s
    acceleration: float  # rad/s^2
    reach: float  # half range of q_j, rad
    middle: float  # mean of q_j, rad
    motor_reach: float  # half range of the displacement that presliding follows, rad
    motor_step: float  # 90th percentile of the steps of q_m, rad; nan without q_m
    begin: float  # first sample of the longest run, s
    seconds: float  # longest run, s
    period: float  # compute period, s
    heating: float  # range of the temperature, K
    bending: float  # range of the column theta, over the model's bending angle
    derived_velocity: str  # column of the velocity that was derived from an angle; empty if it was measured
    plain: bool  # a drive without tendons: joint and motor are one
    offset: bool  # the base model has a constant torque, which is fitted
    joints: Mapping[str, float] = field(default_factory=dict)  # half range of other joints that moved, rad, by name
    tied: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # joints that move in proportion to others


Search: TypeAlias = Callable[[str, Scales], Sequence[Variant]]  # returns the variants of the effect with this name


def linear(
    parameter: str,
    scale: Callable[[Scales], float],
    low: float = -INF,
    high: float = INF,
    full_strength: tuple[tuple[float, ...], ...] = (),
) -> Search:
    """Return the search for one amplitude: parameter = scale * coordinate, between bounds of the parameter."""

    def variants(name: str, s: Scales) -> list[Variant]:
        unit = scale(s)

        def parameters(u: Array) -> dict[str, Value]:
            return {parameter: min(max(float(u[0]) * unit, low), high)}  # rounding may exceed a bound

        coordinate = Coordinate(parameter, low / unit, high / unit, 1e-3)
        return [Variant(name, (coordinate,), ((0.0,),), (0,), parameters, full_strength=full_strength)]

    return variants


def duration(
    parameter: str, longest: float, starts: tuple[float, float, int], step: Callable[[Scales], float] = lambda _: 0.02
) -> Search:
    """Return the search for one time in s from 0 to `longest`, as a coordinate in hundredths of a second.

    `starts`: shortest, longest (s) and number of the values at which a fit begins. `step`: of finite differences, in
    hundredths of a second.
    """
    unit = 0.01  # s

    def variants(name: str, s: Scales) -> list[Variant]:
        def parameters(u: Array) -> dict[str, Value]:
            return {parameter: float(u[0]) * unit}

        coordinate = Coordinate(parameter, 0.0, longest / unit, step(s))
        begin = tuple((v / unit,) for v in geometric(*starts))
        short = ((FEW_SAMPLES * s.period / unit,),)
        return [Variant(name, (coordinate,), begin, (), parameters, full_strength=short)]

    return variants


def wave(
    effect: str,
    parameter: str,
    unit: float,
    side: float = INF,
    label: str = "",
    choice: Mapping[str, Value] = MappingProxyType({}),
) -> Variant:
    """Return the variant of an amplitude with a phase: its cosine and sine parts in `unit`, each within -side to side.

    `choice`: discrete parameters of the variant.
    """

    def parameters(u: Array) -> dict[str, Value]:
        amplitude = math.hypot(u[0], u[1]) * unit
        return {parameter: amplitude, **choice, "phase": math.atan2(u[1], u[0]) if amplitude else 0.0}

    coordinates = (Coordinate("cosine", -side, side, 1e-3), Coordinate("sine", -side, side, 1e-3))
    return Variant(effect, coordinates, ((0.0, 0.0),), (0, 1), parameters, label)


def one(_: Scales) -> float:
    """Return 1, the scale of a parameter that is a share."""
    return 1.0


def geometric(low: float, high: float, count: int) -> list[float]:
    """Return `count` values from `low` to `high` in equal ratios; empty without a range."""
    return [float(v) for v in np.geomspace(low, high, count)] if high > low > 0.0 else []
