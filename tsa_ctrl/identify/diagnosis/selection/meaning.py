"""Check that the parameters of a fit are meaningful.

An effect is meaningful if its contribution is a part of the torque and its parameters lie within their bounds. Two
similar effects can have any size as long as their difference fits the data. A parameter at a bound shows only where the
search ended, not a property of the drive.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tsa_ctrl.identify.diagnosis.criteria import BY_NOISE, NEGLIGIBLE
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, gradients
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem, orthonormal
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import (
    fit_on_simulation_error,
    models_reversals,
    on_simulation_error,
)

# Largest ratio of an effect's contribution to the torque. If a contribution is three times the torque, others cancel
# eight ninths of its square. Its parameter would then depend on the difference of two uncertain values.
MOST_PART = 3.0
FAR = 10.0  # distance to the rest angle in half ranges of the motion: at this distance a spring's torque varies by 10 %
# Effects and their simpler limit: the joint hardly moves, or the spring rests far outside the motion
SIMPLER: Mapping[str, str] = {"joint_stiffness": "torque_offset", "gravity_load": "torque_offset"}


def meaningless(problem: Problem, found: Fit) -> list[int]:
    """Return the indices of the effects of `found` that are not meaningful.

    An effect is not meaningful if a bound holds its parameter, if its contribution is more than MOST_PART times the
    torque, or if it is a spring whose rest angle is far outside the motion.
    """
    return [
        index
        for index, part in enumerate(_parts(problem, found))
        if _at_bound(problem, found, index)
        or part > MOST_PART * torque(problem)
        or _rests_far_away(problem, found, index)
    ]


def meaningless_by_error(problem: Problem, found: Fit) -> list[int]:
    """Return the indices of the effects that are not meaningful when fitted on the simulation error.

    This check applies if most of the residual is structure. Structure colours the noise model, so whitening also
    removes effects that are as slow as the structure. The whitened fit may then drive a parameter to a bound that the
    simulation error does not require. The reported parameters are those fitted on the simulation error.
    """
    return meaningless(on_simulation_error(problem, models_reversals(found)), fit_on_simulation_error(problem, found))


def torque(problem: Problem) -> float:
    """Return the RMS torque in N*m: the larger of the measured torque and the torque of the nominal model."""
    given = problem.predicted(problem.base.given)[problem.mask]
    return max(_rms(problem.frame.target[problem.mask]), _rms(given))


def _parts(problem: Problem, found: Fit) -> list[float]:
    """Return the RMS contribution of each effect to the prediction, N*m.

    The contribution is the change of the prediction when the effect is removed and all other parameters are kept.
    """
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
    """Return True if the effect is a spring that rests so far outside the motion that its torque is nearly constant."""
    variant, frame = found.hypothesis.variants[index], problem.frame
    if variant.effect != "joint_stiffness":
        return False
    own = found.hypothesis.own(found.point)[index]
    angles = frame.stack([run.angle for run in frame.runs])[problem.mask]
    rest = float(variant.parameters(own)["rest_angle"])
    return abs(rest - float(np.mean(angles))) > FAR * 0.5 * float(np.ptp(angles))


def _at_bound(problem: Problem, found: Fit, index: int) -> bool:
    """Return True if a bound holds an effect's amplitude and a value beyond the bound would fit clearly better.

    For an effect without an amplitude, all its coordinates are checked. "Clearly better" means that the sum of squares
    would decrease by more than BY_NOISE, because noise alone may also move a coordinate to its bound. A lower bound of
    0 is not checked: it is the natural limit of an amplitude, and an effect of amplitude 0 is removed because it has no
    gain.
    """
    variant = found.hypothesis.variants[index]
    at = found.hypothesis.places[index].start
    own = [at + i for i in (variant.amplitude or range(len(variant.coordinates)))]
    low, high = found.hypothesis.low, found.hypothesis.high
    near = [NEGLIGIBLE * (high[i] - low[i]) if np.isfinite(high[i] - low[i]) else 0.0 for i in own]
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
