"""How small an effect these logs would still have shown: per effect, the size found with probability 0.9."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from tsa_ctrl.identify.diagnosis.fitting.problem import Problem, orthonormal
from tsa_ctrl.identify.diagnosis.fitting.score_test import Score
from tsa_ctrl.identify.diagnosis.selection.entry import BLOCK_T, SMALLEST, SMALLEST_GAIN
from tsa_ctrl.model.functions import Array

POWER = 1.2816  # deviations above a threshold at which it is passed with probability 0.9
SPREAD = 1.15  # a block-robust deviation exceeds the nominal one by so much now and then
INVISIBLE = 1e-6  # of the largest response: an effect that changes nothing here


def detection_limits(
    problem: Problem, screened: Sequence[Score], raw: dict[int, Array], threshold: float, noise_rms: float
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Size in N*m by effect, the median over its grid; and the effects that change nothing in these logs.

    `raw`: by position in `screened`, the response (n, k) in N*m that is not whitened, the recalibration projected out.
    """
    needed = max(threshold, SMALLEST_GAIN * problem.count)
    white_size = max(np.sqrt(needed), SPREAD * BLOCK_T) + POWER
    found: dict[str, list[float]] = defaultdict(list)
    sizes = [float(np.linalg.norm(score.columns)) for score in screened]
    for position, score in enumerate(screened):
        if sizes[position] < INVISIBLE * max(sizes):
            continue
        per_white = float(np.sqrt(np.mean(raw[position] ** 2))) / sizes[position]
        found[score.variant.effect].append(max(per_white * white_size, SMALLEST * noise_rms))
    names = {score.variant.effect for score in screened}
    return {name: float(np.median(values)) for name, values in found.items()}, tuple(sorted(names - set(found)))


def without_recalibration(columns: Array, tangents: Array) -> Array:
    """What is left of responses (n, k) in N*m when the base's tangents (n, p) are projected out."""
    basis = orthonormal(tangents)
    return np.asarray(columns - basis @ (basis.T @ columns))
