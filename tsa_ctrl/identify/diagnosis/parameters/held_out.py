"""Errors on data that no fit has seen: as given, recalibrated, extended, the floor, and of what knows no drive at all.

A constant and a straight line know nothing of the drive. A cause that is not better than they are, or than the nominal
model, is not an explanation: logs of another quantity (PWM for torque) leave most of the torque to any model.
A constant or a line counts only if it holds in both directions, fitted on one part and tested on the other and vice
versa: the mean of four loads is that of the fifth one by chance if it lies in their middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.data.frame import Frame, Run
from tsa_ctrl.identify.diagnosis.data.split import Split
from tsa_ctrl.identify.diagnosis.fitting.fit import ENOUGH, Fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import (
    fit_on_simulation_error,
    full_residuals,
    models_reversals,
)
from tsa_ctrl.identify.diagnosis.rivals.elsewhere import elsewhere
from tsa_ctrl.identify.diagnosis.selection.step import LATE_REVERSALS, backward_step
from tsa_ctrl.identify.three_errors import known_direction, pooled, sensor_noise
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model

ROUNDING = 1e-9  # of the gain: the loss that rounding leaves of a cause without any; 4e-15 was seen
MOST_STRUCTURE = 0.95  # of the mean square: some of what is left is noise
# Of what a cause changes of the torque where it was learned, in mean square: held-out logs in which it changes less
# say little of it (at the middle one of five loads recalibration does what friction that grows with the load does), and
# with half of it a cause that is there would still lose nothing by chance only if what is left is as large and alike
HARDLY_SHOWN = 0.5


@dataclass(frozen=True)
class HeldOut:
    """RMS in N*m over the held-out samples at the logs' own rate; `lost` without each cause, as a share of the gain.

    Of a cause that the held-out samples hardly show, or beside one that moves the reversals, `lost` is that on the
    others, each part left out in its turn.
    """

    as_given: float
    recalibrated: float
    extended: float
    noise_floor: float  # the sensor's noise
    refitted: float  # of the extended model fitted on the held-out samples themselves, without the structure it leaves
    sliding: tuple[float, float]  # the simplest and the extended, where the direction is known
    lost: tuple[float, ...]
    constant: float  # the mean of the samples that were fitted on; what it is worse at, this or the other way round
    line: float  # a straight line in the motor torque, of a plain drive in the velocity, alike

    @property
    def simplest(self) -> tuple[str, float]:
        """The best of what needs no cause, and its error: as given, recalibrated, a constant, a straight line."""
        names = ("recalibrated", "as_given", "constant", "line")
        best = min(names, key=lambda name: float(getattr(self, name)))
        return best, float(getattr(self, best))

    @property
    def gain(self) -> float:
        """(simplest^2 - extended^2) / (simplest^2 - floor^2); 0 where there is nothing to gain."""
        simplest = self.simplest[1]
        possible = simplest**2 - self.noise_floor**2
        won = simplest**2 - self.extended**2
        return float(won / possible) if possible > 0.0 else 0.0

    @property
    def sliding_gain(self) -> float:
        """`gain` over the samples whose direction is known."""
        simplest, extended = self.sliding
        possible = simplest**2 - self.noise_floor**2
        return float((simplest**2 - extended**2) / possible) if possible > 0.0 else 0.0

    @property
    def worthless(self) -> int | None:
        """Number of a cause without which nothing is lost on data that no fit has seen; None without one."""
        if len(self.lost) == 1:
            return None if self.extended < self.recalibrated else 0
        return int(np.argmin(self.lost)) if self.lost and min(self.lost) <= ROUNDING else None


def held_out(problem: Problem, base: Fit, found: Fit, split: Split, structure_share: float) -> HeldOut:
    """Fit on the fit samples, measure on the held ones. `leftover_share`: of the mean square that is no noise."""
    frame = split.frame
    recalibrated = fit_on_simulation_error(problem, base, mask=split.fit)
    extended = fit_on_simulation_error(problem, found, mask=split.fit) if found.names else recalibrated
    own = fit_on_simulation_error(problem, extended, mask=split.held)
    samples = float(split.held.sum())
    rms = {
        "as_given": rms_over(frame, base.hypothesis.base.given, split.held),
        "recalibrated": rms_over(frame, recalibrated.hypothesis.model(recalibrated.point), split.held),
        "extended": rms_over(frame, extended.hypothesis.model(extended.point), split.held),
    }
    floor = rms_over(frame, own.hypothesis.model(own.point), split.held) * np.sqrt(samples / (samples - len(own.point)))
    floor *= np.sqrt(1.0 - min(structure_share, MOST_STRUCTURE))
    won = max(rms["recalibrated"] ** 2 - rms["extended"] ** 2, 1e-300)
    lost = []
    for index in range(len(found.names)):
        if len(found.names) == 1:
            lost.append(1.0)
            continue
        smaller = _without(problem, extended, found, index, split)
        error = rms_over(frame, smaller.hypothesis.model(smaller.point), split.held)
        share = (error**2 - rms["extended"] ** 2) / won
        if share <= 0.0 and (_is_late(found) or _hardly_shown(problem, extended, smaller, split)):
            share = _among_the_learned(problem, base, found, index)
        lost.append(float(np.clip(share, 0.0, 1.0)))
    logs = [run.raw for run in frame.runs]
    directed = [known_direction(log) for log in logs]
    slides = split.held & np.concatenate([_whole_bins(*each) for each in zip(frame.runs, directed, strict=True)])
    models = [base.hypothesis.base.given, *(each.hypothesis.model(each.point) for each in (recalibrated, extended))]
    sliding = [rms_over(frame, model, slides) for model in models]
    noises = [sensor_noise(log, log[problem.base.target], each) for log, each in zip(logs, directed, strict=True)]
    told = pooled(noises, [len(log) for log in logs])
    noise = rms["extended"] if told is None else told
    driver = "omega_j" if problem.base.target == "tau_m" else "tau_m"
    return HeldOut(
        **rms,
        noise_floor=float(min(noise, rms["extended"])),
        refitted=float(min(floor, rms["extended"])),
        sliding=(min(sliding[0], sliding[1]), sliding[2]),
        lost=tuple(lost),
        constant=straight(split, ()),
        line=straight(split, (driver,)),
    )


def _whole_bins(run: Run, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Score samples all of whose samples at the log's own rate are in `mask`."""
    return np.asarray(mask[: run.count * run.full_bin].reshape(run.count, run.full_bin).all(axis=1))


