"""Compare a cause and its competing hypotheses on data that they were not fitted to.

A competing hypothesis is excluded if the cause has a clearly smaller simulation error on these data.

Whitening may hide this difference. In short logs, or in logs with slow drift, the noise is as slow as the difference
between two hypotheses. A hypothesis with four times the error then fits the whitened data about as well. This
comparison therefore uses the simulation error without whitening. Its scatter between blocks serves as the noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.criteria import BEYOND, FOLDS, ROUNDING
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, bounded_step
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import fit_on_simulation_error
from tsa_ctrl.model.functions import Array

# Least ratio of the mean squares of competing hypothesis and cause: a user does not notice a smaller ratio, whatever
# the scatter. If the error is mostly noise, the test of the whitened residuals is more sensitive.
VISIBLY = 1.5


@dataclass(frozen=True)
class Elsewhere:
    """Sum of squares of the simulation error in each block, (blocks,) in (N*m)^2, by a fit without that block."""

    squares: Array

    @property
    def error(self) -> float:
        """Return the sum of squares over all blocks, (N*m)^2."""
        return float(self.squares.sum())

    def clearly_beats(self, other: Elsewhere) -> bool:
        """Return True if the error of `other` is clearly larger, beyond the scatter of the blocks."""
        more = other.squares - self.squares
        count = len(more)
        spread = float(np.std(more, ddof=1)) * np.sqrt(count) if count > 1 else np.inf
        return float(other.squares.sum()) > VISIBLY * float(self.squares.sum()) and float(more.sum()) > BEYOND * spread


def elsewhere(problem: Problem, found: Fit, reversals: bool) -> Elsewhere:
    """Return the simulation error of a hypothesis on data that it was not fitted to.

    Whole logs are left out if there are at least FOLDS of them, and blocks otherwise. Each fit without a part is one
    Gauss-Newton step from the fit to all data. If a bound stops one coordinate, the others are solved again. Without
    this, a narrow valley of the cost (friction and pretension together with a torque constant) would stop them all.
    """
    learned = fit_on_simulation_error(problem, found, reversals)
    squares: Array = np.bincount(problem.blocks, unseen(learned, _folds(problem))).astype(np.float64)
    return Elsewhere(squares * problem.noise.rms**2)


def unseen(learned: Fit, folds: NDArray[np.int64]) -> Array:
    """Return the square of each residual, (m,), by a fit that leaves out the fold of the sample.

    folds: number of the fold of each sample, (m,).
    """
    squares = np.zeros(len(learned.residual))
    for fold in np.unique(folds):
        inside = folds == fold
        squares[inside] = residual_of_part(learned, ~inside)[inside] ** 2
    return squares


def residual_of_part(learned: Fit, part: NDArray[np.bool_], moved: slice = slice(None)) -> Array:
    """Return the residuals, (m,), after one bounded step that fits the samples of the mask `part`, (m,), alone.

    moved: coordinates that may move, unless a bound holds them. The others keep their values of the fit to all samples.
    """
    jacobian, residual = learned.jacobian, learned.residual
    steps = np.zeros(len(learned.point), dtype=np.bool_)
    steps[moved] = True
    columns = steps[learned.free]
    point = learned.point[learned.free]
    low, high = learned.hypothesis.low[learned.free] - point, learned.hypothesis.high[learned.free] - point
    step = np.zeros(len(point))
    # With this damping, indistinguishable coordinates keep their values, and all others move as without damping.
    step[columns] = bounded_step(jacobian[np.ix_(part, columns)], residual[part], low[columns], high[columns], ROUNDING)
    return np.asarray(residual - jacobian @ step)


def _folds(problem: Problem) -> NDArray[np.int64]:
    """Return the number of the fold of each sample that counts, (m,)."""
    own = problem.frame.logs(problem.mask)
    return (own if own[-1] + 1 >= FOLDS else problem.blocks) % FOLDS
