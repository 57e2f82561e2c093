"""Estimate friction angle x = mu Theta and pretension T_p0 from logs, (3.55)-(3.56), as far as the data identify them.

One configuration identifies only two combinations: slope = r_J/r_M cosh x and friction torque = 2 T_p r_J sinh x. The
slope identifies x only as well as the gain of the torque channels is known, and poorly with little friction. The two
parameters are therefore estimated separately only in one of these cases:

* The bending angle or the pretension varied and is known.
* The motor-side tensions were measured.
* The gain is certified, or known within a few per cent, and the resulting interval is narrower than that of the nominal
  file.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import TooStillError, UsageError
from tsa_ctrl.identify.calibrate.keep_split import bounds, keep_split, least_error, narrower
from tsa_ctrl.identify.calibrate.prepared import PreparedLog, instrument_lag, offsets, prepare, stack, varied
from tsa_ctrl.identify.calibrate.pretension_range import reached, remark
from tsa_ctrl.identify.calibrate.regression import Estimate, solve
from tsa_ctrl.identify.calibrate.result import Calibration
from tsa_ctrl.identify.calibrate.routing import bent_by, curved_routing, fit_routing, moving_joints, resting_joints
from tsa_ctrl.identify.dataset import Dataset, held_out_blocks, held_out_logs, notes_of
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.identify.three_errors import ThreeErrors, three_errors
from tsa_ctrl.identify.torque_scale import friction_beyond
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.steady_sliding import pretension_level

# x and T_p0 follow from several known configurations by Gauss-Newton steps on the instrumented normal equations.

FloatArray = NDArray[np.float64]

ITERATIONS = 8  # most Gauss-Newton steps; the search usually ends earlier, by TOLERANCE
TOLERANCE = 1e-7  # step of ln x and ln T_p that ends the search: files have fewer digits
MOST_LOG = 50.0  # limit of the interval of ln x or ln T_p if the data do not determine the value
GAIN_UNCERTAIN = 0.05  # 95 % uncertainty of the gain from motor to joint torque: torque constant and sensor, 3 % each
BY_SLOPE = 0.5  # share of the file's uncertainty: at x = 0.7 in (3.55), a gain error of 5 % leaves 0.6 of it
STEP = 1e-4  # relative step of numerical derivatives: its errors are far below an interval


@dataclass(frozen=True)
class JointFit:
    """Joint fit of (ln x, ln T_p0, [ln gain], offset of each log) over all configurations."""

    estimate: Estimate
    condition: float
    gain_free: bool


def joint_fit(
    logs: list[PreparedLog], model: TendonSheath, lag: float, certified_gain: bool, gain: float = 1.0
) -> JointFit | None:
    """Return the joint fit by the Gauss-Newton method on the instrumented normal equations.

    The result is None if the data do not determine the parameters.

    Args:
        lag: delay of the instrumental variables in s.
        certified_gain: True to keep the gain at its start value.
        gain: start value of the ratio of the true to the measured motor torque.
    """
    gain_free = not certified_gain
    p = np.array([math.log(model.friction_angle), math.log(model.pretension), math.log(gain), *np.zeros(len(logs))])
    free = [0, 1, *([2] if gain_free else []), *range(3, p.size)]
    zero = offsets(logs)
    estimate = None
    labels = np.concatenate([log.labels[log.mask] for log in logs])
    for _ in range(ITERATIONS):
        x = [_jacobian(log, model, p, log.signals.tau_m, own)[:, free] for log, own in zip(logs, zero, strict=True)]
        z = [_jacobian(log, model, p, log.instrument(lag), own)[:, free] for log, own in zip(logs, zero, strict=True)]
        y = [
            log.tau_j - _response(log, model, p, log.signals.tau_m) - offset
            for log, offset in zip(logs, p[3:], strict=True)
        ]
        rows = np.concatenate([a[log.mask] for a, log in zip(x, logs, strict=True)])
        instruments = np.concatenate([a[log.mask] for a, log in zip(z, logs, strict=True)])
        try:
            estimate = solve(rows, instruments, stack(y, logs), labels)
        except np.linalg.LinAlgError:
            return None
        step = np.clip(estimate.value, -0.5, 0.5)
        p[free] += step
        if not np.all(np.isfinite(p)) or np.any(np.abs(p[:2]) > 20.0):
            return None
        if float(np.max(np.abs(step))) < TOLERANCE:
            break
    assert estimate is not None
    scale = rows / np.linalg.norm(rows, axis=0)
    final = dataclasses.replace(estimate, value=p[free])
    return JointFit(final, float(np.linalg.cond(scale)), gain_free)


def _response(log: PreparedLog, model: TendonSheath, p: FloatArray, tau_m: FloatArray) -> FloatArray:
    variant = model.recalibrated(math.exp(p[0]), math.exp(p[1]) + log.tensioner)
    held = np.where(
        log.mask, log.admission.direction * np.maximum(np.abs(log.signals.omega_j), 1e-9), log.signals.omega_j
    )
    tau_j: FloatArray = predict(variant, dataclasses.replace(log.signals, tau_m=tau_m * math.exp(p[2]), omega_j=held))
    return tau_j


def _jacobian(
    log: PreparedLog, model: TendonSheath, p: FloatArray, tau_m: FloatArray, offset: FloatArray
) -> FloatArray:
    columns = []
    for i in range(3):
        up, down = p.copy(), p.copy()
        up[i] += STEP
        down[i] -= STEP
        columns.append((_response(log, model, up, tau_m) - _response(log, model, down, tau_m)) / (2.0 * STEP))
    return np.column_stack([*columns, offset])


def quantities(joint: JointFit) -> tuple[Quantity, Quantity]:
    """Return friction angle (1) and pretension (N) with their intervals."""
    made = []
    for index, unit in ((0, "1"), (1, "N")):
        low, high = (min(MOST_LOG, max(-MOST_LOG, end)) for end in joint.estimate.interval(index))
        made.append(Quantity(math.exp(float(joint.estimate.value[index])), math.exp(low), math.exp(high), unit))
    return made[0], made[1]


def by_slope(
    logs: list[PreparedLog], model: TendonSheath, lag: float
) -> tuple[tuple[Quantity, Quantity], JointFit] | None:
    """Return x (1) and T_p (N) of one configuration from slope and friction torque, and their fit.

    The gain of the torque channels is known only within `GAIN_UNCERTAIN`. The intervals contain this error. With much
    friction, or bends near the motor, the slope still determines x much better than the file does. Return None if it
    does not, or if the result contradicts the file's [uncertainty]. In the latter case the equation of the transmission
    or a gain is wrong.
    """
    joint = joint_fit(logs, model, lag, True)
    if joint is None or not narrower(quantities(joint), model):
        return None
    other = joint_fit(logs, model, lag, True, 1.0 + GAIN_UNCERTAIN)
    if other is None:
        return None
    x, tension = (
        _widened(one, math.log(two.value / one.value))
        for one, two in zip(quantities(joint), quantities(other), strict=True)
    )
    inside = all(low <= one.value <= high for one, (low, high) in zip((x, tension), bounds(model), strict=True))
    return ((x, tension), joint) if inside and narrower((x, tension), model, BY_SLOPE) else None


def _with_stiffness(
    found: tuple[Quantity, Quantity], logs: list[PreparedLog], model: TendonSheath, lag: float, certified_gain: bool
) -> tuple[Quantity, Quantity]:
    """Return x and T_p with intervals that contain the uncertainty of the file's axial stiffness.

    The wrap angle changes the pretension in proportion to the stiffness (`pretension_slope`). If the wrap angle varies,
    this change separates x from T_p, so an error of the stiffness causes an error of both.
    """
    uncertain = model.axial_stiffness_uncertainty
    if uncertain == 0.0:
        return found
    stiffer = dataclasses.replace(model, axial_stiffness=model.axial_stiffness * (1.0 + uncertain))
    other = joint_fit(logs, stiffer, lag, certified_gain)
    if other is None:
        return found
    x, tension = (
        _widened(one, math.log(two.value / one.value)) for one, two in zip(found, quantities(other), strict=True)
    )
    return x, tension


def _widened(found: Quantity, ratio: float) -> Quantity:
    """Return the quantity with an interval that contains a second error of exp(+-ratio), independent of the first."""
    low, high = (math.hypot(math.log(end / found.value), ratio) for end in (found.low, found.high))
    return Quantity(found.value, found.value * math.exp(-low), found.value * math.exp(high), found.unit)


def combinations_of(joint: JointFit, model: TendonSheath) -> tuple[Quantity, Quantity]:
    """Return slope (1) and friction torque (N*m) at the model's own configuration from the joint fit (delta method)."""
    value = joint.estimate.value
    x, tension = math.exp(value[0]), math.exp(value[1])
    gain = math.exp(value[2]) if joint.gain_free else 1.0
    slope = model.joint_pulley_radius / model.motor_pulley_radius * math.cosh(x) * gain
    loop = 2.0 * tension * model.joint_pulley_radius * math.sinh(x)
    by_slope = np.zeros(value.size)
    by_slope[0] = slope * x * math.tanh(x)
    if joint.gain_free:
        by_slope[2] = slope
    by_loop = np.zeros(value.size)
    by_loop[0], by_loop[1] = loop * x / math.tanh(x), loop
    made = []
    for centre, gradient, unit in ((slope, by_slope, "1"), (loop, by_loop, "N*m")):
        low, high = joint.estimate.interval_of(gradient)
        shift = centre - 0.5 * (low + high)
        made.append(Quantity(centre, low + shift, high + shift, unit))
    return made[0], made[1]


