"""Predict the joint torque of tendon-sheaths or of a gear, or the motor torque of a plain drive.

Source: (3.55) with the effects in their order of composition. All SI, plain numpy.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.composition import Stack, bending_and_pretension, friction_angle, imbalance
from tsa_ctrl.model.effects.lever import State
from tsa_ctrl.model.effects.memory import Backlash, integrate
from tsa_ctrl.model.effects.specification import Stage
from tsa_ctrl.model.effects.transmission import FourTensions, Transmission
from tsa_ctrl.model.functions import ARRAYS, BLOCK, Array
from tsa_ctrl.model.parameters import GearedDrive, Model, RigidDrive, TendonSheath
from tsa_ctrl.model.signals import Signals, hold_direction
from tsa_ctrl.model.stretch import compliances

# Number of cached friction states and exponentials of one log, their largest size in bytes, and their least number. A
# search requests the same states with every fit. An hour at 1 kHz must need less than a gigabyte.
KEPT, KEPT_BYTES, FEWEST_KEPT = 128, 24_000_000, 2
_ABSENT: Array = np.asarray(np.nan)


def predict(model: Model, signals: Signals) -> Array:
    """Return the joint torque in N*m, shape (n,), or the motor torque for a RigidDrive.

    Raises UsageError if an effect needs a column that the log does not have; the message names both.
    """
    return predict_each(model, [signals])[0]


def predict_each(model: Model, logs: Sequence[Signals]) -> list[Array]:
    """Return the result of `predict` for each of several logs."""
    stack = Stack.of(model.effects, model.source)
    if isinstance(model, RigidDrive):
        return [_predict_rigid(model, stack, signals) for signals in logs]
    if isinstance(model, GearedDrive):
        return [_predict_geared(model, stack, signals) for signals in logs]
    transmission = stack.transmission(model)
    return [_predict_tendon(model, stack, transmission, signals) for signals in logs]


def _predict_tendon(model: TendonSheath, stack: Stack, transmission: Transmission, signals: Signals) -> Array:
    _require_columns(model, signals)
    state = _joint_state(model, stack, signals)
    played_out = _in_play(stack, signals, state)
    growth = _growth(model, stack, transmission, signals, state)
    tau_j = np.empty(len(signals))
    custom = stack.custom_at("joint")
    remembers = stack.custom is not None and bool(stack.custom.program.memories)  # these need the whole log at once
    tendons = np.empty(len(signals)) if remembers and custom is not None else None
    acting = _on_the_tendons(stack, state, signals.tau_m) if remembers and custom is None else None
    for start in range(0, len(signals), BLOCK):
        block = slice(start, start + BLOCK)
        part = _part(state, block)
        known = None if growth is None else growth[block]
        tau_m = _on_the_tendons(stack, part, signals.tau_m[block]) if acting is None else acting[block]
        torque = _tendon_torque(model, stack, transmission, part, tau_m, known)
        if played_out is not None:
            torque = np.where(played_out[block], 0.0, torque)
        if stack.lever is not None:
            torque = stack.lever.apply(ARRAYS, torque, part)
        behind = torque
        for effect in stack.joint:
            torque = torque - effect.torque(ARRAYS, part)
        if tendons is not None:
            tendons[block] = behind
        elif custom is not None:
            torque = torque - custom.taken(behind, part)
        tau_j[block] = torque
    if custom is not None and tendons is not None:
        tau_j -= custom.taken(tendons, state)
    return _sensed(stack, tau_j, signals.t)


def _tendon_torque(
    model: TendonSheath,
    stack: Stack,
    transmission: Transmission,
    state: State[Array],
    tau_m: Array,
    growth: Array | None = None,
) -> Array:
    """Return the torque of the tendons at the joint, N*m, minus the load-dependent friction.

    `tau_m`: N*m on the motor pulley. `growth`: exp(sigma x) if it is known, else None.
    """
    theta, pretension = bending_and_pretension(ARRAYS, model, stack, state)
    if growth is not None and isinstance(transmission, FourTensions):
        torque = transmission.grown(ARRAYS, tau_m, growth, pretension)
    else:
        x = friction_angle(ARRAYS, model, stack, state, theta)
        apart = imbalance(ARRAYS, state, theta)
        torque = transmission.torque(ARRAYS, tau_m, state.sigma, x, pretension, apart)
    return torque if stack.load is None else stack.load.apply(ARRAYS, torque, state.sigma)


def _on_the_tendons(stack: Stack, state: State[Array], tau_m: Array) -> Array:
    """Return the part of the reported motor torque that acts on the pulley, N*m."""
    tau_m = stack.on_the_pulley(ARRAYS, tau_m, state)
    if (custom := stack.custom_at("motor")) is not None:
        tau_m = tau_m - custom.taken(tau_m, state)
    return tau_m


def stretching(model: TendonSheath, signals: Signals) -> tuple[Array, Array]:
    """Return twice the change of tendon b's tension at motor and joint, which elongates the tendons, N, (n,) each.

    They are T3 - T1 and T4 - T2 while both tendons pull. For a tendon that pulls alone, they are twice the difference
    of its tension and the pretension. Effects behind the tendons (joint, load-dependent friction, backlash, delay) are
    not included. Raises UsageError as `predict` does.
    """
    stack = Stack.of(model.effects, model.source)
    _require_columns(model, signals)
    return _ends(model, stack, signals, _joint_state(model, stack, signals))


def stretch(model: TendonSheath, signals: Signals) -> Array:
    """Return s = r_M q_M - r_J q_J of the model while it slides, m, shape (n,), without the zero of the encoders.

    Different path lengths of tendons with different routings are included (3.52). Raises UsageError as `predict` does.
    """
    stack = Stack.of(model.effects, model.source)
    _require_columns(model, signals)
    state = _joint_state(model, stack, signals)
    ends = _ends(model, stack, signals, state)
    motor, joint = compliances(model)
    length = motor * ends[0] + joint * ends[1]
    if signals.theta_difference is not None:
        length = length + model.lever * signals.theta_difference
    if stack.lever is not None:
        length = length + stack.lever.lengthens(ARRAYS, model.joint_pulley_radius, state)
    for effect in stack.stretch:
        length = length + effect.lengthens(ARRAYS, ends, model.joint_pulley_radius, state)
    return length


def _ends(model: TendonSheath, stack: Stack, signals: Signals, state: State[Array]) -> tuple[Array, Array]:
    """Return the result of `stretching` for an existing stack and state."""
    tau_m = _on_the_tendons(stack, state, signals.tau_m)
    theta, pretension = bending_and_pretension(ARRAYS, model, stack, state)
    x = friction_angle(ARRAYS, model, stack, state, theta)
    apart = imbalance(ARRAYS, state, theta)
    torque = stack.transmission(model).torque(ARRAYS, tau_m, state.sigma, x, pretension, apart)
    ends = tau_m / model.motor_pulley_radius, torque / model.joint_pulley_radius
    if stack.slack is None:
        return ends
    alone = np.abs(ends[0]) > 2.0 * pretension
    motor, joint = (np.where(alone, 2.0 * (end - np.sign(ends[0]) * pretension), end) for end in ends)
    return motor, joint


def beyond_slack(model: Model, signals: Signals) -> float:
    """Return the fraction of samples with abs(tau_m) >= 2 T_p r_M, where one tendon is slack; 0 without tendons."""
    if not isinstance(model, TendonSheath):
        return 0.0
    stack = Stack.of(model.effects, model.source)
    _require_columns(model, signals)
    _, pretension = bending_and_pretension(ARRAYS, model, stack, _joint_state(model, stack, signals))
    return float(np.mean(np.abs(signals.tau_m) >= 2.0 * pretension * model.motor_pulley_radius))


def missing_for(
    effect: str, signals: Signals, *, rigid: bool = False, parameters: Mapping[str, Any] | None = None
) -> tuple[str, ...]:
    """Return the columns of which `effect` requires one, if the log has none of them; empty if it can be computed.

    In a plain drive (`rigid`) the motion of the motor, which is always present, replaces that of the joint. The columns
    of a formula depend on its `parameters`.
    """
    spec = CATALOGUE[effect]
    for alternatives in spec.columns if parameters is None or not spec.named else spec.needed_live(parameters):
        if rigid and not {"q_j", "omega_j"}.isdisjoint(alternatives):
            continue
        if not any(name in signals for name in alternatives):
            return alternatives
    return ()


def _require_columns(model: Model, signals: Signals) -> None:
    rigid = isinstance(model, RigidDrive)
    for effect, parameters in model.effects.items():
        columns = missing_for(effect, signals, rigid=rigid, parameters=parameters)
        if columns and CATALOGUE[effect].stage is not Stage.STRETCH:  # these only change the elongation
            raise UsageError(
                f"{model.source or 'model'}: [effects.{effect}] needs column {' or '.join(columns)}, which the log "
                "does not have; record it or remove the effect"
            )
    presliding = model.effects.get("presliding_hysteresis", {})
    if presliding.get("displacement") == "motor" and signals.q_m is None:
        raise UsageError(
            f'{model.source or "model"}: [effects.presliding_hysteresis] displacement = "motor" needs column q_m, '
            'which the log does not have; record it or use "joint"'
        )


def _joint_state(model: TendonSheath | GearedDrive, stack: Stack, signals: Signals) -> State[Array]:
    omega, acceleration = signals.omega_j, _ABSENT
    if stack.velocity_lag is not None or "inertia" in model.effects:
        acceleration = signals.acceleration
    if stack.velocity_lag is not None:
        omega = stack.velocity_lag.true_velocity(omega, acceleration)
    path = None if stack.presliding is None else stack.presliding.path(signals)
    sigma = _sliding(stack, signals, omega, path)
    return State(
        t=signals.t,
        omega=omega,
        acceleration=acceleration,
        q_j=_column(signals.q_j),
        q_m=_column(signals.q_m),
        temperature=_column(signals.temperature),
        theta=_bending(model, signals),
        sigma=sigma,
        start=float(signals.t[0]),
        joints=signals.joints,
        theta_difference=signals.theta_difference,
    )


def _bending(model: TendonSheath | GearedDrive, signals: Signals) -> Array:
    if isinstance(model, GearedDrive):
        return _ABSENT
    return np.asarray(model.bending_angle) if signals.theta is None else signals.theta


def _sliding(stack: Stack, signals: Signals, omega: Array, path: Array | None) -> Array:
    """Return sigma, or z along `path` with presliding; the result is cached, because fits request it many times."""

    def compute() -> Array:
        if stack.presliding is None:
            return hold_direction(omega)
        assert path is not None
        return stack.presliding.state(signals.legs(path), stack.presliding.start(path, signals.t, omega))

    return _kept(signals, ("sigma", stack.velocity_lag, stack.presliding), compute)


def _growth(
    model: TendonSheath, stack: Stack, transmission: Transmission, signals: Signals, state: State[Array]
) -> Array | None:
    """Return exp(sigma x), (n,), if no effect changes x, otherwise None.

    The result is cached, because it takes long to compute and most candidates of a search share it.
    """
    plain = isinstance(transmission, FourTensions) and transmission.symmetric
    if not plain or stack.bending or stack.friction or signals.theta_difference is not None:
        return None
    key = ("growth", stack.velocity_lag, stack.presliding, model.friction_coefficient, model.bending_angle)
    theta = np.maximum(state.theta, 0.0)
    return _kept(signals, key, lambda: ARRAYS.exp(state.sigma * friction_angle(ARRAYS, model, stack, state, theta)))


def _kept(signals: Signals, key: Hashable, compute: Callable[[], Array]) -> Array:
    """Return the result of `compute`, (n,), from the log's memo if it was computed before."""
    known = signals.memo.get(key)
    if known is None:
        known = compute()
        while len(signals.memo) >= min(KEPT, max(FEWEST_KEPT, KEPT_BYTES // known.nbytes)):
            del signals.memo[next(iter(signals.memo))]
        signals.memo[key] = known
    return known


def _predict_rigid(model: RigidDrive, stack: Stack, signals: Signals) -> Array:
    """Return tau_M = J domega/dt + tau_c sign(omega) + b omega + c, N*m, (n,); an effect tau_J -= f adds f to tau_M.

    Effects on the reported torque (gain, ripple) are inverted, because the prediction is that of the reported torque.
    The motion of the motor replaces that of the joint.
    """
    _require_columns(model, signals)
    state = _motor_state(model, stack, signals)
    friction = np.asarray(model.coulomb_friction or 0.0)
    for effect in stack.friction:
        friction = friction * effect.factor(ARRAYS, state)
    tau_m = ARRAYS.at_least(friction, 0.0) * state.sigma + (model.torque_offset or 0.0)
    tau_m = tau_m + (model.viscous_friction or 0.0) * state.omega
    if model.inertia:
        tau_m = tau_m + model.inertia * state.acceleration
    for joint_effect in stack.joint:
        tau_m = tau_m + joint_effect.torque(ARRAYS, state)
    if stack.custom is not None:
        tau_m = tau_m + stack.custom.taken(tau_m, state)
    if stack.load is not None:
        tau_m = stack.load.required(ARRAYS, tau_m, state.sigma)
    for motor_effect in reversed(stack.motor_torque):
        tau_m = motor_effect.invert(ARRAYS, tau_m, state)
    return _sensed(stack, tau_m, signals.t)


def _predict_geared(model: GearedDrive, stack: Stack, signals: Signals) -> Array:
    """Return tau_J = eta^s N tau_M - tau_c sigma - b omega_J, with the effects of the joint, N*m, (n,).

    s is the sign of the power tau_M omega_J. With presliding, sigma is continuous, and so is s.
    """
    _require_columns(model, signals)
    state = _joint_state(model, stack, signals)
    tau_m = _on_the_tendons(stack, state, signals.tau_m)
    torque = model.ratio * tau_m
    if model.efficiency is not None:
        torque = torque * ARRAYS.exp(math.log(model.efficiency) * np.sign(tau_m) * state.sigma)
    friction = np.asarray(model.coulomb_friction or 0.0)
    for effect in stack.friction:
        friction = friction * effect.factor(ARRAYS, state)
    torque = torque - ARRAYS.at_least(friction, 0.0) * state.sigma - (model.viscous_friction or 0.0) * state.omega
    if stack.load is not None:
        torque = stack.load.apply(ARRAYS, torque, state.sigma)
    if (played_out := _in_play(stack, signals, state)) is not None:
        torque = np.where(played_out, 0.0, torque)
    behind = torque
    for joint_effect in stack.joint:
        torque = torque - joint_effect.torque(ARRAYS, state)
    if (custom := stack.custom_at("joint")) is not None:
        torque = torque - custom.taken(behind, state)
    return _sensed(stack, torque, signals.t)


def _in_play(stack: Stack, signals: Signals, state: State[Array]) -> NDArray[np.bool_] | None:
    """Return a mask (n,) of the samples in which the backlash is open; None without backlash."""
    if stack.backlash is None:
        return None
    reversal = _kept(signals, "reversal", lambda: Backlash.last_reversal(state.q_j))
    return stack.backlash.inside(state.q_j, reversal)


def _sensed(stack: Stack, torque: Array, t: Array) -> Array:
    """Return the torque (n,) in N*m as the sensor reports it."""
    for effect in stack.sensor:
        torque = effect.apply(torque, t)
    return torque


def _motor_state(model: RigidDrive, stack: Stack, signals: Signals) -> State[Array]:
    omega = signals.motor_velocity
    if omega is None:
        raise UsageError(
            f"{model.source or 'model'}: a rigid_drive needs column omega_m or q_m, and the log has neither; record one"
        )
    acceleration = _ABSENT
    if stack.velocity_lag is not None or "inertia" in model.effects or model.inertia:
        acceleration = _column(signals.motor_acceleration)
    if stack.velocity_lag is not None:
        omega = stack.velocity_lag.true_velocity(omega, acceleration)
    angle = integrate(omega, signals.t) if signals.q_m is None else signals.q_m
    sigma = _sliding(stack, signals, omega, angle)
    return State(
        t=signals.t,
        omega=omega,
        acceleration=acceleration,
        q_j=angle,
        q_m=_column(signals.q_m),
        temperature=_column(signals.temperature),
        theta=_ABSENT,
        sigma=sigma,
        start=float(signals.t[0]),
    )


def _part(state: State[Array], block: slice) -> State[Array]:
    """Return the state over one block; a constant value is 0-dimensional and is not cut."""

    def of(column: Array) -> Array:
        return column[block] if column.ndim else column

    return State(
        t=of(state.t),
        omega=of(state.omega),
        acceleration=of(state.acceleration),
        q_j=of(state.q_j),
        q_m=of(state.q_m),
        temperature=of(state.temperature),
        theta=of(state.theta),
        sigma=of(state.sigma),
        start=state.start,
        joints={name: of(angle) for name, angle in state.joints.items()},
        theta_difference=None if state.theta_difference is None else of(state.theta_difference),
    )


def _column(column: Array | None) -> Array:
    return _ABSENT if column is None else column
