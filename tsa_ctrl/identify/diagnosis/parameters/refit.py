"""Fit the reported parameters by least squares on the simulation error, with intervals.

Whitened fits are the more sensitive test, but they weight the frequencies by the noise. The error that matters to a
user has other frequencies. Parameters from a whitened fit can lose the whole gain, so the causes are refitted on the
simulation error.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.criteria import BY_NOISE, MOST_SPREAD
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, fit, gradients
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import models_reversals, on_simulation_error
from tsa_ctrl.identify.diagnosis.hypotheses.base import Base
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import Catalogue
from tsa_ctrl.identify.diagnosis.selection.meaning import meaningless
from tsa_ctrl.identify.diagnosis.selection.step import companion_steps
from tsa_ctrl.identify.quantity import NOISE, Quantity, half_width
from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.effects.search import Value
from tsa_ctrl.model.effects.specification import Parameter
from tsa_ctrl.model.functions import Array

# Largest step of a base coordinate whose deviation is unknown: a tenth of x or T_p, within which quantities are still
# linear
WIDEST_STEP = 0.1
STEP = 0.05  # step for derivatives of parameters, as a share of a standard deviation
# Largest half interval of the logarithm of a positive number: with a factor of 150 either way, not even its order of
# magnitude is known.
WIDEST_RATIO = 5.0
COMBINATIONS = ("slope", "half_loop_torque")  # combinations of x and T_p that logs of one configuration determine


@dataclass(frozen=True)
class Refit:
    """Fit on the simulation error with the covariance of its coordinates.

    Attributes:
        fitted: the fit.
        covariance: covariance of the coordinates, (p, p). It is 0 for coordinates of effects that a bound holds.
        factor: ratio of an interval's half width to the standard deviation (Student's t).
        structured: True if the residual is more than noise, so that passes over the same motion add no information.
        learned: least-squares coordinates, (p,), if `fitted` moves x and T_p together from the file's values
            (`proportion`); otherwise None. Slope and friction torque are computed from these coordinates, because the
            logs determine only these two combinations.
        companions: fits with the companion of an effect (catalogue) by the name of the effect, if the logs do not show
            the companion. The intervals of this effect's parameters include the intervals of these fits.
    """

    fitted: Fit
    covariance: Array
    factor: float
    structured: bool = False
    learned: Array | None = None
    companions: Mapping[str, Sequence[Refit]] = field(default_factory=dict)

    def quantity(self, value: float, variance: float, unit: str, low: float, high: float) -> Quantity:
        """Return a derived value with its interval, limited to `low` .. `high`.

        A positive value with a wide interval is treated as log-normal.
        """
        half = self.factor * math.sqrt(max(variance, 0.0))
        if low >= 0.0 and value > 0.0 and half > 0.2 * value:
            ratio = math.exp(min(half / value, WIDEST_RATIO))
            return Quantity(value, max(value / ratio, low), min(value * ratio, high), unit)
        return Quantity(value, max(value - half, low), min(value + half, high), unit)


def refit(problem: Problem, found: Fit, structured: bool = False) -> Refit:
    """Return the fit of the same hypothesis on the simulation error, started at `found`.

    `structured` has the same meaning as in `Refit`.
    """
    plain = on_simulation_error(problem, models_reversals(found))
    best = _nearest_to_nominal(plain, fit(plain, found.hypothesis, found.point))
    count = len(best.point)
    covariance = np.zeros((count, count))
    index = _freed(best)
    if index.size and plain.count:
        jacobian = gradients(plain, best)[:, index]
        covariance[np.ix_(index, index)] = _covariance(problem, plain, best, jacobian, structured)
        free, precision = undetermined(jacobian), _precision(best)[index]
        held = free.T * precision @ free
        covariance[np.ix_(index, index)] += free @ np.linalg.pinv(held, rcond=RANK) @ free.T
    return Refit(best, covariance, half_width(NOISE), structured)


# Logs of one configuration do not determine all of x, T_p and the torque gain: some direction of the coordinates
# changes nothing. Least squares then ends anywhere along it, and its variance by least squares is 0. There the model
# file decides, whose [uncertainty] is an interval of 95 %.
RANK = 1e-10  # ratio of the eigenvalues of J'J, in units of each coordinate, below which a direction changes nothing
NEARER = 3  # steps towards the file's values: the direction is curved


def _freed(found: Fit) -> NDArray[np.int64]:
    """Return the indices of the base coordinates and of all coordinates that no bound holds.

    A bound does not determine x and T_p.
    """
    base = len(found.hypothesis.base.coordinates())
    return np.flatnonzero(found.free | (np.arange(len(found.point)) < base))


def _precision(found: Fit) -> Array:
    """Return the inverse variance of each coordinate by the model file, (p,); 0 without a bound."""
    base = np.arange(len(found.point)) < len(found.hypothesis.base.coordinates())
    half = 0.5 * (found.hypothesis.high - found.hypothesis.low)
    return np.where(base, (half_width(NOISE) / half) ** 2, 0.0)


def undetermined(jacobian: Array) -> Array:
    """Return the directions (p, k) of the coordinates that do not change the prediction; `jacobian` is (m, p)."""
    size = np.linalg.norm(jacobian, axis=0)
    known = size > 0.0
    values, vectors = np.linalg.eigh((jacobian[:, known] / size[known]).T @ (jacobian[:, known] / size[known]))
    out = np.zeros((len(size), int(np.sum(values < RANK * values[-1:]))))
    out[known] = vectors[:, values < RANK * values[-1:]] / size[known, None]
    return out


def _nearest_to_nominal(problem: Problem, found: Fit) -> Fit:
    """Return the fit with the same error whose base is nearest to the file's values."""
    base = found.hypothesis.base.start()
    for _ in range(NEARER):
        index = _freed(found)
        free = undetermined(gradients(problem, found)[:, index]) if index.size and problem.count else np.zeros((0, 0))
        if not free.shape[1]:
            break
        precision = _precision(found)[index]
        away = np.zeros(len(found.point))
        away[: len(base)] = found.point[: len(base)] - base
        back = free @ np.linalg.pinv(free.T * precision @ free, rcond=RANK) @ (free.T * precision @ away[index])
        point = found.point.copy()
        point[index] -= back
        nearer = fit(problem, found.hypothesis, point)
        if nearer.rss > found.rss + BY_NOISE:
            break
        found = nearer
    return found