MIN_BLOCKS = 8  # Student's t is 2.4 with 7 degrees of freedom; half as many blocks yield 3.2, so intervals are useless


def _base_target(log: PreparedLog, model: TendonSheath) -> FloatArray:
    """Return the measured joint torque minus the contribution of the model's effects to (3.55), N*m.

    The contribution is computed with the present parameters of the model.
    """
    if not model.effects:
        return log.tau_j
    bare = dataclasses.replace(model, effects={})
    return log.tau_j - predict(model, log.signals) + predict(bare, log.signals)


def _linear(logs: list[PreparedLog], model: TendonSheath, lag: float, weight: list[FloatArray]) -> Estimate:
    """Return the estimate of a, b and one c for each log in tau_J = a tau_M - b weight sigma + c."""
    x, z, y = [], [], []
    for log, w, offset in zip(logs, weight, offsets(logs), strict=True):
        rest = (-w * log.admission.direction, offset)
        x.append(np.column_stack([log.signals.tau_m, *rest]))
        z.append(np.column_stack([log.instrument(lag), *rest]))
        y.append(_base_target(log, model))
    labels = np.concatenate([log.labels[log.mask] for log in logs])
    if np.unique(labels).size < MIN_BLOCKS:
        raise TooStillError("calibrate: too few stretches of steady motion for an honest interval; record longer logs")
    try:
        return solve(stack(x, logs), stack(z, logs), stack(y, logs), labels)
    except np.linalg.LinAlgError:
        raise TooStillError(
            "calibrate: load and direction do not vary independently; vary the load in both directions"
        ) from None


