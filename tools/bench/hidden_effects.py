"""Add known effects to the torque of measured logs by the formulas of this file.

The size of an effect is the RMS of its torque while the drive moves, without the part that recalibration can absorb.
Least squares remove this part: inertia, friction, drag and offset if the model has them, and for tendons the motor
torque and the direction. Samples at rest are excluded, because static friction is undetermined there. The size of a
delay is evaluated on the torque that follows from the motion, because delayed noise is still noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import Model, RigidDrive

Array = NDArray[np.float64]
SLOW = 0.03  # s over which the motion is averaged before effects are computed
REST = 0.01  # of the largest speed, below which friction fades, because the sign of velocity noise is random
STRIBECK = 0.1  # of the largest speed, range over which the hidden static friction fades
MOST_BLURRED = 0.5  # of the RMS change, permitted difference if the motion is averaged over twice the time
MOST_CYCLES = 40  # cycles of a ripple per turn, the limit of the search in model/effects/motor.py
HALVINGS = 30  # steps of the bisection for a delay or a distance


@dataclass(frozen=True)
class Motion:
    """The motion of one log in SI units, (n,) each. `torque` is the measured torque that the model predicts."""

    t: Array
    q: Array
    omega: Array
    acceleration: Array
    torque: Array
    tau_m: Array
    reach: float  # rad, largest range of an angle in the set
    fastest: float  # rad/s, largest speed in the set
    friction: float  # N*m, Coulomb friction of the set by least squares
    explained: Array  # N*m, torque that follows from the motion, by least squares over the set


@dataclass(frozen=True)
class Hidden:
    """A hidden effect.

    Attributes:
        change: function of the motion and one number that returns the additional torque of a rigid drive, or the
            torque loss of tendons, N*m.
        needs_angle: True if the effect requires a measured angle.
        range: range of the number if the change is not linear in it.
        follows_acceleration: True if the change at steady speed is only velocity noise.
    """

    change: Callable[[Motion, float], Array]
    needs_angle: bool = False
    range: tuple[float, float] | None = None
    follows_acceleration: bool = False


def direction(log: Motion) -> Array:
    """Return the sign of the velocity, which fades linearly to 0 at rest, (n,)."""
    return np.clip(log.omega / (REST * log.fastest), -1.0, 1.0)


def moving(log: Motion) -> NDArray[np.bool_]:
    """Return a mask of the samples in which the drive moves, (n,)."""
    return np.abs(log.omega) > REST * log.fastest


def smooth(y: Array, t: Array, times: int = 1) -> Array:
    """Return the moving average over `times` SLOW, at least three samples each, (n,)."""
    width = times * max(3, round(SLOW / float(np.median(np.diff(t)))) | 1) | 1
    return np.convolve(np.pad(y, width // 2, mode="edge"), np.full(width, 1.0 / width), mode="valid")


def motions_of(logs: Sequence[Dataset], model: Model, times: int = 1) -> list[Motion]:
    """Return the motion of each log, averaged over `times` SLOW, with the common values of the set."""
    plain = isinstance(model, RigidDrive)
    found = [_motion(log, plain, times) for log in logs]
    bases = [base_of(each, model) for each in found]
    fitted = np.linalg.lstsq(np.concatenate(bases), np.concatenate([each.torque for each in found]), rcond=None)[0]
    reach, fastest = max(float(np.ptp(each.q)) for each in found), max(float(np.max(np.abs(m.omega))) for m in found)
    friction = abs(float(fitted[0 if plain else 1]))
    explained = _explained(found, bases)
    return [
        replace(each, reach=reach, fastest=fastest, friction=friction, explained=torque)
        for each, torque in zip(found, explained, strict=True)
    ]


def _explained(logs: Sequence[Motion], bases: Sequence[Array]) -> list[Array]:
    """Return the torque of each log that a fit of base model, inertia, drag, offset, spring and weight explains."""
    columns = [
        np.column_stack([base, log.acceleration, log.omega, np.ones(len(log.q)), log.q, np.sin(log.q), np.cos(log.q)])
        for log, base in zip(logs, bases, strict=True)
    ]
    torque = np.concatenate([log.torque for log in logs])
    fitted = np.linalg.lstsq(np.concatenate(columns), torque, rcond=None)[0]
    return [each @ fitted for each in columns]


def _motion(log: Dataset, plain: bool, times: int) -> Motion:
    """Return the motion of one log. If no angle was measured, integrate the velocity."""
    t = log["t"]
    angle, velocity = ("q_m", "omega_m") if plain else ("q_j", "omega_j")
    if angle in log and angle not in log.derived:
        q = smooth(log[angle], t, times)
        omega = smooth(np.gradient(q, t), t, times)
    else:
        omega = smooth(log[velocity], t, times)
        q = np.cumsum(omega) * float(np.median(np.diff(t)))
    torque = log["tau_m" if plain else "tau_j"]
    return Motion(t, q, omega, smooth(np.gradient(omega, t), t, times), torque, log["tau_m"], 0.0, 0.0, 0.0, torque)


def presliding(log: Motion, share: float) -> Array:
    """Return the difference of presliding friction from Coulomb friction, N*m, (n,).

    After each reversal the friction builds up exponentially over `share` of the largest range of the angle.
    """
    distance = share * log.reach
    z, out = 0.0, np.empty(len(log.q))
    steps = np.abs(np.diff(log.q, prepend=log.q[0]))
    for at, (way, step) in enumerate(zip(np.sign(log.omega).tolist(), steps.tolist(), strict=True)):
        z = way + (z - way) * math.exp(-step / distance)
        out[at] = z
    return log.friction * (out * np.abs(direction(log)) - direction(log))


def late(log: Motion, delay: float) -> Array:
    """Return the change of the torque by a delay in s, N*m, (n,)."""
    return np.asarray(np.interp(log.t - delay, log.t, log.torque) - log.torque)


def cycles(log: Motion) -> float:
    """Return the number of cycles of a ripple per turn, so that the motion covers two cycles, at most `MOST_CYCLES`."""
    return float(min(np.round(4.0 * np.pi / log.reach), MOST_CYCLES))


HIDDEN: Mapping[str, Hidden] = {
    "gravity_load": Hidden(lambda log, a: a * np.sin(log.q + 0.4), needs_angle=True),
    "joint_stiffness": Hidden(lambda log, a: a * log.q, needs_angle=True),
    "torque_offset": Hidden(lambda log, a: np.full(len(log.q), a)),
    "viscous_friction": Hidden(lambda log, a: a * log.omega),
    "inertia": Hidden(lambda log, a: a * log.acceleration, follows_acceleration=True),
    "direction_asymmetric_friction": Hidden(lambda log, a: a * np.abs(log.omega)),
    "stribeck_friction": Hidden(
        lambda log, a: a * direction(log) * np.exp(-np.abs(log.omega) / (STRIBECK * log.fastest))
    ),
    "torque_ripple": Hidden(lambda log, a: a * np.sin(cycles(log) * log.q + 0.7), needs_angle=True),
    "presliding_hysteresis": Hidden(presliding, needs_angle=True, range=(1e-6, 0.1)),
    "transport_delay": Hidden(late, range=(1e-4, 0.1)),
}


def recorded(log: Dataset) -> dict[str, Array]:
    """Return the measured columns, without the derived ones."""
    return {name: values for name, values in log.columns.items() if name not in log.derived}


def base_of(log: Motion, model: Model) -> Array:
    """Return the torque columns that recalibration can absorb, (n, k)."""
    sigma = np.sign(log.omega)
    if not isinstance(model, RigidDrive):
        return np.column_stack([log.tau_m, sigma])
    free = {"inertia": log.acceleration, "viscous_friction": log.omega, "torque_offset": np.ones_like(sigma)}
    return np.column_stack([sigma, *(column for name, column in free.items() if getattr(model, name) is not None)])


def left_of(change: Sequence[Array], base: Sequence[Array]) -> float:
    """Return the RMS residual of a change over all logs after a fit of the base columns, N*m."""
    whole, columns = np.concatenate(change), np.concatenate(base)
    return float(np.sqrt(np.mean((whole - columns @ np.linalg.lstsq(columns, whole, rcond=None)[0]) ** 2)))


def size_of(hidden: Hidden, logs: Sequence[Motion], base: Sequence[Array], number: float) -> float:
    """Return the size of an effect with this number, N*m."""
    changes = [hidden.change(replace(log, torque=log.explained), number)[moving(log)] for log in logs]
    return left_of(changes, [columns[moving(log)] for log, columns in zip(logs, base, strict=True)])


def number_of(hidden: Hidden, logs: Sequence[Motion], base: Sequence[Array], size: float) -> float | None:
    """Return the number with which an effect has `size`, N*m, or None if no number in its range has it."""

    def left(number: float) -> float:
        return size_of(hidden, logs, base, number)

    if hidden.range is None:
        unit = left(1.0)
        return size / unit if unit > 1e-9 * size else None
    low, high = hidden.range
    if not left(low) < size < left(high):
        return None
    for _ in range(HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if left(middle) < size else (low, middle)
    return math.sqrt(low * high)


def with_hidden(logs: Sequence[Dataset], model: Model, effect: str, size: float) -> tuple[list[Dataset], float | None]:
    """Return the logs with an effect of this size (N*m) added, and its number.

    The number is None if the effect cannot be added. The model may already have it, a measured angle may be missing, no
    number may result in that size, or the effect may follow the velocity noise.
    """
    plain, hidden = isinstance(model, RigidDrive), HIDDEN[effect]
    if (plain and getattr(model, effect, None) is not None) or (
        hidden.needs_angle and not any(name in logs[0] and name not in logs[0].derived for name in ("q_m", "q_j"))
    ):
        return list(logs), None
    motions = motions_of(logs, model)
    bases = [base_of(each, model) for each in motions]
    number = number_of(hidden, motions, bases, size)
    if number is None or (hidden.follows_acceleration and _is_noise(hidden, motions, motions_of(logs, model, 2))):
        return list(logs), None
    name, sign = "tau_m" if plain else "tau_j", 1.0 if plain or effect == "transport_delay" else -1.0
    changed = [
        Dataset.from_arrays({**recorded(log), name: log[name] + sign * hidden.change(each, number)}, log.name)
        for log, each in zip(logs, motions, strict=True)
    ]
    return changed, number


def _is_noise(hidden: Hidden, motions: Sequence[Motion], coarser: Sequence[Motion]) -> bool:
    """Return True if the change depends mostly on the averaging time of the motion, as noise does."""
    change, other = (np.concatenate([hidden.change(each, 1.0) for each in logs]) for logs in (motions, coarser))
    return float(np.sum((change - other) ** 2)) > (MOST_BLURRED**2) * float(np.sum(change**2))
