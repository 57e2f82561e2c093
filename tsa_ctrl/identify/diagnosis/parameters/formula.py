"""Describe the residual by a formula of the log's signals, for `[effects.custom]` of a model file.

The method is sparse regression by forward selection of terms (Brunton, Proctor, Kutz, PNAS 2016, use it for a whole
model). The causes are kept. Each term (`terms`; `memory_terms`) must remove a minimum share of the simulation
error on logs or blocks that it was not fitted on. The selected terms are fitted with their inner constants, such as the
position of a bump, the width of a dead zone or the time constant of a lag. A formula describes the residual but does
not identify a cause.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.diagnosis.criteria import CERTAIN, FOLDS, LEAST_GAIN, LEAST_SHARE, NEGLIGIBLE, ROUNDING
from tsa_ctrl.identify.diagnosis.data.split import Split
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem, orthonormal
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import fit_on_simulation_error, models_reversals
from tsa_ctrl.identify.diagnosis.parameters.formula_numbers import (
    CONSTANTS,
    TRIAL,
    Sought,
    refitted,
    regressed,
    tangents_of,
    with_custom,
)
from tsa_ctrl.identify.diagnosis.parameters.held_out import rms_over
from tsa_ctrl.identify.diagnosis.parameters.terms import CYCLES, FURTHER, Term, terms, time_terms
from tsa_ctrl.identify.quantity import Quantity, half_width
from tsa_ctrl.model.effects.custom import NAMES
from tsa_ctrl.model.expression import parse
from tsa_ctrl.model.filters import KINDS
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model
from tsa_ctrl.model.predict import predict_each

# Terms of the load with memory that a formula of the residual may have: they are searched on a grid, then refined.
#
# They describe a tendon that creeps or a slow torque sensor (`LAG`), a sensor that oscillates on its mount (`RING`),
# and a sensor with hysteresis (`DAHL`). One term of each kind is tried, with the constants that explain most of the
# residual. In this search the effect of a term on the prediction is linear in the load. The subsequent fit uses the
# model itself.

LAG, RING, DAHL = "(tau - lag(tau, {0}))", "(tau - ring(tau, {0}, {1}))", "dahl(tau, {0})"
# Shortest and longest time constant of a lag (s), and their number: from a sensor filter to the slowest creep that is
# visible in a log of a minute
TIMES = (0.02, 5.0, 9)
FREQUENCIES = (2.0, 25.0)  # Hz: slower changes are the motion itself, and faster ones are removed by denoising
FINE = 1.06  # ratio of two frequencies: within half of it, oscillations with a damping of 0.03 are still correlated
# Damping ratios: steel on a soft mount up to hardly any overshoot; values in between are found by refinement
DAMPINGS = (0.03, 0.1, 0.3)
FEWEST = 4.0  # score samples in a period of an oscillation
# Least and greatest hysteresis, as shares of the RMS torque, and their number. A wider hysteresis is indistinguishable
# from a straight line, and a narrower one from a dead zone
WIDTHS = (0.05, 1.6, 6)
HALVINGS = 6  # halvings of the distance between two grid points: the best point is then known to a hundredth of it


@dataclass(frozen=True)
class Grid:
    """Search grid of one kind of term.

    Attributes:
        kind: key of the filter's parameter bounds.
        text: template of the expression.
        places: grid points, each with the values of all inner constants.
        apart: ratio of two neighbouring values, one for each inner constant.
    """

    kind: str
    text: str
    places: Sequence[tuple[float, ...]]
    apart: tuple[float, ...]

    def inside(self, numbers: Array) -> tuple[float, ...]:
        """Return the numbers within their bounds, with room for one step of the numerical derivative."""
        bounds = zip(numbers.tolist(), KINDS[self.kind], strict=True)
        return tuple(min(max(number, bound.low), bound.high / (1.0 + 2.0 * TRIAL)) for number, bound in bounds)

    def term(self, place: tuple[float, ...]) -> Term:
        """Return a term whose inner constants start at this grid point."""
        ends = (self.inside(np.array(place) * factor) for factor in (1.0 / FURTHER, FURTHER))
        return Term((self.text,), place, *ends)


def memory_terms(
    problem: Problem, model: Model, fitting: NDArray[np.bool_], residual: Array, others: Array
) -> list[Term]:
    """Return the term of each kind that explains most of the residual in addition to other columns.

    A kind is omitted if none of its grid points explains anything.

    Args:
        problem: the logs with the noise model.
        model: the model whose residual is described.
        fitting: samples to fit on, (n,).
        residual: residual of the model, (n,) N*m.
        others: columns that are fitted together with the term, (n, k).
    """
    column = _columns(problem, model)
    basis = orthonormal(others[fitting])
    left = residual[fitting] - basis @ (basis.T @ residual[fitting])

    def taken(text: str, place: tuple[float, ...]) -> float:
        """Return the part of the sum of squares that the term explains, (N*m)^2."""
        own = column(text.format(*place))[fitting]
        whole = float(own @ own)
        beside = whole - float(np.sum(np.square(basis.T @ own)))  # the part of `whole` that is orthogonal to the others
        return float((own @ left) ** 2 / beside) if beside > NEGLIGIBLE * whole else 0.0

    out = []
    for grid in _grids(problem):
        gains = [taken(grid.text, place) for place in grid.places]
        if not gains or max(gains) <= 0.0:
            continue
        best, place = max(zip(gains, grid.places, strict=True))
        steps = np.log(grid.apart)
        for _ in range(HALVINGS):
            steps = 0.5 * steps
            for other in _around(grid, place, steps):
                gained = taken(grid.text, other)
                if gained > best:
                    best, place = gained, other
        out.append(grid.term(place))
    return out


def _grids(problem: Problem) -> list[Grid]:
    """Return the grids of all terms that these logs are long enough to show."""
    frame = problem.frame
    seconds = max(part.stop - part.start for part in frame.slices) * frame.period
    low, high, count = TIMES
    times = [(float(T),) for T in np.geomspace(low, high, count) if seconds > CYCLES * T]
    out = [Grid("lag", LAG, times, ((high / low) ** (1.0 / (count - 1)),))]
    low, high = FREQUENCIES
    high = min(high, 1.0 / (FEWEST * frame.period))
    number = int(np.log(high / low) / np.log(FINE)) + 1 if high > low else 0
    rings = [(float(low * FINE**k), damping) for k, damping in product(range(number), DAMPINGS)]
    out.append(Grid("ring", RING, rings, (FINE, DAMPINGS[1] / DAMPINGS[0])))
    scale = float(np.sqrt(np.mean(np.square(frame.target[problem.mask]))))
    low, high, count = WIDTHS
    widths = [(float(w) * scale,) for w in np.geomspace(low, high, count)] if scale > 0.0 else []
    out.append(Grid("dahl", DAHL, widths, ((high / low) ** (1.0 / (count - 1)),)))
    return out


def _columns(problem: Problem, model: Model) -> Callable[[str], Array]:
    """Return a function from a term to its effect on the prediction, (n,) N*m per unit of its coefficient."""
    frame, sign = problem.frame, 1.0 if model.target == "tau_m" else -1.0
    signals = [run.signals for run in frame.runs]
    bearing = with_custom(model, {"expression": "tau", "stage": "joint"})
    pairs = zip(predict_each(model, signals), predict_each(bearing, signals), strict=True)
    loads = [sign * (after - before) for before, after in pairs]

    def column(text: str) -> Array:
        program = parse(text, ("tau",), {}, "formula")
        return sign * frame.stack([program.over([load], each.t) for load, each in zip(loads, signals, strict=True)])

    return column


def _around(grid: Grid, place: tuple[float, ...], steps: Array) -> Iterator[tuple[float, ...]]:
    for i, side in product(range(len(steps)), (1.0, -1.0)):
        factors = np.ones(len(steps))
        factors[i] = np.exp(side * steps[i])
        yield grid.inside(np.array(place) * factors)


MOST_TERMS = 3  # largest number of terms that a reader recognises as a law; a wave with its phase is one term
# The same for a formula of the time: steps and exponentials fit a third of any random walk
LEAST_IN_TIME = 0.5


LIMITED = ("omega_j", "q_j", "q_m", "tau", "temperature")  # signals that have a range; a direction and a time have none
TIME = re.compile(r"\bt\b")


@dataclass(frozen=True)
class Formula:
    """Formula f = `expression`: tau_J -= f, or tau_M += f for a plain drive.

    Attributes:
        expression: the formula without the ranges of its signals.
        constants: constants of the formula with their 95 % intervals.
        model: the model with the formula, all other parameters refitted.
        gain: share of the residual's mean square on held-out data that the formula removes.
        rms: RMS error on held-out data without and with the formula, N*m at the logs' own rate.
        better: number of held-out logs that the formula improves.
        logs: number of held-out logs.
        terms: number of terms; a wave with its phase is one term.
        ranges: lowest and highest value of each signal of the formula in these logs. Beyond them `limited` and `toml`
            fade the formula out.
    """

    expression: str
    constants: Mapping[str, Quantity]
    model: Model
    gain: float
    rms: tuple[float, float]
    better: int
    logs: int
    terms: int
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def ranged(self) -> str:
        """Return the expression limited to the signal ranges in which it was learned."""
        return _within(self.expression, self.ranges)

    @property
    def limited(self) -> Model:
        """Return the model in which the formula applies only within its ranges."""
        return with_custom(self.model, {**self.model.effects["custom"], "expression": self.ranged})

    @property
    def tells_when(self) -> bool:
        """Return True if the formula contains the time of the logs.

        It then describes when something happened in these logs and is not a law of the drive.
        """
        return TIME.search(self.expression) is not None

    def toml(self) -> str:
        """Return the formula as the table `[effects.custom]` of a model file."""
        lines = [
            f'expression = "{self.ranged}"',
            *(f"{name} = {_exact(q)}" for name, q in self.constants.items()),
        ]
        return "\n".join(["[effects.custom]", *lines])


def _within(expression: str, ranges: Mapping[str, tuple[float, float]]) -> str:
    factors = [f"inside({name}, {low:.4g}, {high:.4g})" for name, (low, high) in ranges.items()]
    return "*".join([f"({expression})", *factors]) if factors else expression


def _ranges(
    problem: Problem, expression: str, predicted: Array, mask: NDArray[np.bool_]
) -> dict[str, tuple[float, float]]:
    """Return the lowest and highest value of each signal of the formula over the samples of `mask` (n,).

    Constant signals and signals that the logs lack are omitted.
    """
    program = parse(expression, NAMES, dict.fromkeys(CONSTANTS, 1.0), "formula")
    out = {}
    for name in LIMITED:
        if not program.uses(name) or not (name == "tau" or problem.frame.has(name)):
            continue
        values = (predicted if name == "tau" else problem.frame.column(name))[mask]
        if np.ptp(values) > 0.0:
            out[name] = (float(values.min()), float(values.max()))
    return out


def _exact(q: Quantity) -> str:
    """Return the value as text, with digits down to a hundredth of its interval, and at least six digits.

    An absolute time needs more than six digits.
    """
    span = q.high - q.low
    digits = math.ceil(math.log10(abs(q.value) / span)) + 3 if span > 0.0 and q.value != 0.0 else 6
    return f"{q.value:.{max(6, min(digits, 15))}g}"


def formula_of_what_is_left(problem: Problem, found: Fit, split: Split) -> Formula | None:
    """Return a formula that describes the residual of `found` on held-out data as well as on fitted data.

    The result is None if no short formula does so, or if the model already has a formula.
    """
    learned = fit_on_simulation_error(problem, found, mask=split.fit)
    model = learned.hypothesis.model(learned.point)
    if "custom" in model.effects:
        return None
    predicted = problem.predicted(model)
    residual = problem.frame.target - predicted
    fitting = with_direction(problem, found, split.fit & problem.mask)
    blocks = np.unique(split.frame.blocks[fitting], return_inverse=True)[1]
    tangents = tangents_of(problem, learned, learned.point, {}, predicted)[:, learned.free]
    asked = [
        *terms(problem, model, predicted),
        *memory_terms(problem, model, fitting, residual, tangents),
        *time_terms(problem, predicted, fitting, residual, tangents),
    ]
    parts, columns, units = _responses(problem, model, asked, predicted)
    folds = _folds(problem, fitting, blocks)
    chosen = _selected(columns[fitting], residual[fitting], folds, tangents[fitting], units)
    while chosen:
        both = np.column_stack([tangents, columns[:, chosen]])
        values, deviations = regressed(both[fitting], residual[fitting], blocks)
        sure = (np.abs(values) / np.maximum(deviations, 1e-300))[tangents.shape[1] :]
        if np.all(sure >= CERTAIN):
            break
        del chosen[int(np.argmin(sure))]  # for example the sine or cosine that a wave's phase does not need
    if not chosen:
        return None
    sought = Sought.of([parts[i] for i in chosen], values[tangents.shape[1] :])
    point, constants = refitted(problem, learned, sought, fitting)
    described = with_custom(learned.hypothesis.model(point), sought.custom(constants))
    simulated = problem.predicted(described)
    inside = (point > learned.hypothesis.low) & (point < learned.hypothesis.high)
    every = tangents_of(problem, learned, point, sought.custom(constants), simulated)[:, inside]
    both = np.column_stack([every, sought.tangents(problem, learned.hypothesis.model(point), constants, simulated)])
    spread = regressed(both[fitting], (problem.frame.target - simulated)[fitting], blocks)[1][every.shape[1] :]
    after = problem.frame.target - simulated
    held = [part for part in problem.frame.slices if split.held[part].any()]
    sums = np.array([[float(np.sum(y[part][split.held[part]] ** 2)) for y in (residual, after)] for part in held])
    before, left = sums.sum(axis=0)
    better = int(np.sum(sums[:, 1] < sums[:, 0]))
    least = LEAST_IN_TIME if TIME.search(sought.expression) else LEAST_GAIN
    if not left < (1.0 - least) * before or 2 * better <= len(held):
        return None
    half = half_width(max(int(blocks[-1]), 1)) * spread
    told = zip(sought.names, constants, half, strict=True)
    ranges = _ranges(problem, sought.expression, simulated, fitting)
    limited = {**sought.custom(constants), "expression": _within(sought.expression, ranges)}
    try:
        with_custom(learned.hypothesis.model(point), limited)
    except UsageError:  # The formula is too long with its ranges.
        ranges = {}
    return Formula(
        sought.expression,
        {name: Quantity(float(v), float(v - h), float(v + h), "1") for name, v, h in told},
        described,
        gain=float(1.0 - left / before),
        rms=(rms_over(problem.frame, model, split.held), rms_over(problem.frame, described, split.held)),
        better=better,
        logs=len(held),
        terms=sum(not set(unit).isdisjoint(chosen) for unit in units),
        ranges=ranges,
    )


def with_direction(problem: Problem, found: Fit, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the samples of `mask` (n,) at which the direction of motion is known.

    If these are at most half of its samples, `mask` is returned unchanged. With the wrong sign, a sample has an error
    of twice the friction, which is hundreds of times the contribution of a formula.
    """
    known = mask if models_reversals(found) else mask & problem.nuisance.told(len(mask))
    return known if 2 * int(known.sum()) > int(mask.sum()) else mask