def with_companions(problem: Problem, result: Refit, catalogue: Catalogue) -> Refit:
    """Return `result` with the fits that have the companion of one of its effects.

    A minimum counts unless its error exceeds the smallest one by more than noise can.
    """
    found: dict[str, list[Refit]] = {}
    for name, fits in companion_steps(problem, result.fitted, catalogue).items():
        least = min((each.rss for each in fits), default=0.0)
        near = [each for each in fits if each.rss < least + BY_NOISE and not meaningless(problem, each)]
        found[name] = [refit(problem, each, result.structured) for each in near]
    return dataclasses.replace(result, companions=found)


def _covariance(problem: Problem, plain: Problem, best: Fit, jacobian: Array, structured: bool) -> Array:
    """Return the covariance (k, k) of the coordinates of `jacobian` (m, k) under coloured noise.

    The standard deviations are widened if blocks differ by more than that noise, by a factor of at most MOST_SPREAD. A
    log has few blocks that are longer than its slow noise, so blocks alone would underestimate the uncertainty. With
    `structured`, states of motion are clusters as well.
    """
    bread = np.asarray(np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-10), dtype=np.float64)
    columns = np.zeros((len(plain.frame), jacobian.shape[1]))
    columns[plain.mask] = jacobian
    coloured = bread @ problem.noise.spread(columns, plain.frame.slices) @ bread / plain.noise.rms**2
    number = int(plain.blocks[-1]) + 1
    scores = np.zeros((number, jacobian.shape[1]))
    np.add.at(scores, plain.blocks, jacobian * best.residual[:, None])
    blocked = bread @ (scores.T @ scores * number / max(number - 1, 1)) @ bread
    ratio = np.diag(blocked) / np.maximum(np.diag(coloured), 1e-300)
    wider = np.sqrt(np.clip(ratio, 1.0, MOST_SPREAD**2))
    covariance = np.asarray(coloured * np.outer(wider, wider))
    return widened(covariance, jacobian @ bread, best.residual, states_of(plain)) if structured else covariance


def effect_quantities(result: Refit) -> dict[str, dict[str, Quantity | str]]:
    """Return the parameters of each effect with intervals, in the units of model files.

    The interval is infinite if these logs do not determine the parameter.
    """
    out = _own_quantities(result)
    for effect, others in result.companions.items():
        for other in others:
            wider = _own_quantities(other)[effect]
            for name, own in out[effect].items():
                more = wider.get(name)
                if isinstance(own, Quantity) and isinstance(more, Quantity):
                    low, high = min(own.low, more.low), max(own.high, more.high)
                    out[effect][name] = dataclasses.replace(own, low=low, high=high)
    return out


