"""What is left as a plain formula in the log's signals, which a model file can take as `[effects.custom]`.

Sparse regression (forward selection of terms; Brunton, Proctor, Kutz, PNAS 2016, ask the same of a whole model): the
causes stay as they are, and each term must take its part of the simulation error on logs or blocks that it was not
fitted on. The terms are what transmissions are known to have and the catalogue lacks: a lever arm, an eccentric pulley
or a friction that changes with the angle (products of the load or the direction with harmonics of q_j or q_m) or at
one place in the sheath, losses that grow with speed and load, sensors that saturate or have a dead zone, and zeros or
losses that follow the temperature. What is one thing enters as one: a wave with its phase, a zero with the temperature
at which it is right. A formula is a description, no name.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.diagnosis.data.split import Split
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, bounded_step
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import fit_on_simulation_error
from tsa_ctrl.identify.diagnosis.parameters.held_out import rms_over
from tsa_ctrl.identify.diagnosis.selection.entry import BLOCK_T, FOLDS
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.identify.student import half_width
from tsa_ctrl.model.effects.specification import Setting
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model, RigidDrive, TendonSheath

MOST_TERMS = 3  # that a person still reads as a law; a wave with its phase is one
LEAST_PART = 0.05  # of the mean square left, that a term must take elsewhere: less is not worth a line in a file
LEAST_GAIN = 0.1  # of the mean square left on held-out data, to be told: less is not seen in a picture of it
TRIAL = 1e-3  # coefficient at which a term's response is computed; it is linear but for a load's friction
SINGULAR = 1e-9  # of a column's square, added to the normal equations: twins among the terms
# Times all numbers are solved for anew, each from the last: a base that has taken up much of the formula is far from
# where it belongs, and not linear in friction and pretension; steps of Gauss and Newton double the digits
REFITS = 4
CONSTANTS = "abcdef"  # two of each term

# Of an angle: waves of any phase once and twice a turn, a straight line, a parabola
WAVES: tuple[tuple[str, ...], ...] = (("sin({0})", "cos({0})"), ("sin(2*{0})", "cos(2*{0})"))
COURSES: tuple[tuple[str, ...], ...] = (*WAVES, ("{0}",), ("{0}**2",))
FACTORS = ("", "*tau", "*sigma", "*sigma*abs(tau)")
LOADS = ("tau", "abs(tau)", "tau*abs(tau)", "tau**3", "sigma", "sigma*tau", "sigma*abs(tau)", "sigma*tau**2")
DEAD_ZONE = "tanh({:.3g}*tau)"
# Per RMS torque: a zero lost within a third or a tenth of it; less is an offset of either sign, more a saturation
DEAD_ZONES = (3.0, 10.0)
# Friction at one place: a bump as wide as the way between two of so many places over the range of the angle
PLACES, RUB = 9, "sigma*exp(-(({0} {1} {2:.4g})/{3:.3g})**2)"
SPEEDS = ("omega_j", "abs(omega_j)", "omega_j*abs(omega_j)", "omega_j*abs(tau)", "tau*abs(omega_j)")
WARMTH = ("*sigma", "*omega_j", "*tau")
ONE = "1"


@dataclass(frozen=True)
class Formula:
    """tau_J -= f (of a plain drive tau_M += f) with f = `expression`; `constants` with their 95 % intervals.

    `model`: with it, and with the other numbers fitted anew beside it. `gain`: share of the mean square left on
    held-out data that it takes; `rms`: left there before and after, N*m at the logs' own rate; `better`, `logs`:
    held-out logs that it makes better, and how many there are. `terms`: how many things it has, a wave with its phase
    being one.
    """

    expression: str
    constants: Mapping[str, Quantity]
    model: Model
    gain: float
    rms: tuple[float, float]
    better: int
    logs: int
    terms: int

    def toml(self) -> str:
        """The table of a model file."""
        lines = [
            f'expression = "{self.expression}"',
            *(f"{name} = {q.value:.6g}" for name, q in self.constants.items()),
        ]
        return "\n".join(["[effects.custom]", *lines])


def formula_of_what_is_left(problem: Problem, found: Fit, split: Split) -> Formula | None:
    """The formula that what `found` leaves follows also on held-out data; None where there is none of few terms."""
    learned = fit_on_simulation_error(problem, found, mask=split.fit)
    model = learned.hypothesis.model(learned.point)
    if "custom" in model.effects:
        return None
    predicted = problem.predicted(model)
    residual = problem.frame.target - predicted
    texts, columns, units = _responses(problem, model, predicted)
    fitting = split.fit & problem.mask
    blocks = np.unique(split.frame.blocks[fitting], return_inverse=True)[1]
    every = _tangents(problem, learned, learned.point, {}, predicted)
    tangents = every[:, learned.free]
    folds = _folds(problem, fitting, blocks)
    chosen = _selected(columns[fitting], residual[fitting], folds, tangents[fitting], units)
    while chosen:
        both = np.column_stack([tangents, columns[:, chosen]])
        values, deviations = _regressed(both[fitting], residual[fitting], blocks)
        sure = (np.abs(values) / np.maximum(deviations, 1e-300))[tangents.shape[1] :]
        if np.all(sure >= BLOCK_T):
            break
        del chosen[int(np.argmin(sure))]  # such as the half of a wave that its phase does not need
    if not chosen:
        return None
    names = CONSTANTS[: len(chosen)]
    expression = " + ".join(f"{name}*{texts[i]}".removesuffix(f"*{ONE}") for name, i in zip(names, chosen, strict=True))
    point, constants, custom = learned.point.copy(), np.zeros(len(chosen)), dict[str, Setting]()
    simulated, endless = predicted, np.full(len(chosen), np.inf)
    for _ in range(REFITS):  # what a bound held before may be free beside the formula
        both = np.column_stack([every, columns[:, chosen]])[fitting]
        low, high = (np.concatenate([end - point, sign * endless]) for end, sign in _bounds(learned))
        step = bounded_step(both, (problem.frame.target - simulated)[fitting], low, high, SINGULAR)
        point, constants = point + step[: len(point)], constants + step[len(point) :]
        custom = {"expression": expression, "stage": "joint", **dict(zip(names, constants.tolist(), strict=True))}
        described = _with_custom(learned.hypothesis.model(point), custom)
        simulated = problem.predicted(described)
        every = _tangents(problem, learned, point, custom, simulated)
    inside = (point > learned.hypothesis.low) & (point < learned.hypothesis.high)
    both = np.column_stack([every[:, inside], columns[:, chosen]])[fitting]
    spread = _regressed(both, (problem.frame.target - simulated)[fitting], blocks)[1][int(inside.sum()) :]
    after = problem.frame.target - simulated
    held = [part for part in problem.frame.slices if split.held[part].any()]
    sums = np.array([[float(np.sum(y[part][split.held[part]] ** 2)) for y in (residual, after)] for part in held])
    before, left = sums.sum(axis=0)
    better = int(np.sum(sums[:, 1] < sums[:, 0]))
    if not left < (1.0 - LEAST_GAIN) * before or 2 * better <= len(held):
        return None
    half = half_width(max(int(blocks[-1]), 1)) * spread
    told = zip(names, constants, half, strict=True)
    return Formula(
        expression,
        {name: Quantity(float(v), float(v - h), float(v + h), "1") for name, v, h in told},
        described,
        gain=float(1.0 - left / before),
        rms=(rms_over(problem.frame, model, split.held), rms_over(problem.frame, described, split.held)),
        better=better,
        logs=len(held),
        terms=sum(not set(unit).isdisjoint(chosen) for unit in units),
    )


def terms(problem: Problem, model: Model) -> list[tuple[str, ...]]:
    """The terms that these logs have the signals for, each with a coefficient for every part.

    Of both angles the joint's is taken, and the motor's as it would be on stiff tendons: their difference is the
    tendons' stretch, a second measurement of the torque that is to be explained, and a wave of one against a wave of
    the other takes up any cause.
    """
    frame = problem.frame
    rigid = isinstance(model, RigidDrive)
    angles = [("q_j", COURSES)] if rigid or frame.has("q_j") else []
    if isinstance(model, TendonSheath) and frame.has("q_j") and frame.has("q_m"):
        angles.append((f"{model.joint_pulley_radius / model.motor_pulley_radius:.6g}*q_j", WAVES))
    elif frame.has("q_m") and not rigid:
        angles.append(("q_m", COURSES))
    scale = float(np.sqrt(np.mean(np.square(frame.target[problem.mask]))))
    plain = [*LOADS, *SPEEDS, *(DEAD_ZONE.format(steep / max(scale, 1e-9)) for steep in DEAD_ZONES)]
    out: list[tuple[str, ...]] = [(text,) for text in plain]
    for angle, courses in angles:
        for course, factor in product(courses, FACTORS):
            out.append(tuple(part.format(angle) + factor for part in course))
    if frame.has("q_j"):
        low, high = np.quantile(frame.column("q_j")[problem.mask], (0.02, 0.98))
        width = float(high - low) / (PLACES - 1)
        if width > 0.0:
            out += [
                (RUB.format("q_j", "+" if place < 0.0 else "-", abs(place), width),)
                for place in np.linspace(low, high, PLACES)
            ]
    if frame.has("temperature"):
        warm = f"(temperature - {float(np.mean(frame.column('temperature'))):.4g})"
        out += [(warm, ONE), *((warm + factor,) for factor in WARMTH)]
    return out


def _responses(problem: Problem, model: Model, predicted: Array) -> tuple[list[str], Array, list[tuple[int, ...]]]:
    """Parts of the terms, and what each adds to the prediction per unit of its coefficient: (n, parts) N*m.

    At the score rate; and the numbers of the parts of each term.
    """
    texts: list[str] = []
    columns, units = [], []
    for term in terms(problem, model):
        unit = []
        for text in term:
            with_it = _with_custom(model, {"expression": f"{TRIAL}*{text}", "stage": "joint"})
            try:
                column = (problem.predicted(with_it) - predicted) / TRIAL
            except UsageError:
                continue
            if np.all(np.isfinite(column)) and np.any(column[problem.mask]):
                unit.append(len(texts))
                texts.append(text)
                columns.append(column)
        if unit:
            units.append(tuple(unit))
    return texts, np.column_stack(columns), units


def _with_custom(model: Model, custom: Mapping[str, Setting]) -> Model:
    return dataclasses.replace(model, effects={**model.effects, "custom": custom})


def _tangents(problem: Problem, learned: Fit, point: Array, custom: Mapping[str, Setting], predicted: Array) -> Array:
    """d prediction / d coordinate, (n, coordinates): what other numbers can do about the rest.

    At `point`, with the formula in the model where there is one; `predicted` there.
    """
    columns = [np.zeros((len(predicted), 0))]
    for i in range(len(point)):
        step = learned.hypothesis.steps[i]
        step = step if point[i] + step <= learned.hypothesis.high[i] else -step  # beyond a bound there is no model
        there = point.copy()
        there[i] += step
        model = learned.hypothesis.model(there)
        moved = problem.predicted(_with_custom(model, custom) if custom else model)
        columns.append(((moved - predicted) / step)[:, None])
    return np.concatenate(columns, axis=1)


def _bounds(learned: Fit) -> tuple[tuple[Array, float], tuple[Array, float]]:
    """Lower and upper ends of the coordinates, each with its sign."""
    return (learned.hypothesis.low, -1.0), (learned.hypothesis.high, 1.0)


def _folds(problem: Problem, fitting: NDArray[np.bool_], blocks: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of the part that each sample is left out with: whole logs where there are enough of them."""
    own = problem.frame.logs(fitting)
    return own if own[-1] + 1 >= FOLDS else blocks % FOLDS


