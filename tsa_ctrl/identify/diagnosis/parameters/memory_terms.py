"""The terms with a memory that a formula of what is left may have, of the load: found on a grid, then moved.

A tendon that creeps or a torque sensor that is slow (what a lag leaves), one that rings on its mount, and one whose
reading knows whether the load rose or fell before. Of each kind the grid has many terms, of which one is asked, with
its numbers moved to where it takes most. What a term does to the prediction is taken as what it is of the load; the fit
that follows compares by the model itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.fitting.problem import Problem, orthonormal
from tsa_ctrl.identify.diagnosis.parameters.formula_numbers import TRIAL, with_custom
from tsa_ctrl.identify.diagnosis.parameters.terms import FURTHER, Term
from tsa_ctrl.model.expression import parse
from tsa_ctrl.model.filters import KINDS
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model, RigidDrive
from tsa_ctrl.model.predict import predict_each

LAG, RING, DAHL = "(tau - lag(tau, {0}))", "(tau - ring(tau, {0}, {1}))", "dahl(tau, {0})"
TIMES = (0.02, 5.0, 9)  # s of a lag: a filter of a sensor to a creep that a log of a minute still shows; and how many
LONGER = 3.0  # times T that a log must last
FREQUENCIES = (2.0, 25.0)  # Hz: slower is the motion itself, faster is gone in the denoised signals
FINE = 1.06  # ratio of two frequencies: within half of it the swings of a damping of 0.03 still go along
DAMPINGS = (0.03, 0.1, 0.3)  # of what rings: steel on a soft mount to what hardly overshoots; between them it is moved
FEWEST = 4.0  # score samples in a period of what rings
WIDTHS = (0.05, 1.6, 6)  # of a hysteresis, of the RMS torque; wider is a straight line, narrower a dead zone
TWINS = 1e-6  # of a column's square: one of which less is left beside the others is one of them
HALVINGS = 6  # of the way between two of the grid, to find the best place: a hundredth of it


@dataclass(frozen=True)
class Grid:
    """One kind: its text, the numbers of each place, and the ratio of two neighbours, by number."""

    kind: str
    text: str
    places: Sequence[tuple[float, ...]]
    apart: tuple[float, ...]

    def inside(self, numbers: Array) -> tuple[float, ...]:
        """The same numbers, within what they may be, and a step of a slope from there."""
        bounds = zip(numbers.tolist(), KINDS[self.kind], strict=True)
        return tuple(min(max(number, bound.low), bound.high / (1.0 + 2.0 * TRIAL)) for number, bound in bounds)

    def term(self, place: tuple[float, ...]) -> Term:
        """A term that begins there."""
        ends = (self.inside(np.array(place) * factor) for factor in (1.0 / FURTHER, FURTHER))
        return Term((self.text,), place, *ends)


def memory_terms(
    problem: Problem, model: Model, fitting: NDArray[np.bool_], residual: Array, others: Array
) -> list[Term]:
    """Of each kind the term that takes most of `residual` (n,) beside `others` (n, k), where fitted."""
    column = _columns(problem, model)
    basis = orthonormal(others[fitting])
    left = residual[fitting] - basis @ (basis.T @ residual[fitting])

    def taken(text: str, place: tuple[float, ...]) -> float:
        """Of the sum of squares, (N*m)^2."""
        own = column(text.format(*place))[fitting]
        whole = float(own @ own)
        beside = whole - float(np.sum(np.square(basis.T @ own)))  # of it, that the others do not have
        return float((own @ left) ** 2 / beside) if beside > TWINS * whole else 0.0

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
    """Those that these logs may show."""
    frame = problem.frame
    seconds = max(part.stop - part.start for part in frame.slices) * frame.period
    low, high, count = TIMES
    times = [(float(T),) for T in np.geomspace(low, high, count) if seconds > LONGER * T]
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
    """What a term of the load does to the prediction, (n,) N*m per unit of its coefficient at the score rate."""
    frame, sign = problem.frame, 1.0 if isinstance(model, RigidDrive) else -1.0
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