def _own_quantities(result: Refit) -> dict[str, dict[str, Quantity | str]]:
    """Return the result of `effect_quantities` without companions."""
    out: dict[str, dict[str, Quantity | str]] = {}
    hypothesis, point = result.fitted.hypothesis, result.fitted.point
    for variant, place in zip(hypothesis.variants, hypothesis.places, strict=True):
        index = np.arange(place.start, place.stop)
        values = variant.parameters(point[index])
        slopes = _gradients(result, variant.parameters, point[index], index)
        spread = result.covariance[np.ix_(index, index)]
        entry: dict[str, Quantity | str] = {}
        spec = CATALOGUE[variant.effect]
        others = [name for name in values if spec.named and name not in {p.name for p in spec.parameters}]
        for parameter in (*spec.parameters, *map(spec.parameter, others)):
            value = values.get(parameter.name)
            if value is None:
                continue
            if isinstance(value, str):
                entry[parameter.name] = value
                continue
            if parameter.name in variant.unidentifiable:
                entry[parameter.name] = Quantity(float(value), -math.inf, math.inf, parameter.unit)
                continue
            gradient = slopes.get(parameter.name, np.zeros(len(index)))
            variance = float(gradient @ spread @ gradient)
            low, high = (-math.inf, math.inf) if parameter.name == "phase" else (parameter.low, parameter.high)
            found = result.quantity(float(value), variance, parameter.unit, low, high)
            if not _told(found, parameter):
                found = Quantity(found.value, -math.inf, math.inf, found.unit)
            entry[parameter.name] = found
        if others:  # of equal rank: the clearest value is the main one
            entry = dict(sorted(entry.items(), key=lambda item: _doubt(item[1])))
        out[variant.effect] = entry
    return out


def _doubt(found: Quantity | str) -> float:
    """Return the half width of an interval relative to the value, 1; infinity if it has none."""
    return abs(found.share) if isinstance(found, Quantity) and found.value else math.inf


def _told(found: Quantity, parameter: Parameter) -> bool:
    """Return True if the interval excludes a possible value of the parameter.

    The interval of a phase must be narrower than a full turn. Any other interval must be narrower than the range of the
    parameter, and for a positive value also narrower than the ratio WIDEST_RATIO.
    """
    if parameter.name == "phase":
        return found.high - found.low < 2.0 * math.pi
    if found.low <= parameter.low and found.high >= parameter.high:
        return False
    return not (0.0 < found.low < found.value and math.log(found.value / found.low) >= WIDEST_RATIO * (1.0 - 1e-9))


def _gradients(
    result: Refit, parameters: Callable[[Array], dict[str, Value]], point: Array, index: NDArray[np.int64]
) -> dict[str, Array]:
    """Return d parameter / d coordinate, (k,) by name of the parameter.

    They are central differences with a step of a fraction of a standard deviation.
    """
    deviations = np.sqrt(np.maximum(np.diag(result.covariance)[index], 0.0))
    out: dict[str, Array] = {}
    for i, deviation in enumerate(deviations):
        step = max(STEP * float(deviation), 1e-9)
        up, down = point.copy(), point.copy()
        up[i] += step
        down[i] -= step
        above, below = parameters(up), parameters(down)
        for name, value in above.items():
            if isinstance(value, str):
                continue
            change = float(value) - float(below[name])
            if name == "phase":
                change = (change + math.pi) % (2.0 * math.pi) - math.pi
            out.setdefault(name, np.zeros(len(point)))[i] = change / (2.0 * step)
    return out


def base_quantities(result: Refit) -> dict[str, tuple[float, Quantity]]:
    """Return the nominal value and the quantity of each parameter and combination of the base model, by name."""
    base = result.fitted.hypothesis.base
    count = len(base.coordinates())
    spread = result.covariance[:count, :count]
    kept = _about(base, result.fitted.point[:count], spread)
    learned = kept if result.learned is None else _about(base, result.learned[:count], spread)
    out = {}
    for name in kept:
        nominal, value, unit, gradient = (learned if name in COMBINATIONS else kept)[name]
        low = -math.inf if name == "torque_offset" else 0.0
        out[name] = (nominal, result.quantity(value, float(gradient @ spread @ gradient), unit, low, math.inf))
    return out