def combinations(logs: list[PreparedLog], model: TendonSheath, lag: float) -> tuple[Quantity, Quantity]:
    """Return slope (1) and friction torque (N*m), which one configuration identifies.

    `lag`: delay of the instrumental variables in s.
    """
    estimate = _linear(logs, model, lag, [np.ones(log.tau_j.size) for log in logs])
    slope = Quantity(float(estimate.value[0]), *estimate.interval(0), "1")
    return slope, Quantity(float(estimate.value[1]), *estimate.interval(1), "N*m")


def from_tensions(
    logs: list[PreparedLog], model: TendonSheath, lag: float
) -> tuple[tuple[Quantity, Quantity], float] | None:
    """Return friction angle (1) and pretension (N) from the motor-side tensions T1 and T3, and the condition number.

    T_p is then measured (3.40), so the friction torque depends on sinh x alone. Return None without tensions.

    (3.37) holds for the measured tensions wherever the sheath bends, so the torque of `elongation_coupling` is not
    subtracted. The effect only determines the difference between the tension while sliding and T_p0 (3.54).
    """
    if any(log.tensions is None for log in logs):
        return None
    weight = [2.0 * model.joint_pulley_radius * log.tensions for log in logs if log.tensions is not None]
    measured = dataclasses.replace(
        model, effects={k: v for k, v in model.effects.items() if k != "elongation_coupling"}
    )
    estimate = _linear(logs, measured, lag, weight)
    low, high = estimate.interval(1)
    x = Quantity(math.asinh(float(estimate.value[1])), math.asinh(low), math.asinh(high), "1")
    ones = [np.column_stack([np.ones(log.tau_j.size), log.admission.direction * log.signals.tau_m]) for log in logs]
    pretension = [log.tensions - log.tensioner for log in logs if log.tensions is not None]
    labels = np.concatenate([log.labels[log.mask] for log in logs])
    rows = np.concatenate([o[log.mask] for o, log in zip(ones, logs, strict=True)])
    tension = solve(rows, rows, stack(pretension, logs), labels)
    level = pretension_level(model, x.value)
    condition = float(np.sqrt(estimate.covariance[1, 1])) / max(abs(float(estimate.value[1])), 1e-12)
    value, (low, high) = float(tension.value[0]), tension.interval(0)
    return (x, Quantity(value / level, low / level, high / level, "N")), 1.0 + condition


