"""Create the logs of a bench with realistic noise, encoder counts and wrong velocity signs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import memory, sensors
from .bench import Bench, Disturbance, Run, rms
from .plant import Effects, Tensions

Array = np.ndarray


@dataclass
class HiddenLog:
    """A log as the input of a diagnosis: columns by name in SI units."""

    name: str
    columns: dict[str, Array]


def record(
    rng: np.random.Generator, bench: Bench, effects: Effects, noise: float, disturb: Disturbance | None = None
) -> tuple[list[HiddenLog], float, float]:
    """Return the logs, the RMS torque noise and the RMS torque error by wrong velocity signs (N·m).

    `noise` is the intended RMS noise in N·m of joint torque and includes the motor side.
    """
    motor_share = rng.uniform(0.05, 0.4)
    gain = bench.rig.joint_radius / bench.rig.motor_radius * np.cosh(bench.rig.x)
    peak = max(float(np.max(np.abs(run.scene.tau_m))) for run in bench.runs)
    per_mille = 1e-3 * peak * rng.uniform(1.02, 1.6)
    motor_noise = noise * np.sqrt(motor_share) / gain
    per_mille = min(per_mille, 2.0 * motor_noise)  # keeps the resolution of the drive small compared with the noise
    velocity_noise = bench.speed * np.exp(rng.uniform(np.log(3e-4), np.log(6e-3)))
    velocity_noise = bench.recipe.velocity_noise or velocity_noise
    smooth = int(rng.choice([1, 3, 5]))
    logs: list[HiddenLog] = []
    torque_errors, sign_errors = [], []
    for number, run in enumerate(bench.runs):
        tensions = run.simulate(bench.rig, effects, bench.motor_angle)
        ideal = tensions.joint_torque
        if disturb is not None:
            ideal = run.pick(disturb(bench, run, run.plain(bench.rig, bench.motor_angle)))
        count = ideal.size
        tau_m_true = run.pick(run.scene.tau_m)
        tau_j = ideal + noise * np.sqrt(1.0 - motor_share) * sensors.coloured_noise(rng, count, run.rate)
        tau_m = sensors.quantised(tau_m_true + motor_noise * sensors.coloured_noise(rng, count, run.rate), per_mille)
        torque_errors.append(tau_j - ideal - gain * (tau_m - tau_m_true))
        columns = {"t": bench.clock_start + np.arange(count) / run.rate, "tau_m": tau_m, "tau_j": tau_j}
        limit = bench.recipe.sign_noise * noise
        omega, q_j, sign_error = _velocity(rng, bench, run, effects, velocity_noise, smooth, limit)
        sign_errors.append(sign_error)
        if bench.velocity != "derived":
            columns["omega_j"] = omega
        if bench.joint_angle:
            columns["q_j"] = q_j
        _extras(rng, bench, run, columns, tensions)
        logs.append(HiddenLog(f"run_{number:02d}", columns))
    return logs, rms(np.concatenate(torque_errors)), rms(np.concatenate(sign_errors))


def _velocity(
    rng: np.random.Generator, bench: Bench, run: Run, effects: Effects, noise: float, smooth: int, limit: float
) -> tuple[Array, Array, Array]:
    """Return recorded velocity and angle, and the torque error by wrong velocity signs (N·m).

    Velocity noise, encoder step and window are reduced until the RMS error is at most `limit`, in up to 12 steps.
    """
    seen = bench.seen_velocity(run, effects)
    step = run.scene.t[1] - run.scene.t[0]
    true_sign = run.pick(memory.direction(seen))
    x = bench.rig.mu * run.pick(run.scene.theta)
    half_loop = 2.0 * bench.rig.pretension * bench.rig.joint_radius * np.sinh(x)
    counts, window = bench.counts, bench.window
    for _ in range(12):
        q_fine = sensors.encoder(rng, run.scene.q, counts, 0.0 if bench.velocity == "encoder" else 0.25)
        q_j = run.pick(q_fine)
        if bench.velocity == "tachometer":
            omega = sensors.tachometer(rng, run.pick(seen), noise, smooth)
        else:
            omega = run.pick(sensors.differenced(q_fine, step, window))
            if "velocity_lag" in effects:
                omega = memory.first_order_lag(omega, 1.0 / run.rate, effects["velocity_lag"]["time_constant"])
        sign_error = half_loop * (memory.direction(omega) - true_sign)
        if rms(sign_error) <= limit:
            break
        noise, counts, window = 0.6 * noise, 2 * counts, 0.85 * window
    return omega, q_j, sign_error


def _extras(rng: np.random.Generator, bench: Bench, run: Run, columns: dict[str, Array], tensions: Tensions) -> None:
    """Add the optional columns to `columns`."""
    scene = run.scene
    if bench.motor_angle:
        columns["q_m"] = run.pick(sensors.encoder(rng, scene.q_m, 4 * bench.counts))
    if "omega_m" in bench.extras:
        speed = np.gradient(scene.q_m, scene.t[1] - scene.t[0])
        columns["omega_m"] = run.pick(speed) + 2e-3 * bench.speed * rng.standard_normal(columns["t"].size)
    if "tensions" in bench.extras:
        for name, exact in (("t1", tensions.t1), ("t3", tensions.t3)):
            columns[name] = exact + 3e-3 * bench.rig.pretension * rng.standard_normal(exact.size)
    if "tau_m_cmd" in bench.extras:
        columns["tau_m_cmd"] = run.pick(scene.tau_m)
    if bench.temperature:
        columns["temperature"] = sensors.quantised(
            run.pick(scene.temperature) + 0.05 * rng.standard_normal(columns["t"].size), 0.0625
        )
    if bench.recipe.bending == "varied":
        columns["theta"] = run.pick(scene.theta)
