"""Compute the detection limit of each effect in the logs: the size that is detected with probability 0.9."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tsa_ctrl.identify.diagnosis.criteria import BY_NOISE, CERTAIN, NEGLIGIBLE
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem, orthonormal
from tsa_ctrl.identify.diagnosis.fitting.score_test import Score, scores
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import (
    models_reversals,
    noise_rms,
    on_simulation_error,
    simulation_error,
)
from tsa_ctrl.identify.diagnosis.selection.entry import LEAST_ERROR_REDUCTION, SMALLEST, SMALLEST_GAIN
from tsa_ctrl.identify.diagnosis.selection.forward import Selection
from tsa_ctrl.identify.diagnosis.selection.meaning import torque
from tsa_ctrl.model.functions import Array

# Standard deviations above a threshold at which it is exceeded with probability 0.9 (normal distribution)
POWER = 1.2816
SPREAD = 1.15  # factor by which a block-robust deviation sometimes exceeds the nominal one


@dataclass(frozen=True)
class DetectionLimits:
    """Detection limits of the effects in these logs.

    Attributes:
        sizes: detection limit in N*m by effect, the median over the effect's grid.
        invisible: effects that have no influence on these logs, or none that differs from a recalibration.
        hidden: detection limit in N*m of the effects whose limit exceeds the torque itself.
    """

    sizes: Mapping[str, float]
    invisible: tuple[str, ...]
    hidden: Mapping[str, float]


def detection_limits(chosen: Selection, structure: float) -> DetectionLimits:
    """Return the detection limits in the first round of a selection, when the model has only its base.

    A cause that explains less than the remaining structure would be a guess and is not reported
    (`claims.alternatives`). The limit therefore also depends on the structure. An effect may be present in the logs but
    not identified, because it is too small or resembles another cause. An effect of opposite sign must first compensate
    for this part, so it is added to the limit.

    Args:
        chosen: the selection with its rounds.
        structure: share of the residual's mean square that is not noise.
    """
    problem, first = chosen.problem, chosen.rounds[0]
    scored = scores(problem, first.fitted, first.responses)
    tangents = _tangents(problem, first.fitted)
    recalibration = orthonormal(tangents[problem.mask])
    noise = noise_rms(problem, chosen.fitted)
    needed = max(first.threshold, SMALLEST_GAIN * problem.count)
    white_size = max(np.sqrt(needed), SPREAD * CERTAIN) + POWER
    # Even a certain cause must reduce the simulation error by this amount, to which reversals contribute little.
    plain = on_simulation_error(problem, models_reversals(chosen.fitted) or not problem.nuisance.moments)
    left = min(structure, 1.0) * simulation_error(problem, chosen.fitted) / problem.count
    error = max(LEAST_ERROR_REDUCTION, float(np.sqrt(left)) / problem.noise.rms)  # in units of the noise
    known = orthonormal(plain.whiten(tangents))
    found: dict[str, list[float]] = defaultdict(list)
    sizes = [float(np.linalg.norm(score.columns)) for score in scored]
    for response, score, size in zip(first.responses, scored, sizes, strict=True):
        if size < NEGLIGIBLE * max(sizes):
            continue
        raw = response.columns[problem.mask]
        raw = raw - recalibration @ (recalibration.T @ raw)
        if not raw.any():  # The effect is equivalent to a recalibration.
            continue
        shown = plain.whiten(response.columns)
        shown = shown - known @ (known.T @ shown)
        whole = _rms(raw)
        taken = whole * error / max(_rms(shown), NEGLIGIBLE * whole)
        held = 0.0 if score.variant.effect in chosen.fitted.names else _held(first.fitted, score)
        seen_from = max(whole / size * white_size, SMALLEST * noise, taken)
        found[score.variant.effect].append(seen_from + whole / size * held)
    names = {score.variant.effect for score in scored}
    limits = {name: float(np.median(values)) for name, values in found.items()}
    largest = torque(problem)
    hidden = {name: size for name, size in limits.items() if size > largest}
    seen = {name: size for name, size in limits.items() if name not in hidden}
    return DetectionLimits(seen, tuple(sorted(names - set(found))), hidden)


def _held(fitted: Fit, score: Score) -> float:
    """Return the size of the effect, of either sign, that the logs contain beyond the noise level, white units."""
    shown = orthonormal(score.columns).T @ fitted.residual
    return float(np.sqrt(max(np.sum(shown**2) - BY_NOISE, 0.0)))


def _tangents(problem: Problem, fitted: Fit) -> Array:
    """Return d prediction / d base coordinates that no bound holds, (n, p) in N*m, not whitened."""
    present = problem.predicted(fitted.hypothesis.model(fitted.point))
    columns = []
    for i, free in enumerate(fitted.free[: len(fitted.hypothesis.base.coordinates())]):
        if free:
            stepped = fitted.point.copy()
            stepped[i] += 1e-3
            columns.append(problem.predicted(fitted.hypothesis.model(stepped)) - present)
    return np.column_stack(columns) if columns else np.zeros((len(present), 0))


def _rms(y: Array) -> float:
    return float(np.sqrt(np.mean(np.square(y))))
