"""Compute the errors of the models on held-out data, and of references that use no model of the drive.

The models are the nominal, the recalibrated and the extended model; the noise floor is computed as well. The references
are a constant and a straight line. A cause that does not beat them and the nominal model is not an explanation. For
example, logs of another quantity (PWM instead of torque) leave most of the torque unexplained by any model.

A constant or a line is fitted on one part and tested on the other, and vice versa, and the larger error counts. In one
direction it may be small by chance: the mean of four loads equals the fifth load if that load lies in the middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.criteria import LEAST_SHARE, ROUNDING
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

MOST_STRUCTURE = 1.0 - LEAST_SHARE  # share of the mean square: some of the residual is noise
# Mean square change of the torque by a cause in the held-out samples, relative to the fitted ones. Below half, held-out
# logs contain little information about the cause. For example, at the middle one of five loads, recalibration has the
# same effect as friction that grows with the load. With half or more, a true cause can show no loss only if the
# residual is by chance as large as the cause and similar to it.
HARDLY_SHOWN = 0.5
# Least share of the mean square above the noise that a single cause removes: half a percent of the RMS. On a healthy
# rig, a delay of 0 removed 0.2 %.
LEAST_WON = 0.01


@dataclass(frozen=True)
class HeldOut:
    """Errors over the held-out samples at the logs' own rate, RMS in N*m.

    Attributes:
        as_given: error of the nominal model.
        recalibrated: error of the recalibrated model.
        extended: error of the model with all causes.
        lost: loss of gain without each cause, as a share of the gain, 0 to 1; 1 for a single cause.

    The held-out samples may show no loss because they hardly show the cause, or because a cause shifts the reversals in
    time. `lost` is then computed by cross-validation on the other samples.
    """

    as_given: float
    recalibrated: float
    extended: float
    noise_floor: float  # noise of the sensor, at most `extended`
    refitted: float  # error of the extended model fitted on the held-out samples, without the remaining structure
    # Errors where the direction is known: the better of nominal and recalibrated, and extended
    sliding: tuple[float, float]
    lost: tuple[float, ...]
    constant: float  # error of the mean of one part on the other part, the larger of both directions
    line: float  # the same for a straight line in the motor torque, or in the velocity for a plain drive

    @property
    def simplest(self) -> tuple[str, float]:
        """Return the name and the error of the best reference: recalibrated, nominal, constant or straight line."""
        names = ("recalibrated", "as_given", "constant", "line")
        best = min(names, key=lambda name: float(getattr(self, name)))
        return best, float(getattr(self, best))

    def _gain(self, before: float, after: float) -> float:
        """Return (before^2 - after^2) / (before^2 - floor^2); 0 if no gain is possible."""
        possible = before**2 - self.noise_floor**2
        return float((before**2 - after**2) / possible) if possible > 0.0 else 0.0

    @property
    def gain(self) -> float:
        """Return the gain of the extended model over the best reference."""
        return self._gain(self.simplest[1], self.extended)

    @property
    def sliding_gain(self) -> float:
        """Return the gain over the samples with a known direction.

        The reference is the better of the nominal and the recalibrated model.
        """
        return self._gain(*self.sliding)

    @property
    def worthless(self) -> int | None:
        """Return the index of a cause that can be removed without loss on data not used in the fit, or None.

        A single cause is worthless if it removes less than `LEAST_WON` of the error above the noise, both over all
        samples and while sliding.
        """
        if len(self.lost) == 1:
            gains = self._gain(self.recalibrated, self.extended), self.sliding_gain
            return None if max(gains) > LEAST_WON else 0
        return int(np.argmin(self.lost)) if self.lost and min(self.lost) <= ROUNDING else None


def held_out(problem: Problem, base: Fit, found: Fit, split: Split, structure_share: float) -> HeldOut:
    """Fit on the samples `split.fit`, and return the errors on the samples `split.held`.

    Args:
        problem: the logs with the noise model.
        base: the recalibrated base.
        found: the fit with all causes.
        split: the samples to fit on and to test on.
        structure_share: share of the residual's mean square that is not noise.
    """
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
    """Return the score samples for which `mask` contains all samples at the log's own rate."""
    return np.asarray(mask[: run.count * run.full_bin].reshape(run.count, run.full_bin).all(axis=1))


def _without(problem: Problem, extended: Fit, found: Fit, index: int, split: Split) -> Fit:
    """Return the fit without a cause on the samples `split.fit`.

    The fit starts from the fit on all samples. A fit that starts from `extended` replaces it if it is better. If the
    moments of reversals do not count, the data hardly constrain a lag, and a fit may move far along it without a gain.
    """
    starts = (backward_step(problem, each, index) for each in (found, extended))
    own, other = (fit_on_simulation_error(problem, start, mask=split.fit) for start in starts)
    return other if other.rss < own.rss - ENOUGH else own


def _hardly_shown(problem: Problem, extended: Fit, smaller: Fit, split: Split) -> bool:
    """Return True if a cause changes the torque much less in the held-out samples than in the fitted ones."""
    with_it, without = (problem.predicted(each.hypothesis.model(each.point)) for each in (extended, smaller))
    change = np.square(with_it - without)
    return bool(np.mean(change[split.held]) < HARDLY_SHOWN * np.mean(change[split.fit]))


def _is_late(found: Fit) -> bool:
    """Return True if a lag, a delay or backlash shifts the reversals in time.

    An error of one or two samples in the time of a reversal is then most of the simulation error. A cause with a
    smaller effect must be judged on samples without the moments of the reversals.
    """
    return not models_reversals(found) and any(name in (*LATE_REVERSALS, "backlash") for name in found.names)


def _among_the_learned(problem: Problem, base: Fit, found: Fit, index: int) -> float:
    """Return the share of the gain that is lost without a cause, by cross-validation on the problem's samples.

    The result is 0 if the loss is not clearly larger than its scatter between blocks.
    """
    reversals = models_reversals(found)
    none, less, more = (
        elsewhere(problem, each, reversals) for each in (base, backward_step(problem, found, index), found)
    )
    return (less.error - more.error) / max(none.error - more.error, 1e-300) if more.clearly_beats(less) else 0.0


def straight(split: Split, drivers: Sequence[str]) -> float:
    """Return the error of a constant plus multiples of these signals, RMS in N*m.

    The model is fitted on `split.fit` and tested on `split.held`, and vice versa. The larger error is returned.
    """
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
    """Return the RMS error of a model over the full-rate samples behind the masked score samples (n), N*m."""
    return _over(frame, full_residuals(frame, model), mask)


def _over(frame: Frame, residuals: Sequence[Array], mask: NDArray[np.bool_]) -> float:
    """Return the RMS of full-rate residuals over the samples behind the masked score samples (n,)."""
    total, count = 0.0, 0
    for part, run, residual in zip(frame.slices, frame.runs, residuals, strict=True):
        inside = np.repeat(mask[part], run.full_bin)
        inside = np.concatenate([inside, np.full(len(residual) - len(inside), bool(mask[part][-1]))])
        of_these = residual[inside]
        total += float(of_these @ of_these)
        count += len(of_these)
    return float(np.sqrt(total / max(count, 1)))