Split = Literal["keep", "fit"]

# Relative uncertainty of the gain of a torque channel, or of a torque estimated from the elongation: a slope that is
# below r_J/r_M by no more than this does not contradict (3.55).
GAIN = 0.03
HELD_OUT_BLOCKS = 6  # number of blocks of a log if no whole log is held out; every third block is held out
EFFECT_ITERATIONS = 20  # most iterations; with all bends at the motor, 0.12 of the error remains at x = 0.3, 0.55 at 1
SETTLED = 1e-4  # relative change of the friction torque that ends the iteration: intervals are 100 times as wide
# s omitted between a held-out block and the rest: twice the correlation time of the noise (prepared.LAG_LIMIT)
GAP = 1.0
GAP_SHARE = 0.25  # largest gap as a share of a block, so that a short log keeps enough samples


def calibrate(
    logs: Sequence[Dataset],
    model: TendonSheath,
    *,
    certified_gain: bool = False,
    tensioner: Mapping[str, float] | None = None,
    hold_out: str | None = None,
    split: Split = "keep",
) -> Calibration:
    """Estimate x and T_p0 of `model` from logs with the columns t, tau_m, tau_j and omega_j (or q_j).

    If the logs have columns q_j.NAME of joints that move, the gains by which these joints bend the sheaths are
    estimated as well. They are in the [routing] of the result's model.

    Args:
        certified_gain: True if the gain of the torque channels is certified, so that the slope determines x.
        tensioner: known change of the pretension in N by log name (patterns allowed).
        hold_out: pattern of the logs on which the errors are measured. The default is every third log by name, or
            blocks of each log if there are fewer than three logs.
        split: "keep" keeps the file's proportion of x and T_p if the data cannot separate them. "fit" then chooses both
            by least simulation error within [uncertainty]. A slope below r_J/r_M has the effect of "fit", because
            (3.55) has no such slope for any proportion.

    Raises:
        UsageError: the logs do not determine the parameters (the message has the reason), or a column is missing.
    """
    if model.friction_angle == 0.0 or model.pretension == 0.0:
        raise UsageError(f"{model.source or 'model'}: friction angle and pretension must be above 0 to be calibrated")
    prepared = prepare(logs, model, tensioner or {})
    result = _fit(prepared, model, certified_gain, split)
    impossible = friction_beyond(model, result.half_loop_torque)
    if impossible and not model.effects:
        raise UsageError(f"calibrate: {impossible}")
    train, test = _held_out(prepared, hold_out)
    after = _fit(train, model, certified_gain, split).model
    found = result.written(result.model)
    tension = remark(found, reached(log.signals.tau_m for log in prepared))
    return dataclasses.replace(
        result,
        rms_before=_rms(test, model),
        rms_after=_rms(test, after),
        rms_given=_rms(prepared, model),
        rms_written=_rms(prepared, found),
        sliding_before=_rms(test, model, sliding=True),
        sliding_after=_rms(test, after, sliding=True),
        sliding_given=_rms(prepared, model, sliding=True),
        sliding_written=_rms(prepared, found, sliding=True),
        model=found,
        notes=(*notes_of(logs), *result.notes, *([tension] if tension else [])),
        errors=errors_of(logs, found),
    )


