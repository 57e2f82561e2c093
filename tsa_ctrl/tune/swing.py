"""Estimate motor inertia and tendon stiffness from the oscillation of the motor on its tendons while the joint slides.

    J_M e'' + b e' + K e = tau - slow part,     e = q_M - r_J/r_M q_J

is linear while both tendons slide completely in one direction. This is the case while the slip by the oscillation is
smaller than the slip by the joint. The angles of all such windows are fitted together. The common parameters are J_M,
K, b and an additional delay of the motor. Each window has its own initial angle and speed and its own slow part (a
cubic). The reported velocity is used only to select the windows, because the drive filters it, and so does the bus
layer if it computes the velocity. In the fit, a low-pass at 100 Hz would look like 33 % more stiffness.

The input is the command, as the drive holds it and as its torque loop follows it (`delay`). With a joint at rest the
motor would oscillate at another frequency, because the slip fronts would move.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.signal import lfilter

from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.quantity import Quantity, half_width
from tsa_ctrl.tune.delay import Delay

FloatArray = NDArray[np.float64]

WINDOW = 0.15  # s: several periods of any ringing, but short compared with a gait
TRAVEL = 0.1  # rad of joint travel since the reversal, after which every part of the tendons slides
FEWEST = 6  # least number of windows, for the scatter of their scores
CUBIC = 4  # number of coefficients of the slow part, a cubic
ANGLE = 2e-4  # rad, scale of the residuals: one count of a motor encoder
STARTS = (-1.4, -0.7, 0.0, 0.7, 1.4)  # initial values of ln J_M relative to the first guess
GUESS = 1e-4  # kg*m^2, first guess of J_M
FLOOR = 0.03  # relative, least half width of an interval: errors by backlash, cables and filters of the drive
LATE = 4.0  # periods, longest additional delay between the motor's torque and its motion


@dataclass(frozen=True)
class Swing:
    """The oscillation of the motor on its tendons.

    Attributes:
        inertia: motor inertia J_M, kg*m^2.
        stiffness: stiffness K of the sliding tendons, N*m/rad.
        ringing: frequency of the oscillation, Hz.
        late: delay of the motor's angle and speed after the reported torque, s.
    """

    inertia: Quantity
    stiffness: Quantity
    ringing: Quantity
    late: float


@dataclass(frozen=True)
class _Piece:
    """One log: the command (N*m), the motor angle minus the geared joint angle (rad), and its windows."""

    command: FloatArray
    angle: FloatArray
    windows: tuple[slice, ...]


def swing(logs: Sequence[Dataset], radii: tuple[float, float], stiffness: float, delay: Delay) -> Swing | None:
    """Return the oscillation of the motor from logs with tau_m_cmd and with angles and velocities of motor and joint.

    The result is None if the joint slides too little compared with the oscillation, or if the parameters are not
    identifiable.

    Args:
        logs: logs of a motor that was shaken while the joint moved.
        radii: r_M and r_J, m.
        stiffness: first guess, N*m/rad.
        delay: delay of the torque after the command.
    """
    period = logs[0].period
    pieces = [_piece(log, radii) for log in logs]
    count = sum(len(piece.windows) for piece in pieces)
    if count < FEWEST:
        return None
    samples = round(WINDOW / period)
    scale = math.sqrt(GUESS * stiffness)

    def residuals(parameters: FloatArray) -> FloatArray:
        inertia, spring = GUESS * math.exp(parameters[0]), stiffness * math.exp(parameters[1])
        motor = _Motor(inertia, spring, scale * parameters[2], delay.transport + parameters[3], delay.lag, period)
        basis = motor.free(samples)
        found = []
        for piece in pieces:
            rest = (piece.angle - motor.driven(piece.command)) / ANGLE
            for window in piece.windows:
                found.append(rest[window] - basis @ (basis.T @ rest[window]))
        return np.clip(np.concatenate(found), -1e6, 1e6)

    bounds = ([-4.0, -1.2, 0.0, -min(1.0, delay.transport)], [4.0, 1.2, 0.5, LATE])
    fits = [
        least_squares(residuals, [start, 0.0, 0.02, 0.0], bounds=bounds, loss="soft_l1", max_nfev=30)
        for start in STARTS
    ]
    best = min(fits, key=lambda fit: float(fit.cost))
    spread = _spread(np.asarray(best.jac), best.fun, count)
    inertia, spring = GUESS * math.exp(best.x[0]), stiffness * math.exp(best.x[1])
    ringing = math.sqrt(spring / inertia) / (2.0 * math.pi)
    across = np.array([-0.5, 0.5, 0.0, 0.0])  # derivatives of ln ringing with respect to the parameters
    factor = half_width(count - len(best.x))
    widths = [factor * math.sqrt(float(v @ spread @ v)) for v in (np.eye(4)[0], np.eye(4)[1], across)]
    if max(widths) > 0.5:  # not identifiable
        return None
    return Swing(
        _around(inertia, widths[0], "kg*m^2"),
        _around(spring, widths[1], "N*m/rad"),
        _around(ringing, widths[2], "Hz"),
        period * float(best.x[3]),
    )


def _around(value: float, width: float, unit: str) -> Quantity:
    width = max(width, FLOOR)
    return Quantity(value, value * (1.0 - width), value * (1.0 + width), unit)


def _piece(log: Dataset, radii: tuple[float, float]) -> _Piece:
    r_m, r_j = radii
    angle = log["q_m"] - r_j / r_m * log["q_j"]
    speed = log["omega_m"] - r_j / r_m * log["omega_j"]
    q, omega = log["q_j"], log["omega_j"]
    added, slip = r_m * np.abs(speed), r_j * np.abs(omega)
    count = round(WINDOW / log.period)
    turns = np.flatnonzero(np.diff(np.sign(omega)) != 0.0) + 1
    windows = []
    for turn, end in zip(turns.tolist(), [*turns[1:].tolist(), omega.size], strict=True):
        first = turn + int(np.searchsorted(np.abs(q[turn:end] - q[turn]), TRAVEL))
        while first + count <= end:
            part = slice(first, first + count)
            slides = float(slip[part].min()) > float(added[part].max())
            if slides:
                windows.append(part)
            first += count if slides else count // 4
    return _Piece(log["tau_m_cmd"], angle, tuple(windows))


class _Motor:
    """The exact discrete model of the motor on its tendons and of its torque loop, with the states e, e' and torque."""

    def __init__(
        self, inertia: float, stiffness: float, damping: float, transport: float, lag: float, period: float
    ) -> None:
        whole = math.floor(transport)
        part = transport - whole
        system = np.zeros((4, 4))
        system[0, 1] = 1.0
        system[1, :3] = -stiffness / inertia, -damping / inertia, 1.0 / inertia
        system[2, 2:] = -1.0 / lag, 1.0 / lag
        first, second = expm(system * period * part), expm(system * period * (1.0 - part))
        self._step = second[:3, :3] @ first[:3, :3]
        self._pushes = second[:3, :3] @ first[:3, 3], second[:3, 3]  # effects of the previous and of the newest command
        self._back = whole

    def driven(self, command: FloatArray) -> FloatArray:
        """Return the angle (n,) to which a command (n,) moves a motor that starts at rest."""
        values, vectors = np.linalg.eig(self._step)
        before, newest = (np.linalg.solve(vectors, push.astype(complex)) for push in self._pushes)
        states = np.empty((3, command.size), dtype=complex)
        for i in range(3):
            taps = np.zeros(self._back + 3, dtype=complex)
            taps[self._back + 1], taps[self._back + 2] = newest[i], before[i]
            states[i] = lfilter(taps, [1.0, -values[i]], command)
        angle: FloatArray = (vectors[0] @ states).real
        return angle

    def free(self, samples: int) -> FloatArray:
        """Return an orthonormal basis (samples, 2 + CUBIC) for the initial state and the slow part of a window."""
        swing = np.empty((samples, 2))
        state = np.eye(3)[:, :2]
        for i in range(samples):
            swing[i] = state[0]
            state = self._step @ state
        basis = np.hstack((swing, np.vander(np.linspace(-1.0, 1.0, samples), CUBIC)))
        orthonormal: FloatArray = np.linalg.qr(basis / np.linalg.norm(basis, axis=0))[0]
        return orthonormal


def _spread(jacobian: FloatArray, residual: FloatArray, windows: int) -> FloatArray:
    """Return the covariance of the parameters from the scatter of the windows' scores."""
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    scores = np.array(
        [j.T @ r for j, r in zip(np.array_split(jacobian, windows), np.array_split(residual, windows), strict=True)]
    )
    spread: FloatArray = inverse @ (scores.T @ scores) @ inverse
    return spread