def _selected(
    columns: Array, residual: Array, folds: NDArray[np.int64], always: Array, units: Sequence[tuple[int, ...]]
) -> list[int]:
    """Numbers of the parts of terms, best first, as long as the next takes LEAST_PART of what is left on other folds.

    columns (m, parts), always (m, p): what is fitted beside them, so that a term is not what other numbers can do;
    `units`: the parts of each term.
    """
    both = np.column_stack([always, columns])
    both = both / np.maximum(np.linalg.norm(both, axis=0), 1e-300)
    number, first = int(folds.max()) + 1, always.shape[1]
    grams = np.array([both[folds == k].T @ both[folds == k] for k in range(number)])
    slopes = np.array([both[folds == k].T @ residual[folds == k] for k in range(number)])
    chosen = list(range(first))
    reached = max(_cross_validated(grams, slopes, chosen), 0.0)
    least = LEAST_PART * (float(residual @ residual) - reached)
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
    """Decrease of the sum of squares on folds that the coefficients were not fitted on."""
    if not len(chosen):
        return 0.0
    gram, slope = grams[:, chosen][:, :, chosen], slopes[:, chosen]
    whole, right = gram.sum(axis=0), slope.sum(axis=0)
    gained = 0.0
    for own, part in zip(gram, slope, strict=True):
        weights = np.linalg.solve(whole - own + SINGULAR * np.eye(len(chosen)), right - part)
        gained += float(2.0 * weights @ part - weights @ own @ weights)
    return gained


def _regressed(columns: Array, residual: Array, blocks: NDArray[np.int64]) -> tuple[Array, Array]:
    """Least squares with standard deviations from the scatter between blocks."""
    bread = np.linalg.pinv(columns.T @ columns)
    values = bread @ columns.T @ residual
    number = int(blocks[-1]) + 1
    scores = np.zeros((number, columns.shape[1]))
    np.add.at(scores, blocks, columns * (residual - columns @ values)[:, None])
    moved = scores @ bread  # what each block does to the values
    return values, np.sqrt(np.sum(moved**2, axis=0) * number / max(number - 1, 1))
