"""Invert the model in the control loop: compute the motor torque that delivers a desired joint torque.

Source: the feedforward law of (3.55), tau_M = r_M/cosh(x) (tau_J*/r_J + 2 T_p sigma sinh(x)). The effects are inverted
in the reverse order of composition. SI units, plain floats, no clock, no I/O.
"""

from __future__ import annotations

import math
from collections.abc import Collection

from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.composition import Stack, bending_and_pretension, friction_angle
from tsa_ctrl.model.effects.invertible import check_invertible
from tsa_ctrl.model.effects.joint import ACCELERATION_TIME
from tsa_ctrl.model.effects.lever import State, unmoved
from tsa_ctrl.model.effects.memory import PreslidingState
from tsa_ctrl.model.filters import Memories
from tsa_ctrl.model.functions import SCALARS
from tsa_ctrl.model.parameters import TendonSheath

MOST_PERIODS = 1000.0  # between two updates; after a longer gap, the watchdogs have removed the torque
LARGEST_ANGLE = 10.0  # 1, friction angle of a tension ratio of 22000; larger values would only overflow

_LINEAR = frozenset({"elongation_coupling", "sheath_asymmetry"})  # effects that only change the line of tau_J in tau_M
_OPTIONAL = ("q_j", "q_m", "temperature")  # signals that an axis may lack


