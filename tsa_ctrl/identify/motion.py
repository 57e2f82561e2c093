"""Provide velocities and accelerations of a log, recorded or derived by one smoother for all commands.

A velocity that is not recorded is derived from its angle. An acceleration is derived from the recorded velocity,
because a delayed velocity can be detected only with its own derivative. Without a recorded velocity, it is derived from
the angle. The cut-off follows from the data (`smoothing`), and the expected error is reported.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tsa_ctrl.identify.smoothing import LowPass, Smoothed, smoothed
from tsa_ctrl.model.functions import Array

SHAFTS = (("q_j", "omega_j", "acceleration_j"), ("q_m", "omega_m", "acceleration_m"))
STANDING = 0.5  # s: an angle that changes by less than one encoder count in this time has no certain direction
OWN = 0.1  # 1, least share of a joint's motion that other joints do not share; with less, effects cannot be separated
SURE = 4.0  # least ratio of a velocity to its error for a certain sign: 6e-5 of Gaussian errors exceed it


@dataclass(frozen=True)
class Motion:
    """The recorded `columns` of one log, each (n,) at a constant `period` in s, smoothed on first use.

    `cutoff`: Hz, or None to use the cut-off that follows from the data. `known`: the columns smoothed so far.
    """

    columns: Mapping[str, Array]
    period: float
    cutoff: float | None = None
    known: dict[str, Smoothed] = field(default_factory=dict)

    def smoothed(self, name: str) -> Smoothed:
        """Return a recorded angle or velocity, smoothed."""
        if name not in self.known:
            kind = "angle" if name.startswith("q") else "velocity"
            self.known[name] = smoothed(self.columns[name], self.period, kind, self.cutoff)
        return self.known[name]

    def derived(self) -> dict[str, Array]:
        """Return the velocities (rad/s) that were not recorded but follow from an angle, by name."""
        return {
            velocity: directed(self.smoothed(angle))
            for angle, velocity, _ in SHAFTS
            if angle in self.columns and velocity not in self.columns
        }

    def accelerations(self) -> dict[str, Array]:
        """Return the accelerations (rad/s^2) of all shafts with a recorded motion, by name."""
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
        """Return the columns that the smoother has derived so far."""
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
    """A column `name` derived from `source`.

    `error` is its expected RMS error, and `noise` the part of the noise in that error, both in the column's unit.
    `asked`: cut-off set by the user in Hz, or None.
    """

    name: str
    source: str
    low_pass: LowPass | None
    error: float
    noise: float
    asked: float | None


def in_words(made: Iterable[Made]) -> tuple[str, ...]:
    """Return one sentence for each kind of derived column over all logs, with the method and the expected error."""
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
    """Return the velocity of a smoothed angle, with the sign of the surrounding motion where its own is uncertain.

    Below one count in STANDING, the sign shows only noise or ringing of the filter. The velocity is set to 0 there
    unless the direction changes.
    """
    steps = np.abs(np.diff(found.raw))
    moved = steps[steps > 0.0]
    still = (float(moved.min()) if len(moved) else 0.0) / STANDING  # nearly 0 for an angle without counts
    return with_sure_signs(found.rate, found.value, found.errors[1], still, found.errors[0])


def with_sure_signs(velocity: Array, angle: Array, error: float, still: float, near: float) -> Array:
    """Return `velocity` (n,), rad/s, with the sign of the surrounding motion where its own sign is uncertain.

    A sign is certain if the speed exceeds both `still` (rad/s) and SURE times `error` (rad/s). Between two motions in
    one direction, the velocity keeps that direction, and speeds up to `still` become 0. Between opposite motions, it
    reverses once, at the extremum of `angle` (n,). This is the middle of the samples within `near` (rad) of the
    extremum. Without any certain sign, the result is 0.
    """
    surely = (np.abs(velocity) > max(still, SURE * error)) & (velocity != 0.0)
    moving = np.flatnonzero(surely)
    if len(moving) == 0:
        return np.zeros_like(velocity)
    standing = np.abs(velocity) <= still
    out = np.where(surely, velocity, 0.0)
    edges = np.flatnonzero(np.diff(moving) > 1)
    stretches = [(int(moving[at]), int(moving[at + 1])) for at in edges]  # certain samples on either side
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


def tied_joints(angles: Mapping[str, Array]) -> dict[str, tuple[str, ...]]:
    """Return the joints whose angle is a sum of multiples of other angles: by name, the names of these other joints.

    `angles`: rad by name, (n,) each. A joint that others depend on is not in the result.
    """
    tied: dict[str, tuple[str, ...]] = {}
    free: dict[str, Array] = {}
    for name, angle in angles.items():
        own = angle - np.mean(angle)
        others = np.column_stack([*free.values(), np.zeros(own.size)])
        parts = others * np.linalg.lstsq(others, own, rcond=None)[0]
        if float(np.std(own - parts.sum(axis=1))) > OWN * float(np.std(own)):
            free[name] = own
        else:
            shares = np.std(parts, axis=0) / np.std(own)
            tied[name] = tuple(other for other, share in zip(free, shares.tolist(), strict=False) if share > OWN)
    return tied


def inseparable(tied: Mapping[str, tuple[str, ...]], found: Iterable[str]) -> str:
    """Return why the effects of joints are not known, with the remedy; empty if none of `found` moves with others.

    Args:
        tied: result of `tied_joints`.
        found: names of the joints with an effect.
    """
    names = set(found)
    for name, others in tied.items():
        if names & {name, *others}:
            return (
                f"the joints {', '.join(others)} and {name} move in proportion in these logs, so their effects on the "
                "wrap angle cannot be separated; move each of them alone as well, or remove the column q_j.NAME of a "
                "joint that does not bend the sheath"
            )
    return ""