def _about(base: Base, point: Array, spread: Array) -> dict[str, tuple[float, float, str, Array]]:
    """Return nominal value, value, unit and gradient (k,) of the base model's quantities at `point` (k,), by name."""
    central = base.quantities(point)
    gradients = {name: np.zeros(len(point)) for name in central}
    for i in range(len(point)):
        step = min(max(STEP * math.sqrt(max(spread[i, i], 0.0)), 1e-7), WIDEST_STEP)
        up, down = point.copy(), point.copy()
        up[i] += step
        down[i] -= step
        above, below = base.quantities(up), base.quantities(down)
        for name in central:
            gradients[name][i] = (above[name][1] - below[name][1]) / (2.0 * step)
    return {name: (*central[name], gradients[name]) for name in central}


# If the residual is structured, a model error repeats in every pass over the same state of motion.
#
# Blocks of time contain the same motion, so this error does not scatter between them. Resampling blocks of time
# therefore widens no interval, even in a long log. For this reason samples at the same velocity and angle are one
# cluster as well (clusters in several directions: Cameron, Gelbach, Miller, J. Bus. Econ. Stat. 29, 2011). The interval
# has as many degrees of freedom as clusters that determine the parameter (Bell, McCaffrey, Surv. Methodol. 28, 2002).

# Halves of the velocity and quarters of the angle. An error varies smoothly over the motion, so smaller cells would
# duplicate each other. In 150 random trials with errors of a spring, friction and drag
# (tests/identify/diagnosis/parameters/test_passes), intervals over 8 cells contain the value in 92 to 94 % of cases,
# over 16 cells in 87 %, over 24 in 80 to 83 %, and in 12 % without cells. 6 cells are not better than 8.
VELOCITIES, ANGLES = 2, 4
LEAST_FREEDOM = 2.0  # degrees of freedom: t with one cluster is 12.7, which is of no use; with two it is 4.3
# Share of the largest variance, in units of each coordinate's standard deviation: a zero variance becomes this large by
# rounding
SINGULAR = 1e-12


def states_of(problem: Problem) -> NDArray[np.int64]:
    """Return the number of the state of motion of each sample that the fit uses, (m,)."""
    frame, used = problem.frame, problem.mask
    return states(frame.column("omega_j")[used], frame.stack([run.angle for run in frame.runs])[used])


def states(velocity: Array, angle: Array) -> NDArray[np.int64]:
    """Return the number of the cell of velocity and angle of each sample, (m,).

    `velocity` and `angle` have the shape (m,). The edges of the cells are quantiles of each signal.
    """
    cells = _quantile(velocity, VELOCITIES) * ANGLES + _quantile(angle, ANGLES)
    return np.asarray(np.unique(cells, return_inverse=True)[1], dtype=np.int64)


def widened(covariance: Array, influence: Array, residual: Array, cells: NDArray[np.int64]) -> Array:
    """Return the covariance (k, k) of coordinates, widened where the residual scatters more between cells.

    Only some directions become wider: a sum that the logs determine well keeps its interval, although its parts may
    replace each other.

    Args:
        covariance: covariance of the coordinates, (k, k).
        influence: d coordinates / d residual, (m, k).
        residual: residual, (m,).
        cells: number of the cell of each sample, (m,).
    """
    units = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(units, units))
    values = np.maximum(values, SINGULAR * values[-1])
    own = influence / units @ (vectors / np.sqrt(values))  # influence on the directions in which the covariance is 1
    number = int(cells.max(initial=0)) + 1
    scores = _summed(own * residual[:, None], cells, number)
    spread, turned = np.linalg.eigh(scores.T @ scores * number / max(number - 1, 1))
    told = _summed(np.square(own @ turned), cells, number)
    told /= np.maximum(np.max(told, axis=0, initial=0.0), 1e-300)  # This sum is huge for a nearly singular direction.
    freedom = np.sum(told, axis=0) ** 2 / np.maximum(np.sum(told**2, axis=0), 1e-300)
    wider = np.array([half_width(max(float(each), LEAST_FREEDOM)) / half_width(NOISE) for each in freedom])
    root = units[:, None] * (vectors * np.sqrt(values)) @ turned
    return np.asarray(root * np.maximum(spread * wider**2, 1.0) @ root.T)


def _summed(columns: Array, cells: NDArray[np.int64], number: int) -> Array:
    """Return the sums over cells, (number, k), of columns (m, k)."""
    total = np.zeros((number, columns.shape[1]))
    np.add.at(total, cells, columns)
    return total


def _quantile(y: Array, parts: int) -> NDArray[np.int64]:
    """Return the number of the quantile group of each sample, (m,); all `parts` groups have about equal size."""
    return np.asarray(np.searchsorted(np.quantile(y, np.arange(1, parts) / parts), y), dtype=np.int64)