def _without(problem: Problem, extended: Fit, found: Fit, index: int, split: Split) -> Fit:
    """The fit without a cause, begun where all samples have it; begun at `extended` where that is better.

    Without the moments of reversals little holds a lag: a fit may move far along it and gain nothing.
    """
    starts = (backward_step(problem, each, index) for each in (found, extended))
    own, other = (fit_on_simulation_error(problem, start, mask=split.fit) for start in starts)
    return other if other.rss < own.rss - ENOUGH else own


def _hardly_shown(problem: Problem, extended: Fit, smaller: Fit, split: Split) -> bool:
    """Return True if a cause changes much less of the torque in the held-out samples than in the fitted ones."""
    with_it, without = (problem.predicted(each.hypothesis.model(each.point)) for each in (extended, smaller))
    change = np.square(with_it - without)
    return bool(np.mean(change[split.held]) < HARDLY_SHOWN * np.mean(change[split.fit]))


def _is_late(found: Fit) -> bool:
    """Return True if a lag, a delay or backlash moves the reversals: one that is missed by a sample or two is most of
    the error.

    Then a cause that is worth less than that is judged where the moments of the reversals do not count.
    """
    return not models_reversals(found) and any(name in (*LATE_REVERSALS, "backlash") for name in found.names)


def _among_the_learned(problem: Problem, base: Fit, found: Fit, index: int) -> float:
    """Share of the gain that is lost without a cause on the samples learned from, each part left out in its turn.

    0 where nothing is lost beyond their scatter.
    """
    reversals = models_reversals(found)
    none, less, more = (
        elsewhere(problem, each, reversals) for each in (base, backward_step(problem, found, index), found)
    )
    return (less.error - more.error) / max(none.error - more.error, 1e-300) if more.clearly_beats(less) else 0.0


def straight(split: Split, drivers: Sequence[str]) -> float:
    """Error of a constant and multiples of these signals, over the held samples or the other way round: the larger."""
    frame = split.frame
    columns = np.column_stack([np.ones(len(frame)), *(frame.column(name) for name in drivers)])

    def error(learned: NDArray[np.bool_], tried: NDArray[np.bool_]) -> float:
        factors = np.linalg.lstsq(columns[learned], frame.target[learned], rcond=None)[0]
        residuals = []
        for run in frame.runs:
            level = np.full(len(run.full), factors[0])
            for factor, name in zip(factors[1:], drivers, strict=True):
                level = level + factor * getattr(run.full, name)
            residuals.append(run.full_target - level)
        return _over(frame, residuals, tried)

    return max(error(split.fit, split.held), error(split.held, split.fit))


def rms_over(frame: Frame, model: Model, mask: NDArray[np.bool_]) -> float:
    """RMS error of a model over the full-rate samples behind the masked score samples (n), N*m."""
    return _over(frame, full_residuals(frame, model), mask)


def _over(frame: Frame, residuals: Sequence[Array], mask: NDArray[np.bool_]) -> float:
    """RMS over the full-rate samples behind the masked score samples."""
    total, count = 0.0, 0
    for part, run, residual in zip(frame.slices, frame.runs, residuals, strict=True):
        inside = np.repeat(mask[part], run.full_bin)
        inside = np.concatenate([inside, np.full(len(residual) - len(inside), bool(mask[part][-1]))])
        of_these = residual[inside]
        total += float(of_these @ of_these)
        count += len(of_these)
    return float(np.sqrt(total / max(count, 1)))
