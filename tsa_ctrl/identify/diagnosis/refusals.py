"""Why a diagnosis refuses: logs that show nothing, and logs or models that cannot belong together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.data.audit import Audit
from tsa_ctrl.identify.diagnosis.data.frame import Frame
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.parameters.formula import Formula
from tsa_ctrl.identify.diagnosis.parameters.held_out import HeldOut
from tsa_ctrl.identify.diagnosis.parameters.refit import base_quantities, refit
from tsa_ctrl.identify.energy import foreign_torque
from tsa_ctrl.identify.torque_scale import drive_scale
from tsa_ctrl.model.parameters import GearedDrive, Model, RigidDrive, TendonSheath

WIDEST_FRICTION = 0.35  # relative half width of the half loop's interval from which on friction is not seen at all
MOST_ERROR = (
    5.0  # times the torque's own variation: a simulation so far off is of another log; (3.55) may miss by twice
)
UNSUITED = (
    "the simulation is further off than the measured torque changes at all: are two columns swapped, is a unit wrong, "
    "or is the model another drive's?"
)
# Of its mean: a torque that rests on one level shows neither the slope nor, beside sensors' zeros, the half loop
LEAST_CHANGE = 0.25
LEAST_FRICTION = 0.01  # of a plain drive's friction in the file: less is a sign that the torque does not follow at all
FOLLOWED = 0.5  # of the change of such a torque: a simulation further off has not followed three quarters of its square
UNRELATED = 0.6  # of the torque itself, RMS: more that is not noise is left by every cause only of strange logs
LEAST_IMPROVEMENT = 0.5  # of the recalibrated model's error: causes that leave less are of this drive
SIMPLER = {
    "recalibrated": "the recalibrated model",
    "as_given": "the model as given",
    "constant": "a constant torque",
    "line": "a straight line in the {driver}",
}
STRANGE = (
    "no cause of the catalogue brings the simulation near the measured torque: are two columns swapped, a unit wrong, "
    "is one column of another log, or does a sensor saturate?"
)


class InsufficientError(Exception):
    """These logs cannot tell, for the reason that is the message. Leads to a verdict, not to an error."""


def refuse_unexciting(found: Audit) -> None:
    """Logs in which the audit sees too little."""
    if found.insufficient:
        raise InsufficientError(found.insufficient)


def refuse_foreign(frame: Frame, model: Model) -> None:
    """Reject logs whose torques cannot belong to their motion or to the model."""
    for run in frame.runs:
        reason = foreign_torque(run.raw, model)
        if reason:
            raise InsufficientError(f"{run.name}: {reason}")


def refuse_unsuited(problem: Problem, base: Fit) -> None:
    """A simulation that has nothing of the measured torque; and tendons whose friction does not show."""
    given, found = problem.base.given, base.hypothesis.model(base.point)
    if isinstance(given, RigidDrive) and isinstance(found, RigidDrive) and drive_scale(given, found):
        raise InsufficientError(drive_scale(given, found))
    mask = problem.mask
    error = (problem.frame.target - problem.predicted(base.hypothesis.model(base.point)))[mask]
    target = problem.frame.target[mask]
    change, level = float(np.std(target)), abs(float(np.mean(target)))
    off = float(np.std(error))
    if change < LEAST_CHANGE * level and not off <= FOLLOWED * change:
        raise InsufficientError(
            f"the measured torque rests on one level, {level:.3g} N·m, and changes by {change:.3g} N·m RMS, where "
            f"{LEAST_CHANGE * level:.3g} N·m are needed; one load does not tell friction from a sensor's gain or "
            "zero; record several loads and give the logs together"
        )
    if not off <= MOST_ERROR * change:
        raise InsufficientError(UNSUITED)
    if isinstance(given, TendonSheath):
        _refuse_unseen_friction(problem, base)


def refuse_without_friction(problem: Problem, base: Fit, named: bool) -> None:
    """A plain drive whose friction does not show though nothing is `named` that could hide it."""
    if problem.base.target == "tau_m" and not named:
        _refuse_unseen_friction(problem, base)


def refuse_unrelated(
    problem: Problem, held: NDArray[np.bool_], errors: HeldOut, structure: float, formula: Formula | None
) -> None:
    """Tendons where causes, if any, hardly help a simulation that has hardly anything of the measured torque.

    held (n): samples that no fit has seen; structure: share of what is left that is no noise. What a formula in the
    logs' own signals brings near on held-out data is of this drive, however far off it is without (a sensor with a wide
    dead zone); not what one brings near by the clock, which follows whatever swings.
    """
    if not isinstance(problem.base.given, TendonSheath) or structure <= 0.0:
        return
    torque = float(np.sqrt(np.mean(np.square(problem.frame.target[held]))))
    enough = LEAST_IMPROVEMENT * errors.recalibrated
    described = (
        formula is not None and not formula.tells_when and formula.rms[1] <= enough
    )  # some of it a formula takes of strange columns, too
    if errors.extended > UNRELATED * torque and errors.extended > enough and not described:
        raise InsufficientError(STRANGE)


def refuse_useless(problem: Problem, named: bool, errors: HeldOut) -> None:
    """Causes with which the held-out torque is predicted no better than by what needs none of them."""
    best, error = errors.simplest
    if best == "line" and isinstance(problem.base.given, GearedDrive):
        return  # except for the losses, a gear is a straight line
    if named and errors.extended >= error:
        driver = "velocity" if problem.base.target == "tau_m" else "motor torque"
        raise InsufficientError(
            f"on held-out data the best explanation is off by {errors.extended:.3g} N·m RMS, "
            f"{SIMPLER[best].format(driver=driver)} by {error:.3g} N·m: are the torque columns torques, of these logs? "
            "If so, give longer logs with more speeds and loads"
        )


def _refuse_unseen_friction(problem: Problem, base: Fit) -> None:
    found = base_quantities(refit(problem, base))
    name = "half_loop_torque" if "half_loop_torque" in found else "coulomb_friction"
    given, quantity = found[name]
    if problem.base.target == "tau_m" and quantity.value < LEAST_FRICTION * given:
        raise InsufficientError(
            f"friction does not show: it comes out as {quantity} where the file has {given:.3g} N·m; it does not "
            "follow the direction of this motion: is a column of another log, or is a sign turned?"
        )
    if not base.free.any() or quantity.value <= 0.0:
        return
    width = 0.5 * (quantity.high - quantity.low) / quantity.value
    if width > WIDEST_FRICTION and np.all(base.free):
        raise InsufficientError(
            f"friction does not show: {name.replace('_', ' ')} comes out as {quantity}, known to {width:.0%} where "
            f"{WIDEST_FRICTION:.0%} are needed; the motion or the load is too small beside what is left, "
            f"{problem.noise.rms:.3g} N·m, or goes one way only"
        )
