"""Rivals on data that they were not fitted on: one that simulates visibly worse there than the cause is no rival.

Whitened by the noise of short logs or slow drift, causes that leave four times the error of another fit about as well:
what sets them apart is as slow as that noise. The error that a user sees, on samples that the fit has not seen, is
compared without whitening; its scatter between blocks is its noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, bounded_step
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import fit_on_simulation_error
from tsa_ctrl.identify.diagnosis.selection.entry import FOLDS
from tsa_ctrl.model.functions import Array

# Of the cause's mean square elsewhere: a rival that leaves less than half as much again is no worse to a user, whatever
# its scatter; and where noise is most of the error, whitened residuals are the sharper test
VISIBLY = 1.5
BEYOND = 3.0  # t of the difference over about 24 blocks: 0.3 % one-sided
SINGULAR = 1e-9  # of a coordinate's square, added to it: twins stay where they are, and all else moves as if it were 0


@dataclass(frozen=True)
class Elsewhere:
    """Squares of the simulation error in each block, (blocks,) in (N*m)^2, by a fit that did not see the block."""

    squares: Array

    @property
    def error(self) -> float:
        """Sum of squares, (N*m)^2."""
        return float(self.squares.sum())

    def clearly_beats(self, other: Elsewhere) -> bool:
        """Whether the other leaves visibly more than this, by more than blocks scatter."""
        more = other.squares - self.squares
        count = len(more)
        spread = float(np.std(more, ddof=1)) * np.sqrt(count) if count > 1 else np.inf
        return float(other.squares.sum()) > VISIBLY * float(self.squares.sum()) and float(more.sum()) > BEYOND * spread


def elsewhere(problem: Problem, found: Fit, reversals: bool) -> Elsewhere:
    """The simulation error of a hypothesis on blocks it was not fitted on: whole logs where there are enough of them.

    One Gauss-Newton step from the fit on all of them; where a bound holds a coordinate the others are solved anew, for
    along a valley (friction and pretension beside a torque constant) the one alone means a wall.
    """
    learned = fit_on_simulation_error(problem, found, reversals)
    squares: Array = np.bincount(problem.blocks, unseen(learned, _folds(problem))).astype(np.float64)
    return Elsewhere(squares * problem.noise.rms**2)


def unseen(learned: Fit, folds: NDArray[np.int64]) -> Array:
    """Square of each residual, (m,), by a fit that did not see its fold. folds (m,): number of each sample's."""
    squares = np.zeros(len(learned.residual))
    for fold in np.unique(folds):
        inside = folds == fold
        squares[inside] = residual_of_part(learned, ~inside)[inside] ** 2
    return squares


def residual_of_part(learned: Fit, part: NDArray[np.bool_], moved: slice = slice(None)) -> Array:
    """Residuals, (m,), of the fit moved by one bounded step that the samples of `part`, (m,), alone ask for.

    moved: the coordinates that step, of those that no bound holds; the others stay where all samples have them.
    """
    jacobian, residual = learned.jacobian, learned.residual
    steps = np.zeros(len(learned.point), dtype=np.bool_)
    steps[moved] = True
    columns = steps[learned.free]
    point = learned.point[learned.free]
    low, high = learned.hypothesis.low[learned.free] - point, learned.hypothesis.high[learned.free] - point
    step = np.zeros(len(point))
    step[columns] = bounded_step(jacobian[np.ix_(part, columns)], residual[part], low[columns], high[columns], SINGULAR)
    return np.asarray(residual - jacobian @ step)


def _folds(problem: Problem) -> NDArray[np.int64]:
    """Number of the part that each sample that counts is left out with, (m,)."""
    own = problem.frame.logs(problem.mask)
    return (own if own[-1] + 1 >= FOLDS else problem.blocks) % FOLDS
