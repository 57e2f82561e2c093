"""Whether the numbers of a fit mean anything: a claim is a part of the torque, and its number lies inside its bounds.

Two causes that look alike can be given any size as long as their difference fits; and a number that a bound holds says
where the search ended, not what the drive does.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, gradients
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem, orthonormal
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import (
    fit_on_simulation_error,
    models_reversals,
    on_simulation_error,
)

# Largest contribution of an effect over the torque: other contributions cancel eight ninths of the square of one that
# is three times as large, so that its parameter is the difference of two guesses.
MOST_PART = 3.0
FAR = 10.0  # half ranges of the motion, to the rest angle: the torque of such a spring varies by a tenth
AT_BOUND = 1e-6  # of the range between two bounds: a fit that is held there stands on it, but for rounding
# Decrease of the sum of squares (white units) by noise alone: 3.7 deviations; one test in 5,000 has more
BY_NOISE = 14.0
# Effects, and the one that each turns into where the joint hardly turns or where the spring rests far away
SIMPLER: Mapping[str, str] = {"joint_stiffness": "torque_offset", "gravity_load": "torque_offset"}


def meaningless(problem: Problem, found: Fit) -> list[int]:
    """Numbers of the effects of `found` that are no claims: at a bound, or several times the torque itself."""
    return [
        index
        for index, part in enumerate(_parts(problem, found))
        if _at_bound(problem, found, index)
        or part > MOST_PART * torque(problem)
        or _rests_far_away(problem, found, index)
    ]


def meaningless_by_error(problem: Problem, found: Fit) -> list[int]:
    """The same where structure decides: of the numbers that the simulation error wants, which are those reported.

    What structure colours whitens away what is as slow, and drives a number to a bound that the error never asks for.
    """
    return meaningless(on_simulation_error(problem, models_reversals(found)), fit_on_simulation_error(problem, found))


def torque(problem: Problem) -> float:
    """RMS of the torque that counts, N*m: the measured one, or the simulated one where it is larger."""
    given = problem.predicted(problem.base.given)[problem.mask]
    return max(_rms(problem.frame.target[problem.mask]), _rms(given))


def _parts(problem: Problem, found: Fit) -> list[float]:
    """RMS of what each effect adds to the prediction beside the others as they are, N*m."""
    hypothesis = found.hypothesis
    base, own = len(hypothesis.base.coordinates()), hypothesis.own(found.point)
    whole = problem.predicted(hypothesis.model(found.point))
    parts = []
    for index in range(len(own)):
        rest = np.concatenate([found.point[:base], *own[:index], *own[index + 1 :]])
        without = problem.predicted(hypothesis.without(index).model(rest))
        parts.append(_rms((whole - without)[problem.mask]))
    return parts


def _rests_far_away(problem: Problem, found: Fit, index: int) -> bool:
    """Return True for a spring that rests so far outside the motion that it is a constant torque."""
    variant, frame = found.hypothesis.variants[index], problem.frame
    if variant.effect != "joint_stiffness":
        return False
    own = found.hypothesis.own(found.point)[index]
    angles = frame.stack([run.angle for run in frame.runs])[problem.mask]
    rest = float(variant.parameters(own)["rest_angle"])
    return abs(rest - float(np.mean(angles))) > FAR * 0.5 * float(np.ptp(angles))


def _at_bound(problem: Problem, found: Fit, index: int) -> bool:
    """Whether a bound holds the size of an effect, or the width of one that has no size, against the data.

    One that noise may have brought to its bound is a claim: beyond it the fit would gain no more than noise gains.
    Bounds at 0 are where a size ends by nature; there the effect gains nothing and goes for that reason.
    """
    variant = found.hypothesis.variants[index]
    at = found.hypothesis.places[index].start
    own = [at + i for i in (variant.amplitude or range(len(variant.coordinates)))]
    low, high = found.hypothesis.low, found.hypothesis.high
    near = [AT_BOUND * (high[i] - low[i]) if np.isfinite(high[i] - low[i]) else 0.0 for i in own]
    held = [
        i
        for i, margin in zip(own, near, strict=True)
        if found.point[i] >= high[i] - margin or (variant.amplitude and found.point[i] <= low[i] + margin < 0.0)
    ]
    if not held:
        return False
    columns, basis = gradients(problem, found), orthonormal(found.jacobian)
    residual = found.residual - basis @ (basis.T @ found.residual)
    beyond = columns[:, held] - basis @ (basis.T @ columns[:, held])
    gains = (beyond.T @ residual) ** 2 / np.maximum(np.sum(beyond**2, axis=0), 1e-12)
    return bool(np.max(gains) > BY_NOISE)


def _rms(y: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(y))))
