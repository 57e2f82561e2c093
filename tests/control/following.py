"""Run a control loop without a bus around a joint whose wrap angle increases during the run.

The joint shares no code with the loop: T2 = T1 e^x, T4 = T3 e^-x with x = sigma mu Theta, T3 - T1 = tau_M / r_M,
T3 + T1 = 2 T_p, tau_J = r_J (T4 - T2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from tests.control.laws import COUNT
from tests.control.laws import law as make
from tests.control.sliding import PERIOD, R_J, R_M, actuator
from tsa_ctrl.control.estimator import Sample
from tsa_ctrl.control.kalman import KalmanEstimator
from tsa_ctrl.control.settings import EstimatorSettings

LEVER = 0.4e-3 + 0.3e-3  # m, p + d/2
STIFFNESS = 6e3 / 1.2  # N/m
MU, THETA, PRETENSION = 0.10, 2.6, 45.0


@dataclass(frozen=True)
class Change:
    """A linear increase of the wrap angle by `share` that begins at `at` s and takes `within` s."""

    share: float = 0.4
    at: float = 10.0
    within: float = 5.0

    def theta(self, t: float) -> float:
        return THETA * (1.0 + self.share * min(1.0, max(0.0, (t - self.at) / self.within)))


@cache
def run(change: Change, seconds: float, use: bool, seed: int = 4) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time (s), joint torque error (N*m) and estimated friction angle of each cycle, (n,) each.

    The joint is moved from outside, with realistic noise and quantisation. If `use` is set, the law uses the estimate.
    """
    model = actuator()
    settings = EstimatorSettings(kind="sensor", use=use)
    estimator = KalmanEstimator(model, settings, PERIOD)
    law = make(model)
    random = np.random.default_rng(seed)
    rows = []
    tau_m = tau_j = 0.0
    for n in range(round(seconds / PERIOD)):
        t = n * PERIOD
        omega = 1.2 * math.sin(2.0 * math.pi * 0.6 * t)
        angle = -2.0 * math.cos(2.0 * math.pi * 0.6 * t) / math.pi
        wanted = 0.5 * math.sin(2.0 * math.pi * 0.23 * t + 0.4)
        law.observe(angle + random.normal(0.0, COUNT), math.nan, True, wanted, 0.0)
        sigma = law.sigma
        reported = round((tau_m + random.normal(0.0, 2e-3)) * 1e3) * 1e-3
        estimator.update(Sample(sigma, omega, math.nan, reported, tau_j + random.normal(0.0, 5e-3), True))
        if use:
            law.set_parameters(estimator.friction_angle, estimator.pretension)
        tau_m = law.update(wanted, math.nan, math.nan, t, 1.0)
        tau_j = _delivered(tau_m, max(-1.0, min(1.0, omega / 0.02)), change.theta(t))
        rows.append((t, tau_j - wanted, estimator.friction_angle))
    t, error, angle = np.array(rows).T
    return t, error, angle


def _delivered(tau_m: float, sigma: float, theta: float) -> float:
    pretension = PRETENSION + STIFFNESS * LEVER * (theta - THETA)
    x = sigma * MU * theta
    t1, t3 = pretension - tau_m / (2.0 * R_M), pretension + tau_m / (2.0 * R_M)
    return R_J * (t3 * math.exp(-x) - t1 * math.exp(x))


def rms(t: np.ndarray, error: np.ndarray, first: float, last: float) -> float:
    """Return the RMS error (N*m) from `first` to `last` s."""
    part = (t >= first) & (t < last)
    return float(np.sqrt(np.mean(np.square(error[part]))))
