"""Compute and minimise the simulation error: the error of the model for its user, without whitening.

Whitened fits are the more sensitive test, but they weight the frequencies by the noise, not by this error.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.data.frame import Frame
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.noise.autoregressive import white_noise
from tsa_ctrl.identify.diagnosis.noise.nuisance import Nuisance
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model
from tsa_ctrl.model.predict import predict


def models_reversals(found: Fit) -> bool:
    """Return True if the hypothesis determines the friction during a reversal, so that no moment is uncertain."""
    return "presliding_hysteresis" in found.names


def on_simulation_error(problem: Problem, reversals: bool, mask: NDArray[np.bool_] | None = None) -> Problem:
    """Return the problem whose residual is the simulation error divided by the noise RMS.

    Args:
        problem: the logs with the noise model.
        reversals: True if the samples at reversals count. Two hypotheses can be compared only with the same value.
        mask: samples that count, (n,); default: those of `problem`.
    """
    used = problem.mask if mask is None else mask
    plain = dataclasses.replace(problem, noise=white_noise(problem.noise.rms), mask=used)
    return dataclasses.replace(plain, nuisance=Nuisance(np.zeros((len(problem.frame), 0)))) if reversals else plain


def fit_on_simulation_error(
    problem: Problem, found: Fit, reversals: bool | None = None, mask: NDArray[np.bool_] | None = None
) -> Fit:
    """Return the fit of the same hypothesis on the simulation error, started from `found`.

    `reversals` and `mask` are as in `on_simulation_error`; by default `reversals` is `models_reversals(found)`.
    """
    plain = on_simulation_error(problem, models_reversals(found) if reversals is None else reversals, mask)
    return fit(plain, found.hypothesis, found.point)


def simulation_error(problem: Problem, fitted: Fit, reversals: bool | None = None) -> float:
    """Return the sum of squares of the simulation error of a hypothesis fitted on it, (N*m)^2 at the score rate.

    `reversals` is as in `fit_on_simulation_error`.
    """
    return fit_on_simulation_error(problem, fitted, reversals).rss * problem.noise.rms**2


def full_residuals(frame: Frame, model: Model) -> list[Array]:
    """Return measured minus predicted torque of each run at the log's own rate, N*m."""
    return [run.full_target - predict(model, run.full) for run in frame.runs]


def noise_rms(problem: Problem, fitted: Fit) -> float:
    """Return the RMS noise at the rate of the logs, N*m: by the noise model, plus the part above the score rate.

    It is at most the RMS of the whole residual, which includes all causes that are not identified yet. Medians are used
    instead of means, because samples with a wrong direction are outliers.
    """
    residuals = full_residuals(problem.frame, fitted.hypothesis.model(fitted.point))
    whole = _deviation(residuals)
    fast = []
    for run, residual in zip(problem.frame.runs, residuals, strict=True):
        bins = residual[: run.count * run.full_bin].reshape(run.count, run.full_bin)
        bins -= bins.mean(axis=1, keepdims=True)  # in place, so that an hour of data is not stored twice
        fast.append(bins.ravel())
    return min(whole, float(np.hypot(problem.noise.rms, _deviation(fast))))


def _deviation(parts: Sequence[Array]) -> float:
    sizes = np.concatenate(parts)
    np.abs(sizes, out=sizes)
    return float(np.median(sizes, overwrite_input=True)) / 0.6745