def routing_of_logs(logs: Sequence[Dataset], model: TendonSheath, certified_gain: bool) -> TendonSheath | None:
    """Return the model with the routing estimated from the logs; None if no joint bends its sheaths.

    Raises:
        UsageError: the logs cannot be used, as in `calibrate`.
    """
    found = fit_routing(prepare(logs, model, {}), model, certified_gain)
    return None if found is None else found.model


def errors_of(logs: Sequence[Dataset], model: TendonSheath) -> ThreeErrors:
    """Return the errors of `model` on all samples of the logs; they are unknown if a log lacks the joint torque."""
    if not all("tau_j" in log for log in logs):
        return ThreeErrors()
    logs = [log.completed_for(model) for log in logs]
    residuals = [log["tau_j"] - predict(model, log.signals()) for log in logs]
    return three_errors(logs, residuals, "tau_j")


def _fit(logs: list[PreparedLog], model: TendonSheath, certified_gain: bool, split: Split) -> Calibration:
    routed = fit_routing(logs, model, certified_gain)
    curved = curved_routing(logs, model, routed)
    notes = []
    if curved:  # Gains fitted to a curve are not properties of the rig, nor is a difference between the tendons.
        notes, routed = [curved], None
    elif routed is None and model.routing is not None:
        moved = [name for name in moving_joints(logs) if name in model.routing.joints]
        notes += [f"the logs show no other routing by {', '.join(moved)} than the file: it is kept"] if moved else []
    notes += [resting] if (resting := resting_joints(logs, model)) else []
    if routed is not None:
        notes.append(routed.sentence)
        model = routed.model
        logs = [bent_by(log, model) for log in logs]
    lag = instrument_lag(logs)
    several = varied(logs, model)
    joint = joint_fit(logs, model, lag, certified_gain) if several or certified_gain else None
    if several and joint is not None:
        slope, half_loop = combinations_of(joint, model)
    else:
        slope, half_loop = _combinations(logs, model, lag)
    measured = from_tensions(logs, model, lag)
    found, condition = None, math.inf
    if measured is not None:
        found, condition = measured
    elif routed is not None:
        found, condition = (routed.friction_angle, routed.pretension), math.inf if joint is None else joint.condition
    elif joint is not None:
        found, condition = _with_stiffness(quantities(joint), logs, model, lag, certified_gain), joint.condition
    sloped = by_slope(logs, model, lag) if found is None and split == "keep" else None
    if sloped is not None:
        found, joint = sloped
        condition, (slope, half_loop) = joint.condition, combinations_of(joint, model)
    is_split = found is not None and (routed is not None or narrower(found, model))
    ratio = model.joint_pulley_radius / model.motor_pulley_radius
    impossible = slope.high < (1.0 - GAIN) * ratio and not model.effects
    if impossible:
        notes.append(
            f"the slope {slope} lies below r_J/r_M = {ratio:.4g}, which no friction angle gives: "
            "an effect is missing or a gain is wrong; `tsa diagnose` identifies it"
        )
    if found is not None and is_split:
        x, tension = found
    else:
        if found is not None:
            notes.append("the data part x and T_p less well than [uncertainty] does: the file's proportion is kept")
        x, tension = least_error(logs, model) if split == "fit" or impossible else keep_split(model, half_loop, notes)
        if impossible and split == "keep":
            notes.append("so x and T_p are the values of least simulation error within [uncertainty]")
    for name, quantity, (low, high) in zip(("friction angle", "pretension"), (x, tension), bounds(model), strict=True):
        if not low * 0.999 <= quantity.value <= high * 1.001:
            notes.append(f"the {name} {quantity} lies outside the file's [uncertainty], {low:.4g} to {high:.4g}")
    return Calibration(
        friction_angle=x,
        pretension=tension,
        slope=slope,
        half_loop_torque=half_loop,
        split=is_split,
        by_slope=sloped is not None,
        condition_number=condition,
        admitted_seconds=sum(log.admission.seconds for log in logs),
        refused=tuple(sorted({name for log in logs for name in log.admission.refused})),
        rms_before=math.nan,
        rms_after=math.nan,
        rms_given=math.nan,
        rms_written=math.nan,
        experiment="" if is_split else _experiment(model),
        notes=tuple(notes),
        model=model.recalibrated(x.value, tension.value),
        routing={} if routed is None else routed.quantities,
    )