class Feedforward:
    """Compute tau_M for a desired tau_J by the model and its effects.

    `signals`: names of the optional signals (q_j, q_m, temperature) that this axis measures, for `notes`; default all.
    A measurement that is nan keeps its last value. An effect is omitted until its measurement has arrived
    (`left_out`). `notes` lists the effects that are not, or not exactly, compensated, with the reason.
    """

    def __init__(self, model: TendonSheath, period: float, signals: Collection[str] = _OPTIONAL) -> None:
        self._model = model
        self._period = period
        custom = Stack.of(model.effects, model.source).custom
        if custom is not None:  # up to twice the torque that both tendons carry without slack
            largest = 4.0 * max(model.pretension, 1.0) * max(model.motor_pulley_radius, model.joint_pulley_radius)
            check_invertible(custom, largest, period, model.source or "model")
        self._memories = Memories(()) if custom is None else custom.memories()
        self.notes: tuple[str, ...] = tuple(_notes(model, signals))
        self.reset()

    @property
    def model(self) -> TendonSheath:
        """Return the model in use, with the values of `set`."""
        return self._model

    def reset(self) -> None:
        """Reset the friction state, the memories of a formula, the start time and the held measurements."""
        self._state = unmoved(self._model.bending_angle)
        self._started = False
        self._last_omega = math.nan
        self._presliding: PreslidingState | None = None
        self._by_motor = False
        self._pulling: tuple[float, float] | None = None  # N*m, `limits` of tau_M at the last update
        self._line: _Line | None = None  # at the last update, for a model that is a line
        self.clipped = False  # the last update ended at a bound of the domain
        self._imbalance = 0.0  # 1, of the tendons' friction angles
        self._memories.reset()
        self._use_effects()
        self.friction_angle = self._model.friction_angle
        self.pretension = self._model.pretension

    def set(self, friction_angle: float | None = None, pretension: float | None = None, imbalance: float = 0.0) -> None:
        """Use another x (1) or T_p0 (N) from now on, without a reset. Raises UsageError if x cannot be changed.

        `imbalance`: (x_a - x_b) / (x_a + x_b) of tendons with different routings, 1.
        """
        self._imbalance = imbalance
        self._model = self._model.recalibrated(friction_angle, pretension)
        self._transmission = self._stack.transmission(self._model)
        self._pulling = self._line = None

    @property
    def left_out(self) -> tuple[str, ...]:
        """Return the effects of the model whose measurement has not arrived since the start."""
        return tuple(name for name in self._model.effects if name not in self._active)

    def domain(self) -> tuple[float, float]:
        """Return the lowest and the highest tau_M, N*m, at which both tendons pull; infinite if the model has slack.

        The bounds apply to the command in the state of the last update, so motor-side effects are included. Their sizes
        differ: in sliding tendons, friction couples the torque into the pretension (3.54), and drive friction adds to
        one side. 0 is always inside, so that a bound never moves a torque away from 0.
        """
        if self._line is not None:
            return self._line.domain
        if self._pulling is None:
            sigma, x, pretension = self._state.sigma, self.friction_angle, self.pretension
            self._pulling = self._transmission.limits(sigma, x, pretension, self._imbalance)
        low, high = self._pulling
        if (custom := self._stack.custom_at("motor")) is not None:
            low, high = (custom.invert(end, self._state, self._memories) for end in (low, high))
        for effect in reversed(self._stack.motor_torque):
            low = effect.invert(SCALARS, low, self._state)
            high = effect.invert(SCALARS, high, self._state)
        return min(low, high, 0.0), max(low, high, 0.0)

    def half_loop(self) -> float:
        """Return the friction torque h, N*m at the motor: half the change of tau_M with the direction at tau_J = 0."""
        x, pretension, transmission = self.friction_angle, self.pretension, self._transmission
        forward = transmission.motor_torque(0.0, 1.0, x, pretension, self._imbalance)
        return 0.5 * (forward - transmission.motor_torque(0.0, -1.0, x, pretension, self._imbalance))

    def update(
        self,
        tau_j_des: float,
        sigma: float,
        omega_j: float,
        q_j: float = math.nan,
        q_m: float = math.nan,
        temperature: float = math.nan,
        theta: float = math.nan,
        t: float = math.nan,
        acceleration_j: float = math.nan,
    ) -> float:
        """Return tau_M, N*m, that delivers `tau_j_des` (N*m) in direction `sigma` (in [-1, 1], 0 at standstill).

        The result is finite for every finite tau_j_des. Without `acceleration_j` (rad/s^2), the acceleration is derived
        from omega_j by a causal filter of `ACCELERATION_TIME`. The torque at the pulley is limited to the domain of the
        model (`domain`).
        """
        line = self._line
        if line is not None and sigma == line.sigma and theta != theta:
            tau_m = (tau_j_des + line.loss) / line.slope
            if line.low <= tau_m <= line.high:
                self.clipped = False
                return tau_m
        if not math.isfinite(tau_j_des):
            return tau_j_des  # the limiter rejects it
        if self._line_only and theta != theta:
            return self._by_line(tau_j_des, sigma)
        state, memories = self._state, self._memories
        memories.begin(self._measure(state, omega_j, q_j, q_m, temperature, theta, t, acceleration_j))
        stack = self._stack  # `_measure` may have changed it
        state.sigma = self._direction(state, sigma)
        angle, pretension = bending_and_pretension(SCALARS, self._model, stack, state)
        x = min(friction_angle(SCALARS, self._model, stack, state, angle), LARGEST_ANGLE)
        self.friction_angle, self.pretension = x, pretension

        torque = tau_j_des
        for joint_effect in stack.joint:
            torque += joint_effect.torque(SCALARS, state)
        if (custom := stack.custom_at("joint")) is not None:
            torque = custom.invert(torque, state, memories)
        brought = torque
        if stack.lever is not None:
            torque = stack.lever.invert(SCALARS, torque, state)
        if stack.load is not None:
            torque = stack.load.invert(SCALARS, torque, state.sigma)
        transmission = self._transmission
        tau_m = transmission.motor_torque(torque, state.sigma, x, pretension, self._imbalance)
        low, high = transmission.limits(state.sigma, x, pretension, self._imbalance)
        cut = low if tau_m < low else high if tau_m > high else tau_m
        if memories.parts and (custom := stack.custom_at("joint")) is not None:
            custom.accept(brought if cut == tau_m else self._brought(cut, x, pretension), state, memories)
        self.clipped = cut != tau_m
        self._pulling = low, high
        tau_m = cut
        if (custom := stack.custom_at("motor")) is not None:
            tau_m = custom.invert(tau_m, state, memories)
            custom.accept(tau_m, state, memories)
        for motor_effect in reversed(stack.motor_torque):
            tau_m = motor_effect.invert(SCALARS, tau_m, state)
        if math.isfinite(tau_m):
            return tau_m
        return _without_friction(self._model, tau_j_des)

    def _by_line(self, tau_j_des: float, sigma: float) -> float:
        """Return the result of `update` without measurements, for effects that only change the line of tau_J."""
        sigma = -1.0 if sigma < -1.0 else 1.0 if sigma > 1.0 else sigma if sigma == sigma else self._state.sigma
        state, model = self._state, self._model
        state.sigma = sigma
        angle, pretension = bending_and_pretension(SCALARS, model, self._stack, state)
        x = min(friction_angle(SCALARS, model, self._stack, state, angle), LARGEST_ANGLE)
        self.friction_angle, self.pretension = x, pretension
        slope, loss = self._transmission.tangent(sigma, x, pretension, self._imbalance)
        self._pulling = low, high = self._transmission.limits(sigma, x, pretension, self._imbalance)
        self._line = _Line(sigma, slope, loss, low, high)
        tau_m = (tau_j_des + loss) / slope
        self.clipped = not low <= tau_m <= high
        if self.clipped:
            tau_m = low if tau_m < low else high if tau_m > high else tau_m
        return tau_m if math.isfinite(tau_m) else _without_friction(self._model, tau_j_des)

    def _brought(self, tau_m: float, x: float, pretension: float) -> float:
        """Return the torque (N*m) that the tendons deliver to the joint for `tau_m` (N*m) on the motor pulley."""
        stack, state = self._stack, self._state
        torque = self._transmission.torque(SCALARS, tau_m, state.sigma, x, pretension, self._imbalance)
        torque = torque if stack.load is None else stack.load.apply(SCALARS, torque, state.sigma)
        return torque if stack.lever is None else stack.lever.apply(SCALARS, torque, state)

    def _measure(
        self,
        state: State[float],
        omega_j: float,
        q_j: float,
        q_m: float,
        temperature: float,
        theta: float,
        t: float,
        acceleration_j: float,
    ) -> float:
        """Store the measured values in the state, and return the time since the last update, s.

        Missing values are held.
        """
        isfinite = math.isfinite
        first = False
        if isfinite(q_j):
            first |= state.q_j != state.q_j
            state.q_j = q_j
        if isfinite(q_m):
            first |= state.q_m != state.q_m
            state.q_m = q_m
        if isfinite(temperature):
            first |= state.temperature != state.temperature
            state.temperature = temperature
        if first:
            self._use_effects()
        if isfinite(theta):
            state.theta = theta
            self._line = None
        elapsed = self._period
        if isfinite(t):
            periods = (t - state.t) / self._period
            if self._started and 1.5 < periods < MOST_PERIODS:  # some periods had no cycle
                elapsed *= round(periods)
            state.t = t
            if not self._started:
                self._started, state.start = True, t
        if not isfinite(omega_j):
            return elapsed
        if isfinite(acceleration_j):
            state.acceleration = acceleration_j
        elif self._last_omega == self._last_omega:
            derivative = (omega_j - self._last_omega) / elapsed
            state.acceleration += elapsed / (ACCELERATION_TIME + elapsed) * (derivative - state.acceleration)
        self._last_omega = omega_j
        lag = self._stack.velocity_lag
        state.omega = omega_j if lag is None else lag.true_velocity(omega_j, state.acceleration)
        return elapsed

    def _direction(self, state: State[float], sigma: float) -> float:
        """Return sigma, limited to [-1, 1], or the friction state z if the model has presliding hysteresis."""
        sigma = -1.0 if sigma < -1.0 else 1.0 if sigma > 1.0 else sigma if sigma == sigma else state.sigma
        if self._presliding is None:
            return sigma
        return self._presliding.update(state.q_m if self._by_motor else state.q_j, sigma)

    def _use_effects(self) -> None:
        """Compose the effects whose measurements have arrived."""
        here = {name for name in _OPTIONAL if getattr(self._state, name) == getattr(self._state, name)} | {"omega_j"}
        self._active = {name: p for name, p in self._model.effects.items() if not _lacking(self._model, name, here)}
        self._stack = Stack.of(self._active, self._model.source)
        self._transmission = self._stack.transmission(self._model)
        self._pulling = self._line = None
        self._line_only = self._transmission.linear and set(self._model.effects) <= _LINEAR
        presliding = self._stack.presliding
        if presliding is not None and self._presliding is None:  # kept if another measurement arrives later
            self._presliding = PreslidingState(presliding)
            self._by_motor = presliding.displacement != "joint" and "q_m" in here


