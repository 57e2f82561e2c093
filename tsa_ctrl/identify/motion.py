"""Velocities and accelerations of a log: recorded, or from what was counted by one smoother for every verb.

A velocity that is not recorded comes from its angle; an acceleration from the velocity where that is recorded, since a
velocity that is late shows only beside its own derivative, else from the angle. The cut-off follows from the data
(`smoothing`), and its cost is reported.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tsa_ctrl.identify.smoothing import LowPass, Smoothed, smoothed
from tsa_ctrl.model.functions import Array

SHAFTS = (("q_j", "omega_j", "acceleration_j"), ("q_m", "omega_m", "acceleration_m"))
STANDING = 0.5  # s: slower than one encoder count in it, an angle has no velocity of a certain direction
SURE = 4.0  # errors that a velocity must be from 0 for its sign to be sure: 6e-5 of Gaussian errors are larger


@dataclass(frozen=True)
class Motion:
    """The recorded `columns` of one log, each (n,) on a grid of `period` s, smoothed when first asked for.

    `cutoff` in Hz takes the place of the data's own bandwidth.
    """

    columns: Mapping[str, Array]
    period: float
    cutoff: float | None = None
    known: dict[str, Smoothed] = field(default_factory=dict)

    def smoothed(self, name: str) -> Smoothed:
        """A recorded angle or velocity."""
        if name not in self.known:
            kind = "angle" if name.startswith("q") else "velocity"
            self.known[name] = smoothed(self.columns[name], self.period, kind, self.cutoff)
        return self.known[name]

    def derived(self) -> dict[str, Array]:
        """Velocities that were not recorded, by name."""
        return {
            velocity: directed(self.smoothed(angle))
            for angle, velocity, _ in SHAFTS
            if angle in self.columns and velocity not in self.columns
        }

    def accelerations(self) -> dict[str, Array]:
        """rad/s^2, by name, of every shaft that has a motion."""
        out = {}
        for angle, velocity, name in SHAFTS:
            if name in self.columns:
                out[name] = self.columns[name]
            elif velocity in self.columns:
                out[name] = self.smoothed(velocity).rate
            elif angle in self.columns:
                out[name] = self.smoothed(angle).second
        return out

    def made(self) -> tuple[Made, ...]:
        """The results of the smoother so far."""
        out = []
        for angle, velocity, acceleration in SHAFTS:
            if angle in self.known and velocity not in self.columns:
                found = self.known[angle]
                out.append(Made(velocity, angle, found.smooth, found.errors[1], found.noises[1], self.cutoff))
                if acceleration not in self.columns:
                    out.append(Made(acceleration, angle, found.steep, found.errors[2], found.noises[2], self.cutoff))
            elif velocity in self.known and acceleration not in self.columns:
                found = self.known[velocity]
                out.append(Made(acceleration, velocity, found.steep, found.errors[1], found.noises[1], self.cutoff))
        return tuple(out)


@dataclass(frozen=True)
class Made:
    """A column `name` derived from `source`; `error` is the RMS expected of it, `noise` the noise's part, SI."""

    name: str
    source: str
    low_pass: LowPass | None
    error: float
    noise: float
    asked: float | None


def in_words(made: Iterable[Made]) -> tuple[str, ...]:
    """One line for each kind of derived column, over all logs: the method and its cost."""
    kinds: dict[tuple[str, str], list[Made]] = {}
    for each in made:
        kinds.setdefault((each.name, each.source), []).append(each)
    out = []
    for (name, source), logs in kinds.items():
        cutoffs = [log.low_pass.cutoff for log in logs if log.low_pass is not None]
        if not cutoffs:
            out.append(f"{name} is derived from {source}: central differences of the values as they are")
            continue
        unit = "rad/s^2" if name.startswith("acceleration") else "rad/s"
        chosen = "as asked for" if logs[0].asked is not None else "which motion and noise in the data ask for"
        out.append(
            f"{name} is derived from {source}: zero-phase low-pass at {_span(cutoffs)} Hz, {chosen}; expected error "
            f"{_span([log.error for log in logs])} {unit} RMS, {_span([log.noise for log in logs])} of it noise"
        )
    return tuple(out)


def _span(values: Sequence[float]) -> str:
    low, high = (f"{float(f'{value:.2g}'):g}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def directed(found: Smoothed) -> Array:
    """The velocity of a smoothed angle, with the sign of the motion around wherever its own is not sure.

    Below one count in STANDING a sign is noise or the filter's ringing, and the encoder is at rest.
    """
    steps = np.abs(np.diff(found.raw))
    moved = steps[steps > 0.0]
    still = (float(moved.min()) if len(moved) else 0.0) / STANDING  # of an unquantised angle next to nothing
    return with_sure_signs(found.rate, found.value, found.errors[1], still, found.errors[0])


def with_sure_signs(velocity: Array, angle: Array, error: float, still: float, near: float) -> Array:
    """`velocity` (n,) rad/s, with the sign of the surrounding motion within SURE `error` of 0.

    Between two stretches of one direction the motion has that direction too, and up to `still` rad/s the velocity is 0;
    between opposite ones it turns once, at the extremum of `angle` (n,): in the middle of the samples that may be it
    as they are `near` it, rad.
    """
    surely = (np.abs(velocity) > max(still, SURE * error)) & (velocity != 0.0)
    moving = np.flatnonzero(surely)
    if len(moving) == 0:
        return np.zeros_like(velocity)
    standing = np.abs(velocity) <= still
    out = np.where(surely, velocity, 0.0)
    edges = np.flatnonzero(np.diff(moving) > 1)
    stretches = [(int(moving[at]), int(moving[at + 1])) for at in edges]  # the sure samples on either side
    for before, after in [(-1, int(moving[0])), *stretches, (int(moving[-1]), len(velocity))]:
        inside = slice(before + 1, after)
        ends = [velocity[at] for at in (before, after) if 0 <= at < len(velocity)]
        way, next_way = float(np.sign(ends[0])), float(np.sign(ends[-1]))
        size = np.abs(velocity[inside])
        if way == next_way:
            out[inside] = np.where(standing[inside], 0.0, way * size)
            continue
        height = way * angle[inside]
        turned = int(np.median(np.flatnonzero(height >= height.max() - near)))
        out[inside] = np.where(np.arange(len(size)) < turned, way * size, next_way * size)
    return out