def _combinations(logs: list[PreparedLog], model: TendonSheath, lag: float) -> tuple[Quantity, Quantity]:
    """Return `combinations` with the model's effects subtracted at the x and T_p that follow from the result.

    Effects may depend on x and T_p, so the result is found by iteration.
    """
    found = combinations(logs, model, lag)
    for _ in range(EFFECT_ITERATIONS if model.effects else 0):
        before = found[1].value
        x, tension = keep_split(model, found[1], [])
        found = combinations(logs, model.recalibrated(x.value, tension.value), lag)
        if abs(found[1].value - before) <= SETTLED * abs(before):
            break
    return found


def _experiment(model: TendonSheath) -> str:
    force, angle = 0.4 * model.pretension, 0.4 * model.bending_angle
    return (
        f"record the same motion once more with the tensioner set {force:.0f} N higher (a known change of the "
        f"pretension), or with the sheath bent by {angle:.1f} rad more (column theta): "
        "the friction torque at both settings separates friction angle and pretension"
    )


def _held_out(logs: list[PreparedLog], pattern: str | None) -> tuple[list[PreparedLog], list[PreparedLog]]:
    """Return the logs for the fit and the held-out logs: whole logs, or blocks of each log with gaps between them."""
    held = held_out_logs([log.name for log in logs], pattern)
    if held:
        return [log for log in logs if log.name not in held], [log for log in logs if log.name in held]
    train, test = [], []
    for log in logs:
        n = log.tau_j.size
        period = float(log.signals.t[1] - log.signals.t[0])
        gap = round(min(GAP / period, GAP_SHARE * n / HELD_OUT_BLOCKS))
        fit, out = held_out_blocks(n, HELD_OUT_BLOCKS, 2, gap)
        train.append(log.restricted(fit))
        test.append(log.restricted(out))
    return train, test


def _rms(logs: list[PreparedLog], model: TendonSheath, sliding: bool = False) -> float:
    """Return the RMS simulation error in N*m over all samples, or with `sliding` where the joint certainly slides.

    The result is nan without such samples. The friction of (3.55) reverses at once, but real tendons need some travel
    to reverse it. During reversals a model with more friction therefore has the larger error, even if it is correct.
    Only the error while sliding decides which of two models is better.
    """
    errors = []
    for log in logs:
        variant = model.recalibrated(pretension=model.pretension + log.tensioner)
        errors.append((predict(variant, bent_by(log, model).signals) - log.tau_j)[log.mask if sliding else log.chosen])
    every = np.concatenate(errors)
    return float(np.sqrt(np.mean(np.square(every)))) if every.size else math.nan
