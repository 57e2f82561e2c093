"""Create synthetic logs from the elongation equilibrium of two tendons, without code of the package.

Per sample: T3 - T1 = tau_M / r_M and delta_a + delta_b = 2 Delta l. delta integrates the local strain T(s)/EA over
the sheath on a fine grid. T2 and T4 follow from the capstan equation at its end. The samples are computed at four
times the log rate and averaged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

GRID = 400  # strain samples along the sheath
LEAST_PRETENSION = 0.2  # share of the rig's pretension, so that no tendon goes slack while its sheath straightens
OVERSAMPLING = 4
PROFILES = ("joint_end", "uniform", "motor_end")


@dataclass(frozen=True)
class Rig:
    profile: str
    r_m: float
    r_j: float
    ea: float
    length: float
    mu: float
    theta: float
    pretension: float
    half_width: float  # p + d/2, m

    def truth(self) -> dict[str, float]:
        """Return slope, friction torque (N*m), friction angle and pretension (N) from the formula of the profile."""
        x = self.mu * self.theta
        ratio, loop = self.r_j / self.r_m, 2.0 * self.pretension * self.r_j
        slope, half = {
            "joint_end": (np.cosh(x), np.sinh(x)),
            "uniform": (1.0, x),
            "motor_end": (1.0 / np.cosh(x), np.tanh(x)),
        }[self.profile]
        return {
            "slope": ratio * slope,
            "half_loop_torque": loop * half,
            "friction_angle": x,
            "pretension": self.pretension,
        }


def draw_rig(rng: np.random.Generator, profile: str) -> Rig:
    theta = rng.uniform(1.5, 5.0)
    r_m = rng.uniform(0.01, 0.03)
    return Rig(
        profile, r_m, r_m * rng.uniform(0.8, 1.5), rng.uniform(2e4, 8e4), rng.uniform(0.5, 1.5),
        rng.uniform(0.15, 0.7) / theta, theta, rng.uniform(25.0, 90.0), rng.uniform(0.2e-3, 0.9e-3),
    )  # fmt: skip


def wrong(value: float, rng: np.random.Generator) -> float:
    """Return a nominal value that is wrong by up to 20 %."""
    return value * (1.0 + rng.uniform(-0.2, 0.2))


def model_text(rig: Rig, rng: np.random.Generator) -> str:
    return (
        f"[actuator]\nmotor_pulley_radius = {rig.r_m!r}\njoint_pulley_radius = {rig.r_j!r}\n"
        f"[tendon]\naxial_stiffness = {rig.ea!r}\nunstrained_length = {rig.length!r}\ndiameter = {rig.half_width!r}\n"
        f"[sheath]\nfriction_coefficient = {wrong(rig.mu, rng)!r}\nbending_angle = {rig.theta!r}\n"
        f"contact_offset = {rig.half_width / 2.0!r}\n"
        f"[pretension]\nvalue = {wrong(rig.pretension, rng)!r}\n"
    )


def record(
    rig: Rig, rng: np.random.Generator, *, seconds: float = 40.0, rate: float = 500.0, tensioner: float = 0.0,
    theta_swing: float = 0.0, tensions: bool = False, noise: float | None = None,
) -> dict[str, np.ndarray]:  # fmt: skip
    """Return one log.

    `tensioner` (N) is added to the pretension. `theta_swing` (rad) is the amplitude of a slow sine of the wrap angle.
    """
    n = int(seconds * rate) * OVERSAMPLING
    t = np.arange(n) / (rate * OVERSAMPLING)
    omega = _motion(t, rng)
    sigma = np.sign(omega)
    stiffness = rig.ea / rig.length
    room = (1.0 - LEAST_PRETENSION) * (rig.pretension + tensioner) / (stiffness * rig.half_width)
    theta_swing = min(theta_swing, room)
    theta = rig.theta + theta_swing * np.sin(2.0 * np.pi * t / (seconds / rng.uniform(2.0, 4.0)))
    slack_free = rig.pretension + tensioner + stiffness * rig.half_width * (theta - rig.theta)
    limit = 2.0 * float(slack_free.min()) * rig.r_m
    tau_m = limit * rng.uniform(0.3, 0.6) * _load(t, rng)
    t1, t2, t3, t4 = _tensions(rig, tau_m, sigma, theta, slack_free)
    tau_j = rig.r_j * (t4 - t2)
    level = rng.uniform(0.003, 0.02) * float(np.std(tau_j)) if noise is None else noise
    down = lambda x: x.reshape(-1, OVERSAMPLING).mean(axis=1)  # noqa: E731
    columns = {
        "t": down(t),
        "tau_m": _measured(down(tau_m), level * 0.5, limit * 1e-3, rate, rng),
        "tau_j": _measured(down(tau_j), level, limit * 2e-4, rate, rng) + rng.normal() * level,
        "omega_j": down(omega) + rng.normal(size=n // OVERSAMPLING) * rng.uniform(0.005, 0.03) * np.std(omega),
    }
    if theta_swing:
        columns["theta"] = down(theta)
    if tensions:
        columns["t1"] = down(t1) + rng.normal(size=n // OVERSAMPLING) * 0.2
        columns["t3"] = down(t3) + rng.normal(size=n // OVERSAMPLING) * 0.2
    return columns


def _tensions(rig, tau_m, sigma, theta, pretension):  # type: ignore[no-untyped-def]
    s = (np.arange(GRID) + 0.5) / GRID
    share = {"joint_end": 0.0 * s, "uniform": s, "motor_end": 0.0 * s + 1.0}[rig.profile]
    x = rig.mu * theta
    # the friction angle varies slowly, so the mean strain factors are tabulated
    knots = np.linspace(x.min(), x.max() + 1e-12, 64)
    mean_up = np.interp(x, knots, [np.mean(np.exp(k * share)) for k in knots])
    mean_down = np.interp(x, knots, [np.mean(np.exp(-k * share)) for k in knots])
    a = np.where(sigma > 0, mean_up, mean_down)  # mean of T(s)/T1 over tendon a
    b = np.where(sigma > 0, mean_down, mean_up)
    difference = tau_m / rig.r_m
    t1 = (2.0 * pretension - b * difference) / (a + b)
    t3 = t1 + difference
    grow = np.exp(sigma * x)
    return t1, t1 * grow, t3, t3 / grow


def _motion(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    f = rng.uniform(0.15, 0.7)
    return rng.uniform(0.3, 0.9) * 2.0 * np.pi * f * (
        np.cos(2.0 * np.pi * f * t + rng.uniform(0, 6)) + 0.5 * np.cos(2.0 * np.pi * 1.7 * f * t + rng.uniform(0, 6))
    )  # fmt: skip


def _load(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    f = rng.uniform(0.05, 0.4)
    wave = np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) + 0.6 * np.sin(2 * np.pi * 2.3 * f * t + rng.uniform(0, 6))
    return wave / 1.6


def _measured(x: np.ndarray, level: float, step: float, rate: float, rng: np.random.Generator) -> np.ndarray:
    """Return the signal with coloured noise (two time constants) and white noise, rounded to `step`."""
    noise = 0.5 * rng.normal(size=x.size)
    for tau in (rng.uniform(0.003, 0.02), rng.uniform(0.02, 0.1)):
        pole = np.exp(-1.0 / (rate * tau))
        state, drive = rng.normal(), np.sqrt(1.0 - pole**2) * rng.normal(size=x.size)
        noise += 0.7 * lfilter([1.0], [1.0, -pole], drive, zi=[pole * state])[0]
    return np.round((x + level * noise) / step) * step
