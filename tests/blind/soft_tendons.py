"""Create logs of a light motor on soft tendons under a joint torque controller, without code of the package.

With e = r_M q_M - r_J q_J and the stiffness k of one tendon over its whole slack-free length:

    2 k e = tau_M / r_M - z x T_p,    tau_J = r_J (tau_M / r_M cosh(z x) - 2 T_p sinh(z x))

z depends on the path of the tendon's middle, (r_M q_M + r_J q_J) / 2, since the reversal. Slip propagates into the
sheath like a front: 20 elements slip after shares (i/20)^2 of one distance. At a constant motor torque, the motor does
not follow the joint until the friction has reversed.
"""

from __future__ import annotations

import numpy as np
from numba import njit

RATE = 500.0
FINER = 8
R_M, R_J, X, T_P = 0.020, 0.025, 0.28, 43.0
STIFFNESS = 4.0e4  # N/m of one tendon
FRONT = 1.2e-4  # m, motion of the tendon's middle until the whole tendon slips
ELEMENTS = 20
SWITCH = 0.008  # s, time in which a controller reverses its compensation


def record(seed: int, *, compensated: bool, seconds: float = 16.0) -> dict[str, np.ndarray]:
    """Return the columns of one log. If `compensated` is set, the motor torque contains the friction compensation."""
    rng = np.random.default_rng(seed)
    step = 1.0 / (RATE * FINER)
    t = step * np.arange(int(seconds / step))
    angles = [(0.62, 0.35), (1.25, 0.18), (1.87, 0.06)]
    phases = rng.uniform(0.0, 2.0 * np.pi, len(angles))
    q_j = np.sum([a * np.sin(2.0 * np.pi * f * t + p) for (f, a), p in zip(angles, phases, strict=True)], axis=0)
    omega_j = np.gradient(q_j, step)
    wanted = 0.5 * np.sin(2.0 * np.pi * 0.41 * t + 1.0) + 0.35 * np.sin(2.0 * np.pi * 1.03 * t)
    tau_m = wanted * R_M / R_J
    if compensated:
        ramp = int(SWITCH / step)
        way = np.convolve(np.sign(omega_j), np.ones(ramp) / ramp)[: len(t)]
        tau_m = tau_m + 0.95 * 2.0 * T_P * R_M * np.sinh(X) * way
    q_m, z = _followed(tau_m, q_j)
    tau_j = R_J * (tau_m / R_M * np.cosh(z * X) - 2.0 * T_P * np.sinh(z * X))
    columns = {"tau_m": tau_m, "tau_j": tau_j, "omega_j": omega_j, "q_j": q_j, "q_m": q_m}
    columns["omega_m"] = np.gradient(q_m, step)
    out = {name: values.reshape(-1, FINER)[:, 0] for name, values in columns.items()}
    noises = {"tau_m": 2e-3, "tau_j": 5e-3, "omega_j": 1e-3, "omega_m": 1e-3}
    noisy = {name: values + noises.get(name, 0.0) * rng.standard_normal(len(values)) for name, values in out.items()}
    return {"t": np.arange(len(out["tau_m"])) / RATE, **noisy}


@njit(cache=True)
def _followed(tau_m: np.ndarray, q_j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the motor angle (rad) and z, (n,) each.

    In each sample, z and the position of the tendon's middle are calculated together by bisection.
    """
    reach = FRONT * ((np.arange(ELEMENTS) + 1.0) / ELEMENTS) ** 2
    slip = np.full(ELEMENTS, np.sign(q_j[1] - q_j[0]))
    q_m, z = np.empty_like(q_j), np.empty_like(q_j)
    middle = R_J * q_j[0] + 0.25 * (tau_m[0] / R_M - slip[0] * X * T_P) / STIFFNESS
    for i in range(len(q_j)):
        low, high = -1.0, 1.0
        for _ in range(40):
            now = 0.5 * (low + high)
            e = 0.5 * (tau_m[i] / R_M - now * X * T_P) / STIFFNESS
            place = R_J * q_j[i] + 0.5 * e
            turned = np.minimum(np.maximum(slip + (place - middle) / reach, -1.0), 1.0)
            if turned.mean() > now:
                low = now
            else:
                high = now
        slip, middle, z[i] = turned, place, turned.mean()
        q_m[i] = (R_J * q_j[i] + e) / R_M
    return q_m, z
