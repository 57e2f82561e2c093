"""Known effects hidden in measured logs, by formulas of this file: the torque as the drive would show it with them.

The size of an effect is the RMS, while the drive moves, of what is left of it once all is projected out that
recalibration may change: inertia, friction, drag and offset as far as the model has them; of tendons the motor torque
and the direction. At rest friction may be anything, so nothing is hidden in it; and noise that comes later is noise, so
that the size of a delay is what it changes of the torque that follows from the motion.
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
SLOW = 0.03  # s, over which motion is averaged for what is hidden: any smooth motion near the measured one will do
REST = 0.01  # of the largest speed, below which friction fades: the sign of a velocity's noise is no direction
STRIBECK = 0.1  # of the largest speed, over which the hidden static friction fades
MOST_BLURRED = 0.5  # of what is hidden, RMS, that may be another when the motion is averaged over twice as long
MOST_CYCLES = 40  # of a ripple per turn: more are not looked for (model/effects/motor.py), and would be another test
HALVINGS = 30  # of the range of a delay or a distance, until its size is the one wanted


@dataclass(frozen=True)
class Motion:
    """One log, (n,) each: angle (rad), velocity, acceleration and the torque that is predicted, SI; motor's torque."""

    t: Array
    q: Array
    omega: Array
    acceleration: Array
    torque: Array
    tau_m: Array
    reach: float  # rad, the largest range of an angle in the set
    fastest: float  # rad/s, of the set
    friction: float  # N*m, Coulomb friction of the set by least squares
    explained: Array  # torque that follows from the motion, by least squares over the set


@dataclass(frozen=True)
class Hidden:
    """`change` of the torque (N*m) that a plain drive needs, or that tendons lose, with this number of the effect.

    `range`: of a number in which the change is not linear. `follows_acceleration`: the change at steady speed is only
    noise of the velocity.
    """

    change: Callable[[Motion, float], Array]
    needs_angle: bool = False
    range: tuple[float, float] | None = None
    follows_acceleration: bool = False


def direction(log: Motion) -> Array:
    """Sign of the velocity, which fades to 0 where the drive stands, (n,)."""
    return np.clip(log.omega / (REST * log.fastest), -1.0, 1.0)


def moving(log: Motion) -> NDArray[np.bool_]:
    """Where it does not stand, (n,)."""
    return np.abs(log.omega) > REST * log.fastest


def smooth(y: Array, t: Array, times: int = 1) -> Array:
    """Mean over so many times SLOW, three samples at least each, (n,)."""
    width = times * max(3, round(SLOW / float(np.median(np.diff(t)))) | 1) | 1
    return np.convolve(np.pad(y, width // 2, mode="edge"), np.full(width, 1.0 / width), mode="valid")


def motions_of(logs: Sequence[Dataset], model: Model, times: int = 1) -> list[Motion]:
    """Motion by differences of averages over so many times SLOW, and what of it the set has in common."""
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
    """Of each log: by what recalibration may change, inertia, drag, an offset, a spring and a weight."""
    columns = [
        np.column_stack([base, log.acceleration, log.omega, np.ones(len(log.q)), log.q, np.sin(log.q), np.cos(log.q)])
        for log, base in zip(logs, bases, strict=True)
    ]
    torque = np.concatenate([log.torque for log in logs])
    fitted = np.linalg.lstsq(np.concatenate(columns), torque, rcond=None)[0]
    return [each @ fitted for each in columns]


def _motion(log: Dataset, plain: bool, times: int) -> Motion:
    """Of one log; of a recorded velocity the angle is the integral."""
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
    """What Coulomb friction lacks that builds up exponentially over this share of the motion after each reversal."""
    distance = share * log.reach
    z, out = 0.0, np.empty(len(log.q))
    steps = np.abs(np.diff(log.q, prepend=log.q[0]))
    for at, (way, step) in enumerate(zip(np.sign(log.omega).tolist(), steps.tolist(), strict=True)):
        z = way + (z - way) * math.exp(-step / distance)
        out[at] = z
    return log.friction * (out * np.abs(direction(log)) - direction(log))


def late(log: Motion, delay: float) -> Array:
    """What a torque changes that is shown so many seconds late."""
    return np.asarray(np.interp(log.t - delay, log.t, log.torque) - log.torque)


def cycles(log: Motion) -> float:
    """Whole cycles of a ripple per turn: four or more in the motion of the set."""
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
    """The columns that were measured."""
    return {name: values for name, values in log.columns.items() if name not in log.derived}


def base_of(log: Motion, model: Model) -> Array:
    """What recalibration may change, (n, k)."""
    sigma = np.sign(log.omega)
    if not isinstance(model, RigidDrive):
        return np.column_stack([log.tau_m, sigma])
    free = {"inertia": log.acceleration, "viscous_friction": log.omega, "torque_offset": np.ones_like(sigma)}
    return np.column_stack([sigma, *(column for name, column in free.items() if getattr(model, name) is not None)])


def left_of(change: Sequence[Array], base: Sequence[Array]) -> float:
    """RMS of a change over all logs once the base model is projected out, N*m."""
    whole, columns = np.concatenate(change), np.concatenate(base)
    return float(np.sqrt(np.mean((whole - columns @ np.linalg.lstsq(columns, whole, rcond=None)[0]) ** 2)))


def size_of(hidden: Hidden, logs: Sequence[Motion], base: Sequence[Array], number: float) -> float:
    """The size of an effect with this number, N*m."""
    changes = [hidden.change(replace(log, torque=log.explained), number)[moving(log)] for log in logs]
    return left_of(changes, [columns[moving(log)] for log, columns in zip(logs, base, strict=True)])


def number_of(hidden: Hidden, logs: Sequence[Motion], base: Sequence[Array], size: float) -> float | None:
    """The number of an effect with which it has `size`, N*m; None where no number in its range does."""

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
    """The logs with an effect of this size (N*m) in them, and its number.

    None if no effect of that size exists, or if it would follow the velocity noise (acceleration at steady speed).
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
    """Whether most of the change is another one when the motion is averaged longer."""
    change, other = (np.concatenate([hidden.change(each, 1.0) for each in logs]) for logs in (motions, coarser))
    return float(np.sum((change - other) ** 2)) > (MOST_BLURRED**2) * float(np.sum(change**2))
