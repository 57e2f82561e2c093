"""Predict the motion of an experiment before it is played.

A joint that the torque moves follows J dw/dt = tau_J - b w - k q - A sin q - B cos q - c. This equation is linear in
its parameters, which are fitted to logs. While the transmission slides, tau_J = R cosh(x) tau_M - F sigma (3.55). A
joint that is moved from outside repeats its recorded motion, whatever the torque.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import GearedDrive, TendonSheath
from tsa_ctrl.model.signals import low_pass
from tsa_ctrl.model.steady_sliding import Sliding, sliding
from tsa_ctrl.tune.excitation import MOVED_BY_TORQUE, Waveform, response

Array = NDArray[np.float64]
JointModel = TendonSheath | GearedDrive  # the models that predict a joint torque

BAND = 8.0  # Hz, band in which the equation of motion is fitted: joints move below 5 Hz, noise of derivatives is above
SLIDES = 0.02  # rad/s, width of a friction reversal in the prediction: a sharp one would chatter at STEP
STEP = 0.002  # s, step of the prediction: 200 steps in a period of the fastest wave
FASTEST = 60.0  # rad/s, limit of the speed of a prediction that runs away


@dataclass(frozen=True)
class Motion:
    """Hold a predicted motion with period STEP: t (s), tau_m (N*m), q_j (rad) and omega_j (rad/s), (n,) each.

    `joints`: angles (n,) of other joints in rad by name.
    """

    t: Array
    tau_m: Array
    q_j: Array
    omega_j: Array
    joints: Mapping[str, Array] = field(default_factory=dict)


def gear_of(model: JointModel) -> float:
    """Return the number of turns of the motor for one turn of the joint."""
    return model.ratio if isinstance(model, GearedDrive) else model.joint_pulley_radius / model.motor_pulley_radius


def _line(model: JointModel) -> Sliding:
    """Return slope and friction torque of the transmission; for a gear, the mean slope of both power directions."""
    if isinstance(model, TendonSheath):
        return sliding(model)
    efficiency = 1.0 if model.efficiency is None else model.efficiency
    return Sliding(0.5 * model.ratio * (efficiency + 1.0 / efficiency), model.coulomb_friction or 0.0)


@dataclass(frozen=True)
class Joint:
    """Predict the motion of one joint.

    `terms`: factors of [tau_J, omega, q, sin q, cos q, 1] in dw/dt; None for a joint that is moved from outside.
    """

    model: JointModel
    terms: tuple[float, ...] | None
    recorded: Dataset

    @classmethod
    def of(cls, logs: Sequence[Dataset], model: JointModel) -> Joint:
        """Return a joint whose equation of motion is fitted to the logs."""
        longest = max(logs, key=lambda log: log.seconds)
        if max(response(log).by_torque for log in logs) < MOVED_BY_TORQUE:
            return cls(model, None, longest)
        rows, rates = [], []
        for log in logs:
            omega = low_pass(log["omega_j"], log.period, BAND)
            rates.append(np.gradient(omega, log.period))
            q = _angle(log)
            torque = low_pass(log["tau_j"], log.period, BAND)
            rows.append(np.column_stack([torque, omega, q, np.sin(q), np.cos(q), np.ones_like(q)]))
        columns, rate = np.concatenate(rows), np.concatenate(rates)
        scale = np.maximum(np.abs(columns).max(axis=0), 1e-12)
        found = np.linalg.lstsq(columns / scale, rate, rcond=1e-4)[0] / scale
        if not found[0] > 0.0:  # the torque does not drive it
            return cls(model, None, longest)
        return cls(model, tuple(float(value) for value in found), longest)

    @property
    def driven(self) -> bool:
        """Return True if the torque moves the joint."""
        return self.terms is not None

    def predict(self, wave: Waveform) -> Motion:
        """Return the motion under a desired joint torque, without compensation of friction."""
        t = np.arange(0.0, wave.seconds, STEP)
        wanted = np.interp(t, wave.t, wave.tau_j_des)
        tau_m = wanted / gear_of(self.model)
        if self.terms is None:
            return self._repeated(t, tau_m)
        line = _line(self.model)
        driving = (line.slope * tau_m).tolist()
        a, b, k, s, c, d = self.terms
        q, omega = float(np.median(_angle(self.recorded))), 0.0
        angles, speeds = [], []
        decay = a * line.half_loop / SLIDES  # slope of the friction at rest; it is stiff, so each step is implicit
        for torque in driving:
            force = a * torque + b * omega + k * q + s * math.sin(q) + c * math.cos(q) + d
            loss = a * line.half_loop * math.tanh(omega / SLIDES)
            slope = decay * (1.0 - math.tanh(omega / SLIDES) ** 2) - b
            omega += STEP * (force - loss) / (1.0 + STEP * max(slope, 0.0))
            if not abs(omega) < FASTEST:
                omega = math.copysign(FASTEST, omega)
            q += STEP * omega
            angles.append(q)
            speeds.append(omega)
        return Motion(t, tau_m, np.array(angles), np.array(speeds), self._joints(t))

    def _repeated(self, t: Array, tau_m: Array) -> Motion:
        log = self.recorded
        angle, speed = (self._again(t, column) for column in (_angle(log), log["omega_j"]))
        return Motion(t, tau_m, angle, speed, self._joints(t))

    def _joints(self, t: Array) -> dict[str, Array]:
        """Return the recorded angles of other joints, repeated because this motor does not move them."""
        return {name: self._again(t, angle) for name, angle in self.recorded.signals().joints.items()}

    def _again(self, t: Array, column: Array) -> Array:
        own = self.recorded["t"] - self.recorded["t"][0]
        return np.asarray(np.interp(np.mod(t, own[-1]), own, column))


def _angle(log: Dataset) -> Array:
    return log["q_j"] if "q_j" in log else np.cumsum(log["omega_j"]) * log.period
