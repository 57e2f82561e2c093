"""Search for the set-point that separates hypotheses best, within the limits of the rig.

The search maximises the T-optimality criterion (Atkinson and Fedorov, Biometrika 62, 1975). The criterion is the
difference between the predictions of the leading and of a competing hypothesis, after the parameters of the competing
hypothesis were fitted to that difference. The competing hypothesis must also fit the present logs, which limits its
parameters. Differences are divided by the noise, and correlated samples are counted once.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.investigate.response import Joint, JointModel, Motion, gear_of
from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.signals import Signals
from tsa_ctrl.tune.excitation import RATE, Bounds, Waveform, fading

Array = NDArray[np.float64]

SECONDS = 20.0  # s, default duration of one motion: some periods of the slowest sine
DRAWS = 48  # random waveforms that are tried before the best ones are refined
REFINED, EVALUATIONS = 3, 30  # refined waveforms, and evaluations for each of them: a search takes some seconds
FIRST_STEP, SHRINK = 0.2, 0.93  # first step as a share of a number's range, and its factor: down to a fortieth
SLOWEST, FASTEST = 0.08, 2.5  # Hz, range of the waves: one and a half periods in SECONDS, and a joint's bandwidth
SCALINGS, BELOW = 3, 0.95  # attempts to scale a waveform down, each to 95 % of the limit
HEADROOM = 0.8  # share of speed and travel that a prediction may use, because it is for a model and not for the joint
LEAST_TORQUE = 0.05  # share of the permitted torque: an experiment with less shows nothing
EVERY = 0.04  # s between samples of the criterion: ten in a period of the fastest wave
REMEMBERS = 5.0  # samples (0.2 s) that count as one, because model errors change slowly
CHANGE = 1e-3  # relative step of the finite differences for the parameters of a competing hypothesis


@dataclass(frozen=True)
class Experiment:
    """Hold a set-point, its predicted motion, and the separation of each pair of names in standard deviations."""

    waveform: Waveform
    motion: Motion
    separation: Mapping[tuple[str, str], float]


@dataclass(frozen=True)
class Pair:
    """Hold two hypotheses, as models, that the present logs do not separate."""

    names: tuple[str, str]
    leading: JointModel
    rival: JointModel


@dataclass(frozen=True)
class _Known:
    """Hold the differences between the two models of a pair on the present logs, divided by the noise.

    Attributes:
        difference: difference of the predictions, (n,).
        gradients: derivatives of the competing hypothesis by its parameters, (n, k).
        left: sum of squares of the difference that these parameters cannot remove.
    """

    difference: Array
    gradients: Array
    left: float


class Designer:
    """Search for the set-point that separates `pairs` best, on a joint and within bounds."""

    def __init__(
        self,
        joint: Joint,
        bounds: Bounds,
        logs: Sequence[Dataset],
        noise: float,
        seed: int,
        seconds: float = SECONDS,
    ) -> None:
        """`noise`: RMS error of the leading hypothesis, N*m. `seconds`: duration of the motion."""
        self._seconds = seconds
        self._joint = joint
        self._bounds = bounds
        self._noise = max(noise, 1e-9)
        self._rng = np.random.default_rng(seed)
        self._past = [_thinned(log.completed_for(joint.model).signals(), EVERY) for log in logs]

    def best(self, pairs: Sequence[Pair]) -> Experiment:
        """Return the best experiment; without pairs, one that covers speeds, loads and angles evenly."""
        known = [self._known(pair) for pair in pairs]

        def value(u: Array) -> float:
            experiment = self._experiment(u, pairs, known)
            if experiment is None:
                return 0.0
            return -_benefit(experiment) if pairs else -_coverage(experiment.motion)

        draws = [(value(u), u) for u in self._rng.uniform(size=(DRAWS, SIZE))]
        refined = [self._refined(value, *start) for start in sorted(draws, key=lambda each: each[0])[:REFINED]]
        experiment = self._experiment(min(refined, key=lambda each: each[0])[1], pairs, known)
        if experiment is None:
            raise UsageError(
                "investigate: no set-point keeps the joint within its limits of speed and travel; raise --speed, widen "
                "--travel, or lower --torque"
            )
        return experiment

    def _refined(self, value: Callable[[Array], float], best: float, u: Array) -> tuple[float, Array]:
        """Return the point after random steps; the step size decreases after each failed step."""
        step = FIRST_STEP
        for _ in range(EVALUATIONS):
            tried = np.clip(u + step * self._rng.standard_normal(SIZE), 0.0, 1.0)
            if (found := value(tried)) < best:
                best, u = found, tried
            else:
                step *= SHRINK
        return best, u

    def _experiment(self, u: Array, pairs: Sequence[Pair], known: Sequence[_Known]) -> Experiment | None:
        """Return the experiment of a point, scaled down to the limits; None if hardly any torque remains."""
        shape = _shape(u, self._seconds)
        share = 1.0
        for _ in range(SCALINGS):
            waveform = Waveform(shape.t, share * self._bounds.torque * shape.tau_j_des)
            motion = self._joint.predict(waveform)
            excess = self._excess(motion)
            if excess <= 1.0:
                break
            share *= BELOW / excess
        else:
            return None
        if share < LEAST_TORQUE:
            return None
        signals = _thinned(_signals(motion, self._joint.model, self._past[0]), EVERY)
        separation = {
            pair.names: self._separation(pair, signals, past) for pair, past in zip(pairs, known, strict=True)
        }
        return Experiment(waveform, motion, separation)

    def _excess(self, motion: Motion) -> float:
        """Return the largest ratio of motion to limit; 0 for a joint that is moved from outside."""
        if not self._joint.driven:
            return 0.0
        out = float(np.max(np.abs(motion.omega_j))) / (HEADROOM * self._bounds.speed)
        if self._bounds.travel is not None:
            middle, half = np.mean(self._bounds.travel), 0.5 * float(np.ptp(self._bounds.travel))
            out = max(out, float(np.max(np.abs(motion.q_j - middle))) / (HEADROOM * half))
        return out

    def _known(self, pair: Pair) -> _Known:
        parts = zip(*(self._compared(pair, signals) for signals in self._past), strict=True)
        difference, gradients = (np.concatenate(part) for part in parts)
        return _Known(difference, gradients, _left(difference, gradients))

    def _compared(self, pair: Pair, signals: Signals) -> tuple[Array, Array]:
        rival = predict(pair.rival, signals)
        difference = (predict(pair.leading, signals) - rival) / self._noise
        changed = [predict(model, signals) - rival for model in variations(pair.rival)]
        gradients = np.column_stack(changed) / (CHANGE * self._noise) if changed else np.zeros((len(rival), 0))
        return difference, gradients

    def _separation(self, pair: Pair, signals: Signals, past: _Known) -> float:
        difference, gradients = self._compared(pair, signals)
        every = np.concatenate([past.difference, difference]), np.concatenate([past.gradients, gradients])
        return math.sqrt(max(_left(*every) - past.left, 0.0) / REMEMBERS)


SIZE = 8  # numbers that describe a waveform, each 0 to 1


def _shape(u: Array, seconds: float) -> Waveform:
    """Return a waveform with peak 1: two waves between sine and square, an offset, and a slow amplitude modulation.

    u contains the two frequencies, the share of the second wave, the squareness, the offset, the depth and rate of the
    modulation, and the phase, each from 0 to 1.
    """
    t = np.arange(0.0, seconds + 0.5 / RATE, 1.0 / RATE)
    low, high = (SLOWEST * (FASTEST / SLOWEST) ** float(part) for part in (0.55 * u[0], 0.35 + 0.65 * u[1]))
    sharp = 1.0 + 9.0 * float(u[3]) ** 2
    first = np.sin(2.0 * math.pi * low * t)
    first = np.tanh(sharp * first) / math.tanh(sharp)
    second = np.sin(2.0 * math.pi * high * t + 2.0 * math.pi * float(u[7]))
    wave = (1.0 - u[2]) * first + u[2] * second
    swell = 1.0 - u[5] * 0.5 * (1.0 + np.cos(2.0 * math.pi * (1.0 + 3.0 * u[6]) * t / seconds))
    wave = wave * swell + (2.0 * u[4] - 1.0)
    wave = wave * fading(t)
    return Waveform(t, wave / max(float(np.abs(wave).max()), 1e-12))


def _benefit(experiment: Experiment) -> float:
    """Return the value of an experiment: the smallest log(1 + separation) plus a tenth of the sum of all."""
    sizes = [math.log1p(size) for size in experiment.separation.values()]
    return min(sizes) + 0.1 * sum(sizes)


def _coverage(motion: Motion) -> float:
    """Return the coverage of speed, torque and angle: the entropy of their histogram plus a little for the speed."""
    columns = np.column_stack([motion.omega_j, motion.tau_m, motion.q_j])[:: round(EVERY / (motion.t[1] - motion.t[0]))]
    span = np.maximum(np.abs(columns).max(axis=0), 1e-9)
    counts = np.histogramdd(columns / span, bins=(6, 6, 4))[0].ravel()
    shares = counts[counts > 0.0] / counts.sum()
    return float(-np.sum(shares * np.log(shares))) + 0.1 * math.log(float(np.std(motion.omega_j)) + 1e-9)


def variations(model: JointModel) -> list[JointModel]:
    """Return the model with one parameter slightly changed, for each parameter of the base model and the effects."""
    out: list[JointModel]
    if isinstance(model, TendonSheath):
        out = [
            model.recalibrated(friction_angle=model.friction_angle * math.exp(CHANGE)),
            model.recalibrated(pretension=model.pretension * math.exp(CHANGE)),
        ]
    else:
        base = {name: getattr(model, name) for name in ("efficiency", "coulomb_friction", "viscous_friction")}
        changed = {name: value * (1.0 - CHANGE) for name, value in base.items() if value}  # efficiency is at most 1
        out = [dataclasses.replace(model, **{name: value}) for name, value in changed.items()]
    for name, parameters in model.effects.items():
        for key, value in parameters.items():
            parameter = CATALOGUE[name].parameter(key)
            if isinstance(value, float) and value != 0.0 and parameter.fitted and not parameter.integer:
                larger = value * (1.0 + CHANGE)
                if parameter.accepts(larger):
                    effects: Mapping[str, Mapping[str, object]] = {
                        **model.effects,
                        name: {**parameters, key: larger},
                    }
                    out.append(dataclasses.replace(model, effects=effects))
    return out


def _left(difference: Array, gradients: Array) -> float:
    """Return the sum of squares of the difference that no change of the parameters removes."""
    if not gradients.shape[1]:
        return float(difference @ difference)
    rest = difference - gradients @ np.linalg.lstsq(gradients, difference, rcond=1e-9)[0]
    return float(rest @ rest)


def _signals(motion: Motion, model: JointModel, like: Signals) -> Signals:
    """Return the predicted motion as a log with the columns of `like`, and with the other joints of the motion."""
    columns: dict[str, Array] = {"t": motion.t, "tau_m": motion.tau_m, "omega_j": motion.omega_j}
    gear = gear_of(model)
    moved = {"q_j": motion.q_j, "q_m": gear * motion.q_j, "omega_m": gear * motion.omega_j}
    columns |= {name: values for name, values in moved.items() if getattr(like, name) is not None}
    if like.theta is not None:
        columns["theta"] = np.full_like(motion.t, float(np.mean(like.theta)))
    if like.temperature is not None:
        columns["temperature"] = np.full_like(motion.t, float(like.temperature[-1]))
    return Signals(**columns, joints=motion.joints)


def _thinned(signals: Signals, every: float) -> Signals:
    """Return the signals reduced to one sample every `every` seconds."""
    step = max(1, round(every / signals.period))
    columns = {entry.name: getattr(signals, entry.name) for entry in dataclasses.fields(signals)}
    joints = {name: angle[::step] for name, angle in columns.pop("joints").items()}
    return Signals(**{name: values[::step] for name, values in columns.items() if values is not None}, joints=joints)
