"""Fit the constants of a selected formula together with all other parameters, and compute their uncertainty."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.criteria import ROUNDING
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, bounded_step
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.parameters.terms import ONE, Term
from tsa_ctrl.model.effects.specification import Setting
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model

# Coefficient at which a term's response is computed; the response is linear except for friction of the load
TRIAL = 1e-3
# Largest number of steps for all constants, each from the last result. A base that has absorbed much of the formula is
# far from its final values and is not linear in friction and pretension. Each Gauss-Newton step doubles the number of
# correct digits.
REFITS = 8
HALVINGS = 4  # tries of a step, each half as long as the last: if an eighth gains nothing, the constants are kept
SETTLED = 1e-4  # share of the squares: a step that gains less ends the search
CONSTANTS = "abcdefghijkl"  # names for two coefficients and two inner constants of each term


@dataclass(frozen=True)
class Sought:
    """A formula whose constants are to be fitted.

    Attributes:
        expression: the formula.
        names: names of the constants.
        start: start values, (constants,).
        low: lower bounds, (constants,).
        high: upper bounds, (constants,).
    """

    expression: str
    names: tuple[str, ...]
    start: Array
    low: Array
    high: Array

    @classmethod
    def of(cls, parts: Sequence[tuple[Term, int]], values: Array) -> Sought:
        """Return the sum of these parts of terms, with coefficients that start at `values`."""
        names, texts = iter(CONSTANTS), []
        numbers: list[tuple[str, float, float, float]] = []
        inside: dict[int, list[str]] = {}
        for (term, index), value in zip(parts, values.tolist(), strict=True):
            coefficient = next(names)
            numbers.append((coefficient, value, -np.inf, np.inf))
            if id(term) not in inside:
                inside[id(term)] = [next(names) for _ in term.inside]
                numbers += zip(inside[id(term)], term.inside, term.low, term.high, strict=True)
            texts.append(f"{coefficient}*{term.texts(inside[id(term)])[index]}".removesuffix(f"*{ONE}"))
        told, *ends = zip(*numbers, strict=True)
        return cls(" + ".join(texts), told, *(np.array(end) for end in ends))

    def custom(self, constants: Array) -> dict[str, Setting]:
        """Return the settings of `[effects.custom]` with these constants."""
        return {
            "expression": self.expression,
            "stage": "joint",
            **dict(zip(self.names, constants.tolist(), strict=True)),
        }

    def tangents(self, problem: Problem, model: Model, constants: Array, predicted: Array) -> Array:
        """Return d prediction / d constant, (n, constants); `predicted` is the prediction with the formula, (n,)."""
        columns = []
        reach = self.high - self.low  # A step relative to an absolute time would be too long.
        for i, value in enumerate(constants):
            there = constants.copy()
            there[i] += (step := TRIAL * (reach[i] if np.isfinite(reach[i]) else max(abs(value), TRIAL)))
            columns.append((problem.predicted(with_custom(model, self.custom(there))) - predicted) / step)
        return np.column_stack(columns)


def refitted(problem: Problem, learned: Fit, sought: Sought, fitting: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the coordinates and the constants of the formula with the least error on the samples of `fitting`.

    Both are fitted together. With the formula, a coordinate may leave a bound that held it before.
    """
    hypothesis, target = learned.hypothesis, problem.frame.target[fitting]
    at, split = np.concatenate([learned.point, sought.start]), len(learned.point)
    low, high = np.concatenate([hypothesis.low, sought.low]), np.concatenate([hypothesis.high, sought.high])

    def simulated(there: Array) -> Array:
        model = hypothesis.model(there[:split])
        return problem.predicted(with_custom(model, sought.custom(there[split:])))

    now = simulated(at)
    for _ in range(REFITS):
        every = tangents_of(problem, learned, at[:split], sought.custom(at[split:]), now)
        own = sought.tangents(problem, hypothesis.model(at[:split]), at[split:], now)
        left = target - now[fitting]
        step = bounded_step(np.column_stack([every, own])[fitting], left, low - at, high - at, ROUNDING)
        for _ in range(HALVINGS):
            further = simulated(at + step)
            if np.sum((target - further[fitting]) ** 2) < np.sum(left**2):
                break
            step = 0.5 * step
        else:
            break
        gained = 1.0 - np.sum((target - further[fitting]) ** 2) / np.sum(left**2)
        at, now = at + step, further
        if gained < SETTLED:
            break
    return at[:split], at[split:]


def with_custom(model: Model, custom: Mapping[str, Setting]) -> Model:
    """Return the model with these settings of `[effects.custom]`."""
    return dataclasses.replace(model, effects={**model.effects, "custom": custom})


def tangents_of(problem: Problem, learned: Fit, point: Array, custom: Mapping[str, Setting], predicted: Array) -> Array:
    """Return d prediction / d coordinate, (n, coordinates), at `point`.

    These columns span the changes of the prediction that the other parameters can cause. If `custom` has settings, the
    model contains the formula. `predicted` is the prediction at `point`, (n,).
    """
    columns = [np.zeros((len(predicted), 0))]
    for i in range(len(point)):
        step = learned.hypothesis.steps[i]
        step = step if point[i] + step <= learned.hypothesis.high[i] else -step  # The model ends at the bound.
        there = point.copy()
        there[i] += step
        model = learned.hypothesis.model(there)
        moved = problem.predicted(with_custom(model, custom) if custom else model)
        columns.append(((moved - predicted) / step)[:, None])
    return np.concatenate(columns, axis=1)


def regressed(columns: Array, residual: Array, blocks: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return the least-squares coefficients and their standard deviations, (k,) each.

    `columns` has the shape (m, k) and `residual` (m,). The standard deviations come from the scatter between `blocks`,
    (m,).
    """
    bread = np.linalg.pinv(columns.T @ columns)
    values = bread @ columns.T @ residual
    number = int(blocks[-1]) + 1
    scores = np.zeros((number, columns.shape[1]))
    np.add.at(scores, blocks, columns * (residual - columns @ values)[:, None])
    moved = scores @ bread  # influence of each block on the coefficients
    return values, np.sqrt(np.sum(moved**2, axis=0) * number / max(number - 1, 1))
