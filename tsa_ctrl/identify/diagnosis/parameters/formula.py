"""What is left as a plain formula in the log's signals, which a model file can take as `[effects.custom]`.

Sparse regression (forward selection of terms; Brunton, Proctor, Kutz, PNAS 2016, ask the same of a whole model): the
causes stay as they are, and each term must take its part of the simulation error on logs or blocks that it was not
fitted on. The terms are what transmissions are known to have and the catalogue lacks: a lever arm, an eccentric pulley
or a friction that changes with the angle (products of the load or the direction with harmonics of q_j or q_m), losses
that grow with speed and load, and zeros or losses that follow the temperature. A formula is a description, no name.
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
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import fit_on_simulation_error
from tsa_ctrl.identify.diagnosis.parameters.held_out import rms_over
from tsa_ctrl.identify.diagnosis.selection.entry import BLOCK_T, FOLDS
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.identify.student import half_width
from tsa_ctrl.model.effects.specification import Setting
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model, RigidDrive

MOST_TERMS = 3  # that a person still reads as a law
LEAST_PART = 0.05  # of the mean square left, that a term must take elsewhere: less is not worth a line in a file
LEAST_GAIN = 0.1  # of the mean square left on held-out data, to be told: less is not seen in a picture of it
TRIAL = 1e-3  # coefficient at which a term's response is computed; it is linear but for a load's friction
SINGULAR = 1e-9  # of a column's square, added to the normal equations: twins among the terms
CONSTANTS = "abc"

HARMONICS = ("sin({0})", "cos({0})", "sin(2*{0})", "cos(2*{0})", "{0}", "{0}**2")
FACTORS = ("", "*tau", "*sigma", "*sigma*abs(tau)")
LOADS = ("tau", "abs(tau)", "tau*abs(tau)", "sigma", "sigma*tau", "sigma*abs(tau)", "sigma*tau**2")
SPEEDS = ("omega_j", "abs(omega_j)", "omega_j*abs(omega_j)", "omega_j*abs(tau)", "tau*abs(omega_j)")
WARMTH = ("", "*sigma", "*omega_j", "*tau")


@dataclass(frozen=True)
class Formula:
    """tau_J -= f (of a plain drive tau_M += f) with f = `expression`; `constants` with their 95 % intervals.

    `model`: with it, and with the other numbers fitted anew beside it. `gain`: share of the mean square left on
    held-out data that it takes; `rms`: left there before and after, N*m at the logs' own rate; `better`, `logs`:
    held-out logs that it makes better, and how many there are.
    """

    expression: str
    constants: Mapping[str, Quantity]
    model: Model
    gain: float
    rms: tuple[float, float]
    better: int
    logs: int

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
    texts, columns = _responses(problem, model, predicted)
    fitting = split.fit & problem.mask
    blocks = np.unique(split.frame.blocks[fitting], return_inverse=True)[1]
    tangents = _tangents(problem, learned, predicted)
    chosen = _selected(columns[fitting], residual[fitting], _folds(problem, fitting, blocks), tangents[fitting])
    if not chosen:
        return None
    names = CONSTANTS[: len(chosen)]
    expression = " + ".join(f"{name}*{texts[i]}" for name, i in zip(names, chosen, strict=True))
    both = np.column_stack([tangents, columns[:, chosen]])
    values, deviations = _regressed(both[fitting], residual[fitting], blocks)
    constants, spread = values[tangents.shape[1] :], deviations[tangents.shape[1] :]
    if np.any(np.abs(constants) < BLOCK_T * spread):
        return None
    point = learned.point.copy()
    point[learned.free] += values[: tangents.shape[1]]
    point = np.clip(point, learned.hypothesis.low, learned.hypothesis.high)
    custom = {"expression": expression, "stage": "joint", **dict(zip(names, constants.tolist(), strict=True))}
    described = _with_custom(learned.hypothesis.model(point), custom)
    after = problem.frame.target - problem.predicted(described)
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
    )


def terms(problem: Problem, rigid: bool) -> list[str]:
    """The terms that these logs have the signals for."""
    frame = problem.frame
    angles = ["q_j"] if rigid or frame.has("q_j") else []
    angles += ["q_m"] if frame.has("q_m") and not rigid else []
    out = [*LOADS, *SPEEDS]
    out += [harmonic.format(angle) + factor for angle, harmonic, factor in product(angles, HARMONICS, FACTORS)]
    if frame.has("temperature"):
        middle = float(np.mean(frame.column("temperature")))
        out += [f"(temperature - {middle:.4g}){factor}" for factor in WARMTH]
    return out


def _responses(problem: Problem, model: Model, predicted: Array) -> tuple[list[str], Array]:
    """Terms, and what each adds to the prediction per unit of its coefficient: (n, terms) N*m at the score rate."""
    texts, columns = [], []
    for text in terms(problem, isinstance(model, RigidDrive)):
        with_it = _with_custom(model, {"expression": f"{TRIAL}*{text}", "stage": "joint"})
        try:
            column = (problem.predicted(with_it) - predicted) / TRIAL
        except UsageError:
            continue
        if np.all(np.isfinite(column)) and np.any(column[problem.mask]):
            texts.append(text)
            columns.append(column)
    return texts, np.column_stack(columns)


def _with_custom(model: Model, custom: Mapping[str, Setting]) -> Model:
    return dataclasses.replace(model, effects={**model.effects, "custom": custom})


def _tangents(problem: Problem, learned: Fit, predicted: Array) -> Array:
    """d prediction / d coordinate of those that no bound holds, (n, free): what other numbers can do about the rest."""
    columns = [np.zeros((len(predicted), 0))]
    for i in np.flatnonzero(learned.free):
        there = learned.point.copy()
        there[i] += learned.hypothesis.steps[i]
        step = learned.hypothesis.steps[i]
        columns.append(((problem.predicted(learned.hypothesis.model(there)) - predicted) / step)[:, None])
    return np.concatenate(columns, axis=1)


def _folds(problem: Problem, fitting: NDArray[np.bool_], blocks: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of the part that each sample is left out with: whole logs where there are enough of them."""
    own = problem.frame.logs(fitting)
    return own if own[-1] + 1 >= FOLDS else blocks % FOLDS


def _selected(columns: Array, residual: Array, folds: NDArray[np.int64], always: Array) -> list[int]:
    """Numbers of the terms, best first, as long as the next takes LEAST_PART of what is left on the other folds.

    columns (m, terms), always (m, p): what is fitted beside them, so that a term is not what other numbers can do.
    """
    both = np.column_stack([always, columns])
    both = both / np.maximum(np.linalg.norm(both, axis=0), 1e-300)
    number, first = int(folds.max()) + 1, always.shape[1]
    grams = np.array([both[folds == k].T @ both[folds == k] for k in range(number)])
    slopes = np.array([both[folds == k].T @ residual[folds == k] for k in range(number)])
    chosen = list(range(first))
    reached = max(_cross_validated(grams, slopes, chosen), 0.0)
    least = LEAST_PART * (float(residual @ residual) - reached)
    while len(chosen) < first + MOST_TERMS:
        free = [i for i in range(first, both.shape[1]) if i not in chosen]
        gains = [_cross_validated(grams, slopes, [*chosen, i]) for i in free]
        best = int(np.argmax(gains))
        if gains[best] < reached + least:
            break
        chosen.append(free[best])
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
    spread = bread @ (scores.T @ scores * number / max(number - 1, 1)) @ bread
    return values, np.sqrt(np.diag(spread))