def _responses(
    problem: Problem, model: Model, asked: Sequence[Term], predicted: Array
) -> tuple[list[tuple[Term, int]], Array, list[tuple[int, ...]]]:
    """Return the parts of all terms, their responses, and the numbers of the parts of each term.

    A part is given by its term and its index in that term. A response is the change of the prediction per unit of the
    part's coefficient, (n, parts) in N*m at the score rate. Parts that cannot be computed or have no effect are
    omitted.
    """
    parts: list[tuple[Term, int]] = []
    columns, units = [], []
    for term in asked:
        unit = []
        for index, text in enumerate(term.texts([f"{number:.12g}" for number in term.inside])):
            with_it = with_custom(model, {"expression": f"{TRIAL}*{text}", "stage": "joint"})
            try:
                column = (problem.predicted(with_it) - predicted) / TRIAL
            except UsageError:
                continue
            if np.all(np.isfinite(column)) and np.any(column[problem.mask]):
                unit.append(len(parts))
                parts.append((term, index))
                columns.append(column)
        if unit:
            units.append(tuple(unit))
    return parts, np.column_stack(columns), units


def _folds(problem: Problem, fitting: NDArray[np.bool_], blocks: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the fold of each sample of `fitting`, for cross-validation.

    The folds are whole logs if there are at least FOLDS of them, otherwise blocks of time.
    """
    own = problem.frame.logs(fitting)
    return own if own[-1] + 1 >= FOLDS else blocks % FOLDS


def _selected(
    columns: Array, residual: Array, folds: NDArray[np.int64], always: Array, units: Sequence[tuple[int, ...]]
) -> list[int]:
    """Return the numbers of the parts of the selected terms, the best term first.

    Up to MOST_TERMS terms are added. Each must remove LEAST_SHARE of the remaining squares on folds that it was not
    fitted on.

    Args:
        columns: responses of the parts, (m, parts).
        residual: residual, (m,).
        folds: fold of each sample, (m,).
        always: columns that are always fitted, (m, p), so that a term does not replace other parameters.
        units: numbers of the parts of each term.
    """
    both = np.column_stack([always, columns])
    both = both / np.maximum(np.linalg.norm(both, axis=0), 1e-300)
    number, first = int(folds.max()) + 1, always.shape[1]
    grams = np.array([both[folds == k].T @ both[folds == k] for k in range(number)])
    slopes = np.array([both[folds == k].T @ residual[folds == k] for k in range(number)])
    chosen = list(range(first))
    reached = max(_cross_validated(grams, slopes, chosen), 0.0)
    least = LEAST_SHARE * (float(residual @ residual) - reached)
    for _ in range(MOST_TERMS):
        free = [[first + i for i in unit] for unit in units if first + unit[0] not in chosen]
        gains = [_cross_validated(grams, slopes, [*chosen, *unit]) for unit in free]
        best = int(np.argmax(gains)) if gains else 0
        if not gains or gains[best] < reached + least:
            break
        chosen += free[best]
        reached = gains[best]
    return [i - first for i in chosen[first:]]


def _cross_validated(grams: Array, slopes: Array, chosen: Sequence[int]) -> float:
    """Return the decrease of the sum of squares on folds that the coefficients were not fitted on."""
    if not len(chosen):
        return 0.0
    gram, slope = grams[:, chosen][:, :, chosen], slopes[:, chosen]
    whole, right = gram.sum(axis=0), slope.sum(axis=0)
    gained = 0.0
    for own, part in zip(gram, slope, strict=True):
        weights = np.linalg.solve(whole - own + ROUNDING * np.eye(len(chosen)), right - part)
        gained += float(2.0 * weights @ part - weights @ own @ weights)
    return gained
