"""Reject logs with too little information, and logs or models that cannot belong together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.data.audit import Audit
from tsa_ctrl.identify.diagnosis.data.frame import Frame
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.parameters.formula import Formula
from tsa_ctrl.identify.diagnosis.parameters.held_out import HeldOut
from tsa_ctrl.identify.diagnosis.parameters.refit import Refit, base_quantities, effect_quantities, refit
from tsa_ctrl.identify.energy import foreign_torque
from tsa_ctrl.identify.motion import inseparable
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.identify.torque_scale import drive_scale
from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.effects.search import Scales
from tsa_ctrl.model.effects.specification import Motion
from tsa_ctrl.model.parameters import GearedDrive, Model, RigidDrive, TendonSheath

# Largest relative half width of the interval of the friction: with a wider one, the logs do not determine it
WIDEST_FRICTION = 0.35
# Largest error as a multiple of the torque's variation: a larger error means another drive's log; equation (3.55) may
# be wrong by a factor of two
MOST_ERROR = 5.0
UNSUITED = (
    "the simulation is further off than the measured torque changes at all: are two columns swapped, is a unit wrong, "
    "or is the model another drive's?"
)
# Least variation of the torque as a share of its mean: at an almost constant torque neither the slope nor, with unknown
# sensor zeros, the friction torque can be identified
LEAST_CHANGE = 0.25
# Least friction of a plain drive as a share of the file's value: with less, the torque does not follow the motion
LEAST_FRICTION = 0.01
# Largest error as a share of the variation of an almost constant torque: a quarter of the variance then remains
FOLLOWED = 0.5
# Share of the RMS torque: only in unrelated logs does a larger error that is not noise remain with every cause
UNRELATED = 0.6
# Share of the recalibrated model's error: causes that reduce the error below this share belong to this drive
LEAST_IMPROVEMENT = 0.5
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
    """Indicate that the logs allow no diagnosis, for the reason in the message.

    This exception leads to the verdict `insufficient`, not to an error.
    """


def refuse_unexciting(found: Audit) -> None:
    """Raise InsufficientError if the audit found too little excitation in the logs."""
    if found.insufficient:
        raise InsufficientError(found.insufficient)


def refuse_foreign(frame: Frame, model: Model) -> None:
    """Raise InsufficientError if the torques of a log cannot belong to its motion or to the model."""
    for run in frame.runs:
        reason = foreign_torque(run.raw, model)
        if reason:
            raise InsufficientError(f"{run.name}: {reason}")


def refuse_unsuited(problem: Problem, base: Fit) -> None:
    """Raise InsufficientError if the simulation does not follow the torque, or the friction cannot be determined.

    The friction is checked only for tendon-sheath drives. A rigid drive is also rejected if `drive_scale` returns a
    reason.
    """
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
    """Raise InsufficientError if the friction of a plain drive cannot be determined.

    An identified cause (`named`) may hide the friction, so the check is then skipped.
    """
    if problem.base.target == "tau_m" and not named:
        _refuse_unseen_friction(problem, base)


def refuse_unrelated(
    problem: Problem, held: NDArray[np.bool_], errors: HeldOut, structure: float, formula: Formula | None
) -> None:
    """Raise InsufficientError if neither the model nor its causes explain the torque of a tendon-sheath drive.

    Logs are accepted if the error on held-out data is small enough with the causes, or with a formula of the logged
    signals (for example for a sensor with a wide dead zone). A formula of time does not count, because it follows any
    periodic change.

    Args:
        problem: the logs with the noise model.
        held: held-out samples, (n,).
        errors: errors on the held-out samples.
        structure: share of the residual's mean square that is not noise. If it is 0, the logs are accepted.
        formula: formula of the residual, if there is one.
    """
    if not isinstance(problem.base.given, TendonSheath) or structure <= 0.0:
        return
    torque = float(np.sqrt(np.mean(np.square(problem.frame.target[held]))))
    enough = LEAST_IMPROVEMENT * errors.recalibrated
    described = (
        formula is not None and not formula.tells_when and formula.rms[1] <= enough
    )  # A formula explains some of the error even for unrelated columns.
    if errors.extended > UNRELATED * torque and errors.extended > enough and not described:
        raise InsufficientError(STRANGE)


def refuse_useless(problem: Problem, named: bool, errors: HeldOut) -> None:
    """Raise InsufficientError if the identified causes predict held-out torque no better than a simpler model.

    The simpler models are the recalibrated model, the nominal model, a constant and a straight line. A geared drive is
    accepted if the straight line is the best of them.
    """
    best, error = errors.simplest
    if best == "line" and isinstance(problem.base.given, GearedDrive):
        return  # Except for its losses, a gear is a straight line.
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


def refuse_tied(scales: Scales, found: Refit) -> None:
    """Raise InsufficientError if a joint has an effect, but moves in proportion to others.

    An effect of a joint whose interval contains 0 does not count.
    """
    for effect, parameters in effect_quantities(found).items():
        if CATALOGUE[effect].asks is not Motion.JOINTS:
            continue
        sure = [name for name, q in parameters.items() if isinstance(q, Quantity) and not q.low <= 0.0 <= q.high]
        if reason := inseparable(scales.tied, sure):
            raise InsufficientError(reason)