class _Line:
    """Hold the line tau_M = (tau_J* + loss) / slope in the direction `sigma`, between `low` and `high`, N*m."""

    __slots__ = ("domain", "high", "loss", "low", "sigma", "slope")

    def __init__(self, sigma: float, slope: float, loss: float, low: float, high: float) -> None:
        self.sigma = sigma
        self.slope = slope
        self.loss = loss
        self.low = low
        self.high = high
        self.domain = min(low, high, 0.0), max(low, high, 0.0)


def _lacking(model: TendonSheath, effect: str, here: Collection[str]) -> tuple[str, ...]:
    """Return the signals of which `effect` requires one, if none of them is in `here`; otherwise an empty tuple."""
    needed = CATALOGUE[effect].needed_live(model.effects[effect])
    return next((names for names in needed if not any(name in here for name in names)), ())


def _without_friction(model: TendonSheath, tau_j_des: float) -> float:
    """Return tau_J* r_M/r_J (N*m), or 0 if this overflows."""
    ideal = tau_j_des * (model.motor_pulley_radius / model.joint_pulley_radius)
    return ideal if math.isfinite(ideal) else 0.0


def _notes(model: TendonSheath, signals: Collection[str]) -> list[str]:
    """Describe the effects that the feedforward cannot, or cannot exactly, compensate."""
    here = set(signals) | {"omega_j"}
    notes = []
    for name, parameters in model.effects.items():
        lacking = _lacking(model, name, here)
        if lacking:
            notes.append(f"{name}: not compensated, this axis does not measure {' or '.join(lacking)}")
        elif CATALOGUE[name].feedforward:
            notes.append(f"{name}: {CATALOGUE[name].feedforward.format(**parameters)}")
    return notes
