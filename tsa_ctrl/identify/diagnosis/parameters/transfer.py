"""What each cause does where its numbers were not fitted: on the other half of the loads, of the speeds, of the time.

A number that belongs to one load, one speed or one day describes that load, speed or day. So the numbers of each cause
are fitted on one half of the logs and tried on the other, and the other way round; one that takes nothing there, all
halves together, is not named. Halves are of whole logs where there are enough, else of blocks of time. All other
numbers stay as all samples have them: one load does not part friction from pretension, and a cause would be blamed for
what these two do on the other.

A half that does not show a cause (an offset among logs of one direction, which friction explains as well) teaches none,
and it is not tried on one in which it hardly acts (inertia among the slow logs), or far more than where it was learned.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import fit_on_simulation_error, models_reversals
from tsa_ctrl.identify.diagnosis.parameters.held_out import HARDLY_SHOWN
from tsa_ctrl.identify.diagnosis.rivals.elsewhere import residual_of_part
from tsa_ctrl.identify.diagnosis.selection.step import backward_step
from tsa_ctrl.model.functions import Array

ENOUGH_LOGS = 4  # of which a half is two: one alone may be of a strange day
# Of the lower half's mean, that the upper half's must be: below it both halves are of one load or speed, and a fit on
# one of them says nothing of others
VARIED = 1.25
# Of the share that a cause takes of all logs, that it must take of a half by a fit on that half alone: the half then
# shows it
SHOWN = 0.5
# Mean square of what it changes elsewhere, over that where it was learned: what grows with load or speed acts four
# times as much at twice of it; beyond that a fit that was free where it was learned is thrown far off (a stiction of
# standing logs, tried on fast ones)
EXTRAPOLATED = 4.0


@dataclass(frozen=True)
class Transfer:
    """What a cause takes of the mean square without it, on halves that nothing was fitted on; 0 where it takes nothing.

    `shares`: by what the halves are of ("load", "speed", "time"), of those that are a test. `everywhere`: over all of
    these together; nan where there is none.
    """

    shares: Mapping[str, float]
    everywhere: float


def transfer(problem: Problem, found: Fit) -> tuple[Transfer, ...]:
    """What each cause takes of the simulation error of halves that it was not fitted on.

    Loads or speeds that hardly differ have no halves, nor has a cause that neither half shows.
    """
    if not found.names:
        return ()
    halves = _halves(problem)
    reversals = models_reversals(found)
    present = fit_on_simulation_error(problem, found, reversals)
    absent = (
        fit_on_simulation_error(problem, backward_step(problem, found, index), reversals)
        for index in range(len(found.names))
    )
    return tuple(
        taken(present, each, place, halves) for each, place in zip(absent, found.hypothesis.places, strict=True)
    )


def local(carried: Sequence[Transfer]) -> int | None:
    """Number of a cause that takes nothing on halves that it was not fitted on; None where there is none."""
    return next((index for index, each in enumerate(carried) if each.everywhere <= 0.0), None)


def taken(present: Fit, absent: Fit, own: slice, halves: Mapping[str, NDArray[np.int64]]) -> Transfer:
    """What a cause takes of each kind of halves, by the fits with and without it on all samples.

    own: which coordinates of `present` are the cause's. halves: which half each sample is in, (m,) of 0 and 1, by what
    they are of.
    """
    whole = 1.0 - present.rss / absent.rss
    left = {name: np.zeros(2) for name in halves}  # with and without it
    for name, upper in halves.items():
        for half in (upper == 0, upper == 1):
            taught = [np.sum(residual_of_part(each, half)[half] ** 2) for each in (present, absent)]
            fits = np.array([residual_of_part(present, half, own), absent.residual])
            changed = (fits[0] - fits[1]) ** 2
            acts = HARDLY_SHOWN * changed[half].mean() <= changed[~half].mean() <= EXTRAPOLATED * changed[half].mean()
            if acts and taught[0] <= (1.0 - SHOWN * whole) * taught[1]:
                left[name] += np.sum(fits[:, ~half] ** 2, axis=1)
    shares = {name: _share(each) for name, each in left.items() if each[1] > 0.0}
    return Transfer(shares, _share(np.sum(list(left.values()), axis=0)))


def _share(left: Array) -> float:
    return max(0.0, 1.0 - float(left[0] / left[1])) if left[1] > 0.0 else math.nan


def _halves(problem: Problem) -> Mapping[str, NDArray[np.int64]]:
    """Which half each sample that counts is in, (m,) of 0 and 1, by what the halves are of."""
    frame, mask = problem.frame, problem.mask
    logs = frame.logs(mask)
    units = logs if logs[-1] + 1 >= ENOUGH_LOGS else problem.blocks
    number = np.arange(int(units[-1]) + 1, dtype=np.float64)
    measures = {"load": frame.target[mask], "speed": frame.column("omega_j")[mask]}
    sizes = {name: _size(values, units) for name, values in measures.items()}
    out = {name: upper_half(size)[units] for name, size in sizes.items() if _is_varied(size)}
    return {**out, "time": upper_half(number)[units]}


def _size(values: Array, units: NDArray[np.int64]) -> Array:
    """RMS in each unit."""
    return np.asarray(np.sqrt(np.bincount(units, values**2) / np.maximum(np.bincount(units), 1)))


def upper_half(sizes: Array) -> NDArray[np.int64]:
    """1 for the larger half of the sizes, (k,), 0 for the others."""
    rank = np.argsort(np.argsort(sizes, kind="stable"), kind="stable")
    return np.asarray(2 * rank >= len(sizes), dtype=np.int64)


def _is_varied(sizes: Array) -> bool:
    upper = upper_half(sizes) == 1
    return bool(upper.any() and not upper.all()) and float(sizes[upper].mean()) > VARIED * float(sizes[~upper].mean())
