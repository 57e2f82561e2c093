"""Estimate a new model from logs: friction angle, pretension, and the form of the transmission with the least error."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.calibrate import Calibration, calibrate
from tsa_ctrl.identify.calibrate.prepared import PreparedLog, prepare
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.quantity import BLOCKS, Quantity, jackknife
from tsa_ctrl.model.catalogue import CATALOGUE, of_the_stretch
from tsa_ctrl.model.composition import pretension_at
from tsa_ctrl.model.curvature import NAMED, Points, Profile
from tsa_ctrl.model.feedforward import Feedforward
from tsa_ctrl.model.functions import ARRAYS, SCALARS
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.steady_sliding import bending_centre
from tsa_ctrl.tune.delay import EFFECT, velocity_lag, with_lag

if TYPE_CHECKING:
    from tsa_ctrl.identify.diagnosis import Diagnosis


# Estimate where a sheath bends from the tendon elongation, which the angles of motor and joint show.
#
# While both tendons slide, the difference e of the angles is linear in the motor torque by (3.37)-(3.41).
#
# e = tau_M / K_s - sigma g / K_s,     g = T_p r_M (A(x) - A(-x)) / (A(x) A(-x)),     A(rho) = mean of exp(rho b)
#
# K_s is the stiffness while sliding. To first order in x, g is (1 - s_c) h, with the friction torque h at the motor and
# the centre s_c of the bending. Hence g is h with all bends at the motor, and 0 with all bends at the joint. Both terms
# have the same scale, so the result does not depend on the tendon stiffness or the gain of the joint torque. The result
# is one profile with that centre: an even bend from the motor to a point, or from a point to the joint. Two bends with
# the same centre (an S) have the same transmission to second order in x. Their reversals differ by less than 1 % of
# the friction.

FloatArray = NDArray[np.float64]

DIGITS = 3  # decimals of a point's position as a share of the length; more than the interval justifies
FLOOR = 0.01  # of s_c, least half width of an interval, because pulleys and encoders are not known more accurately
NAMES = {0.0: "motor_end", 0.5: "uniform", 1.0: "joint_end"}  # centres of the profiles that have a name


@dataclass(frozen=True)
class Bends:
    """The bends of a sheath.

    Attributes:
        centre: position s_c of the centre of the bends, 0 at the motor and 1 at the joint.
        profile: curvature profile as in a model file.
    """

    centre: Quantity
    profile: str | Points


def course(centre: float) -> Points:
    """Return the profile of an even bend that starts at one end of the sheath and has the centre `centre` (1)."""
    if centre <= 0.5:
        end = round(2.0 * centre, DIGITS)
        return NAMED["motor_end"] if end == 0.0 else ((0.0, 0.0), (end, 1.0), (1.0, 1.0))
    start = round(2.0 * centre - 1.0, DIGITS)
    return NAMED["joint_end"] if start >= 1.0 else ((0.0, 0.0), (start, 0.0), (1.0, 1.0))


def wound(profile: Profile, x: float) -> float:
    """Return g / (2 T_p r_M) at the friction angle x."""
    alpha, beta = profile.elongations(SCALARS, x)
    return 0.5 * (alpha - beta) / (alpha * beta)


def lost(profile: Profile, x: float) -> float:
    """Return f(x) = h / (2 T_p r_M), with the friction torque h at the motor.

    f is tanh x with all bends at the joint, x for an even bend, and sinh x with all bends at the motor.
    """
    alpha, beta = profile.elongations(SCALARS, x)
    return 2.0 * math.sinh(x) / (alpha * math.exp(-x) + beta * math.exp(x))


def bends(logs: Sequence[Dataset], model: TendonSheath) -> Bends | None:
    """Return the bends from logs with q_m and q_j in addition to the torques, or None if a log lacks these angles.

    The result is also None for a model with a series spring, because its elongation does not depend on the bends.

    Args:
        logs: logs of a sliding joint.
        model: model that provides x and the radii.

    Raises:
        UsageError: The joint slides too little.
    """
    if model.series_stiffness is not None or not all({"q_m", "q_j"} <= set(log.columns) for log in logs):
        return None
    prepared = {log.name: log for log in prepare(logs, model, {})}
    rows = [_rows(log, prepared[log.name], model) for log in logs if log.name in prepared]
    squares = [(a.T @ a, a.T @ b) for a, b in (part for pair in rows for part in _blocks(*pair))]
    ratio, half = jackknife(squares, _ratio)
    x = model.friction_angle
    centres = [_centre(share, x) for share in (ratio, ratio + half, ratio - half)]
    centre = Quantity(centres[0], max(0.0, min(centres) - FLOOR), min(1.0, max(centres) + FLOOR), "1")
    for named, profile in NAMES.items():
        if centre.low <= named <= centre.high:
            return Bends(centre, profile)
    return Bends(centre, course(centre.value))


def _rows(log: Dataset, prepared: PreparedLog, model: TendonSheath) -> tuple[FloatArray, FloatArray]:
    """Return the regressors 1, tau_M, sigma, q_J (n, 4) and the targets e, tau_J (n, 2) of the sliding samples.

    sigma is scaled by the ratio of the model's friction torques at the present and at the nominal wrap angle. The joint
    angle absorbs the errors of the ratio of the radii and of the motor inertia.
    """
    mask = prepared.mask
    completed = log.completed_for(model)
    angle = log["q_j"][mask]
    direction = prepared.admission.direction * friction_share(completed, model)
    columns = (np.ones(angle.size), log["tau_m"][mask], direction[mask], angle)
    return np.column_stack(columns), np.column_stack((beyond_joint(completed, model)[mask], log["tau_j"][mask]))


def beyond_joint(log: Dataset, model: TendonSheath) -> FloatArray:
    """Return the motor angle minus the geared joint angle and the path difference (3.52), rad, (n,).

    `log` must be completed for the model.
    """
    beyond = log["q_m"] - model.joint_pulley_radius / model.motor_pulley_radius * log["q_j"]
    if "theta_difference" in log:
        beyond = beyond - model.lever / model.motor_pulley_radius * log["theta_difference"]
    return beyond


def friction_share(log: Dataset, model: TendonSheath) -> FloatArray:
    """Return the ratio of the model's friction torques at the wrap angle of each sample and at Theta_0, 1, (n,).

    `log` must be completed for the model. To first order in x the friction torque is proportional to x T_p.
    """
    if "theta" not in log:
        return np.ones(len(log))
    theta = log["theta"]
    tension = pretension_at(ARRAYS, model, theta)
    return np.maximum(theta, 0.0) * tension / (model.bending_angle * model.pretension)


def _blocks(columns: FloatArray, given: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    return list(zip(np.array_split(columns, BLOCKS), np.array_split(given, BLOCKS), strict=True))


def _ratio(squares: FloatArray, products: FloatArray) -> float:
    """Return g / h from the normal equations of both lines."""
    angle, torque = np.linalg.solve(squares, products).T
    return float((angle[2] / angle[1]) / (torque[2] / torque[1]))


def _centre(ratio: float, x: float) -> float:
    """Return s_c (1) for a ratio g / h at the friction angle x."""

    def beyond(centre: float) -> float:
        profile = Profile.of(course(centre))
        return wound(profile, x) / lost(profile, x) - ratio

    if beyond(0.0) <= 0.0:
        return 0.0
    return 1.0 if beyond(1.0) >= 0.0 else float(brentq(beyond, 0.0, 1.0, xtol=1e-3))


CLEARLY_BETTER = 0.9  # of the given form's error: the error of a chosen form must be smaller
KEPT = 0.95  # share of the samples that count when forms are compared, so that outliers do not decide
LEAST_GAIN = 0.5  # 1, share of the possible improvement on held-out data that an extension must achieve
PERIOD = 1e-3  # s, period of a controller that tries to use an extension; the result does not depend on it
COUPLING = "elongation_coupling"


class Form(Enum):
    """The form of the transmission. The values are printed."""

    GIVEN = "as in the file"
    UNIFORM = "full model (3.53), evenly bent sheath"
    MOTOR_END = "full model (3.53), sheath bent at the motor"
    JOINT_END = "full model (3.53), sheath bent at the joint: (3.55)"
    ANGLES = "full model (3.53), curvature from the angles of motor and joint"


NAMED_FORMS = {"uniform": Form.UNIFORM, "motor_end": Form.MOTOR_END, "joint_end": Form.JOINT_END}


@dataclass(frozen=True)
class Estimate:
    """A new model and its derivation.

    Attributes:
        model: new model.
        calibration: calibration of the chosen form of the transmission.
        form: chosen form of the transmission.
        effects: names of the added effects.
        notes: notes for the report.
        parameters: other estimated values by name. The name of an effect's parameter is "effect.parameter".
        plain: estimate from the same logs without the effects that the diagnosis added; None if it added none.
    """

    model: TendonSheath
    calibration: Calibration
    form: Form
    effects: tuple[str, ...]
    notes: tuple[str, ...]
    parameters: Mapping[str, Quantity] = dataclasses.field(default_factory=dict)
    plain: Estimate | None = None


def estimate(
    logs: Sequence[Dataset],
    model: TendonSheath,
    certified_gain: bool,
    forms: bool,
    routed: TendonSheath | None = None,
) -> Estimate:
    """Return the estimate of `model` from logs.

    If the logs have the angles of motor and joint, these show where the sheath bends. Otherwise the function tries an
    evenly bent sheath and a sheath that is bent at the motor.

    Args:
        logs: logs of a sliding joint.
        model: model of the given file.
        certified_gain: True if the gain of the torque channels is certified.
        forms: True to also estimate where the sheath bends and the lag of the velocity.
        routed: model with the routing from the logs; None if no other joint bends the sheaths.

    Raises:
        UsageError: The logs do not determine the parameters.
    """
    excluded = set(CATALOGUE[COUPLING].excludes) & set(model.effects)
    found_bends = bends(logs, routed or model) if forms and not excluded else None
    if found_bends is not None:
        return _late(_bent(logs, model, found_bends, certified_gain), logs)
    candidates = {Form.GIVEN: model}
    if forms and not excluded and COUPLING not in model.effects:
        for form, profile in ((Form.UNIFORM, "uniform"), (Form.MOTOR_END, "motor_end")):
            effects = {**model.effects, COUPLING: {"curvature_profile": profile}}
            candidates[form] = model.with_effects(effects)
    found = {}
    for form, candidate in candidates.items():
        try:
            found[form] = calibrate(logs, candidate, certified_gain=certified_gain)
        except UsageError:
            if form is Form.GIVEN:
                raise
    errors = {form: sliding_error(logs, result.model) for form, result in found.items()}
    best = min(errors, key=lambda form: errors[form])
    if errors[best] > CLEARLY_BETTER * errors[Form.GIVEN]:
        best = Form.GIVEN
    notes = list(found[best].notes)
    if best is not Form.GIVEN:
        notes.append(
            f"{best.value} predicts sliding better than the given form ({1e3 * errors[best]:.1f} against "
            f"{1e3 * errors[Form.GIVEN]:.1f} mN*m); at a single bending angle an error of the "
            "torque constant would look the same"
        )
    chosen = Estimate(found[best].model, found[best], best, (), tuple(notes))
    return _late(chosen, logs) if forms else chosen


def _bent(logs: Sequence[Dataset], model: TendonSheath, found: Bends, certified_gain: bool) -> Estimate:
    """Return the estimate with the bends from the angles, or with the given profile if it agrees with them.

    With all bends at the joint, the transmission is (3.55), but the profile is still written. A model without a
    curvature profile does not determine how a reversal travels through the sheath, and the law would assume an even
    bend.
    """
    form, bent = Form.GIVEN, model
    if COUPLING not in model.effects or not found.centre.low <= bending_centre(model) <= found.centre.high:
        form = NAMED_FORMS.get(str(found.profile), Form.ANGLES)
        profile = found.profile if isinstance(found.profile, str) else [list(point) for point in found.profile]
        bent = model.with_effects({**model.effects, COUPLING: {"curvature_profile": profile}})
    result = calibrate(logs, bent, certified_gain=certified_gain)
    notes = [*result.notes]
    if form is not Form.GIVEN:
        given = f"the file has it at {bending_centre(model):.2f}"
        if COUPLING not in model.effects:
            given = "the file's transmission (3.55) has all bends at the joint"
        notes.append(
            f"the angles of motor and joint show the centre of the bending at {found.centre.value:.2f} of the sheath's "
            f"length from the motor ({found.centre.low:.2f} to {found.centre.high:.2f}); {given}: {form.value}"
        )
    return Estimate(
        model=result.model,
        calibration=result,
        form=form,
        effects=(),
        notes=tuple(notes),
        parameters={"centre of the bending": found.centre},
    )


def _late(chosen: Estimate, logs: Sequence[Dataset]) -> Estimate:
    """Return the estimate with the velocity lag from the logs, or the unchanged estimate if they show none."""
    lag = velocity_lag(logs, chosen.model)
    if lag is None:
        return chosen
    model = with_lag(chosen.model, lag.value)
    return dataclasses.replace(
        chosen,
        model=model,
        calibration=dataclasses.replace(chosen.calibration, model=model),
        effects=(EFFECT,),
        notes=(*chosen.notes, f"the log's velocity lags by {1e3 * lag.value:.2f} ms"),
        parameters={**chosen.parameters, f"{EFFECT}.time_constant": lag},
    )


def sliding_error(logs: Sequence[Dataset], model: TendonSheath) -> float:
    """Return the RMS prediction error (N*m) of the sliding samples, without its median and without the worst samples.

    Reversals and standstill are excluded, because all forms have similar errors there.
    """
    prepared = prepare(logs, model, {})
    errors = np.concatenate([(predict(model, log.signals) - log.tau_j)[log.mask] for log in prepared])
    errors = np.abs(errors - np.median(errors))
    return float(np.sqrt(np.mean(np.square(errors[errors <= np.quantile(errors, KEPT)]))))


def extended(logs: Sequence[Dataset], model: TendonSheath, without: Estimate) -> Estimate:
    """Return the estimate with the effects that a diagnosis identifies, or `without` if these effects are not certain.

    The effects are certain if three conditions hold. Each cause is identified without alternatives, the improvement on
    held-out data is at least `LEAST_GAIN`, and a controller can use the model.
    """
    from tsa_ctrl.identify.diagnosis import diagnose

    found = diagnose(list(logs), model)
    causes = found.of_torque
    open_names = ", ".join(cause.effect for cause in causes if cause.alternatives)
    if not causes or not isinstance(found.model, TendonSheath):
        return dataclasses.replace(without, notes=(*without.notes, f"diagnosis: {found.sentence}"))
    beside, _ = of_the_stretch(found.model.effects)
    better = found.model.with_effects({name: v for name, v in found.model.effects.items() if name not in beside})
    reason = f"alternatives to {open_names} are not excluded" if open_names else ""
    if found.gain < LEAST_GAIN:
        reason = f"its gain is {found.gain:.0%}, at least {LEAST_GAIN:.0%} is needed"
    try:
        notes = Feedforward(better, PERIOD).notes
    except UsageError as error:
        reason = str(error)
    if reason:
        note = f"diagnosis: {found.sentence} Not used: {reason}"
        return dataclasses.replace(without, notes=(*without.notes, note))
    return Estimate(
        model=better,
        calibration=_as_extended(without.calibration, found, better),
        form=Form.GIVEN,
        effects=tuple(cause.effect for cause in causes),
        notes=(f"diagnosis: {found.sentence}", *notes),
        parameters={
            f"{cause.effect}.{name}": value
            for cause in causes
            for name, value in cause.parameters.items()
            if isinstance(value, Quantity) and value.low < value.high  # counts and choices are not measured
        },
        plain=without,
    )


def _as_extended(without: Calibration, found: Diagnosis, model: TendonSheath) -> Calibration:
    """Return the calibration with the parameters of the diagnosis.

    The intervals of x and T_p do not shrink, unless the diagnosis itself determines these parameters.
    """
    errors = {name: error.found for name, error in found.parameter_errors.items()}

    def still_open(before: Quantity, value: float) -> Quantity:
        return Quantity(value, min(before.low, value), max(before.high, value), before.unit)

    before, after = found.rms.as_given, found.rms.extended
    held_out: dict[str, Any] = {}
    if before is not None and after is not None:
        held_out = {"rms_before": before, "rms_after": after, "sliding_before": before, "sliding_after": after}
    return dataclasses.replace(
        without,
        friction_angle=errors.get("friction_angle", still_open(without.friction_angle, model.friction_angle)),
        pretension=errors.get("pretension", still_open(without.pretension, model.pretension)),
        half_loop_torque=errors.get("half_loop_torque", without.half_loop_torque),
        slope=errors.get("slope", without.slope),
        model=model,
        **held_out,
    )
