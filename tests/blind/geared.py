"""Create logs of geared drives without tendons, with a joint torque sensor and hidden effects.

The joint is moved from outside, so that motor torque and motion are independent. The module does not import the
package under test. The base file does not contain the hidden cause.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from . import memory, sensors
from .bench import rms
from .cases import Case, Truth, generator
from .motion import Motion, grid, rich_motion, torque_programme
from .plant import stribeck_factor
from .recording import HiddenLog
from .rig import log_uniform

Array = np.ndarray

NAMES = (
    "none",
    "torque_saturation",
    "torque_sensor_lag",
    "torque_constant_error",
    "torque_offset",
    "torque_ripple",
    "stribeck_friction",
    "viscous_friction",
    "inertia",
    "gravity_load",
    "backlash",
    "transport_delay",
)
STATIC = ("torque_saturation", "torque_constant_error", "torque_offset")  # effects that are visible on a locked joint


@dataclass(frozen=True)
class Drive:
    """True values of the base model in SI units. The friction acts at the joint."""

    ratio: float
    efficiency: float
    coulomb: float
    viscous: float


def torque(drive: Drive, motion: Motion, tau_m: Array, effects: dict[str, dict[str, Any]]) -> Array:
    """Return the noise-free torque (N*m) of the joint sensor, on the motion's grid."""
    sigma = memory.direction(motion.omega)
    if "torque_saturation" in effects:
        limit = effects["torque_saturation"]["limit"]
        tau_m = np.clip(tau_m, -limit, limit)
    tau_m = tau_m * (1.0 + effects.get("torque_constant_error", {}).get("relative_error", 0.0))
    if "torque_ripple" in effects:
        e = effects["torque_ripple"]
        cycles = e["cycles_per_revolution"] * drive.ratio
        tau_m = tau_m + e["amplitude"] * np.sin(cycles * motion.q + e["phase"])
    driving = tau_m * sigma > 0.0
    out = drive.ratio * tau_m * np.where(driving, drive.efficiency, np.where(sigma == 0.0, 1.0, 1.0 / drive.efficiency))
    factor = stribeck_factor(motion.omega, effects["stribeck_friction"]) if "stribeck_friction" in effects else 1.0
    out = out - drive.coulomb * factor * sigma - drive.viscous * motion.omega
    if "backlash" in effects:
        out = out * memory.engaged(motion.q, sigma, effects["backlash"]["gap"], 0)
    for name, e in effects.items():
        match name:
            case "viscous_friction":
                out = out - e["coefficient"] * motion.omega
            case "inertia":
                out = out - e["inertia"] * motion.acceleration
            case "gravity_load":
                out = out - e["amplitude"] * np.sin(motion.q + e["phase"])
            case "torque_offset":
                out = out + e["offset"]
    if "torque_sensor_lag" in effects:
        out = memory.first_order_lag(out, motion.t[1] - motion.t[0], effects["torque_sensor_lag"]["time_constant"])
    if "transport_delay" in effects:
        out = np.interp(motion.t - effects["transport_delay"]["delay"], motion.t, out)
    return out


def geared_case(name: str, seed: int, short: bool = False) -> Case:
    """Return a geared drive with one hidden effect, or with "none".

    The effect is one and a half to eight times the noise.
    """
    for attempt in range(200):
        rng = generator("geared", name, seed, attempt)
        rate = int(rng.choice([250, 500, 1000]))
        every = 4000 // rate
        seconds = rng.uniform(14.0, 20.0) if short else rng.uniform(25.0, 50.0)
        t = grid(seconds, float(rate * every), before=0.25)
        motion = rich_motion(rng, t, rng.uniform(1.2 if name == "gravity_load" else 0.6, 2.0))
        ratio = float(rng.choice([6.0, 9.0, 10.0] if name == "torque_ripple" else [6.0, 9.0, 36.0, 50.0, 100.0]))
        peak = log_uniform(rng, 2.0, 150.0) / ratio  # N*m of the motor
        tau_m = peak * torque_programme(rng, t)
        drive = Drive(
            ratio=ratio,
            efficiency=rng.uniform(0.7, 0.95),
            coulomb=0.0 if name == "backlash" else ratio * peak * rng.uniform(0.03, 0.15),
            viscous=0.0 if name == "viscous_friction" else ratio * peak * rng.uniform(0.02, 0.1) / motion.speed,
        )
        case = _recorded(rng, name, seed, drive, motion, tau_m, every, rate)
        if case is not None:
            return case
    raise RuntimeError(f"no geared drive with {name} for seed {seed}")


def held_case(name: str, seed: int) -> Case:
    """Return a case with a locked joint and a motor torque in steps of both signs.

    It shows errors of the torque constant, an offset and saturation.
    """
    for attempt in range(200):
        rng = generator("held", name, seed, attempt)
        rate, every = 500, 8
        t = grid(rng.uniform(20.0, 30.0), float(rate * every), before=0.25)
        still = np.zeros_like(t)
        motion = Motion(t, still, still, still, ("held",), 0.0)
        peak = log_uniform(rng, 0.05, 5.0)
        stairs = np.round(6.0 * np.sin(2.0 * np.pi * t / rng.uniform(9.0, 14.0))) / 6.0
        drive = Drive(float(rng.choice([6.0, 9.0, 50.0])), 0.9, 0.0, 0.0)
        case = _recorded(rng, name, seed, drive, motion, peak * stairs, every, rate)
        if case is not None:
            return case
    raise RuntimeError(f"no held joint with {name} for seed {seed}")


def _recorded(
    rng: np.random.Generator,
    name: str,
    seed: int,
    drive: Drive,
    motion: Motion,
    tau_m: Array,
    every: int,
    rate: int,
) -> Case | None:
    first = round(0.25 * rate * every)
    plain = torque(drive, motion, tau_m, {})
    scale, strength = rms(plain), log_uniform(rng, 1.5, 8.0)
    noise = scale * log_uniform(rng, 0.003, 0.02)
    effects: dict[str, dict[str, Any]] = {}
    reached = 0.0
    if name != "none":
        effects = {name: _draw_effect(rng, name, drive, motion, tau_m, noise * strength, 1.0 / rate)}
        reached = rms((torque(drive, motion, tau_m, effects) - plain)[first::every])
        noise = reached / strength
        if not 5e-4 * scale < noise < 0.08 * scale:
            return None
    exact = torque(drive, motion, tau_m, effects)[first::every]
    measured = exact + noise * sensors.coloured_noise(rng, exact.size, rate)
    columns = {
        "t": np.arange(exact.size) / rate,
        "tau_m": sensors.quantised(tau_m[first::every], 1e-3 * float(np.max(np.abs(tau_m)))),
        "tau_j": measured,
    }
    fine = sensors.encoder(rng, motion.q, 2 ** int(rng.integers(17, 20)))[first::every]
    columns["q_j"] = fine
    if name == "torque_ripple" or rng.random() < 0.5:
        columns["q_m"] = sensors.encoder(rng, motion.q * drive.ratio, 2**14)[first::every]
    truth = Truth(effects, rms(measured - exact), 0.0, reached, setting="; ".join(motion.kinds))
    return Case("geared", name, seed, [HiddenLog("run_00", columns)], _file(rng, drive, name), truth)


def _draw_effect(
    rng: np.random.Generator, name: str, drive: Drive, motion: Motion, tau_m: Array, wanted: float, sample: float
) -> dict[str, Any]:
    reach = 0.5 * float(np.ptp(motion.q))
    speed = motion.speed
    sign = float(rng.choice([-1.0, 1.0]))
    match name:
        case "torque_saturation":
            return {"limit": float(np.max(np.abs(tau_m))) * rng.uniform(0.5, 0.85)}
        case "torque_sensor_lag":
            return {"time_constant": log_uniform(rng, max(0.01, 4.0 * sample), 0.15)}
        case "torque_constant_error":
            return {"relative_error": sign * rng.uniform(0.05, 0.25)}
        case "torque_offset":
            return {"offset": sign * wanted}
        case "torque_ripple":
            cycles = int(rng.choice([4, 6, 7, 12]))
            amplitude = 1.4 * wanted / drive.ratio
            return {"amplitude": amplitude, "cycles_per_revolution": cycles, "phase": rng.uniform(-np.pi, np.pi)}
        case "stribeck_friction":
            drawn = {"stribeck_velocity": speed * log_uniform(rng, 0.05, 0.25), "shape": float(rng.choice([1.0, 2.0]))}
            return {"static_excess": min(2.5, 4.0 * wanted / drive.coulomb), **drawn}
        case "viscous_friction":
            return {"coefficient": 3.0 * wanted / speed}
        case "inertia":
            return {"inertia": wanted / float(np.std(motion.acceleration))}
        case "gravity_load":
            return {"amplitude": 2.0 * wanted, "phase": rng.uniform(-np.pi, np.pi)}
        case "backlash":
            return {"gap": reach * log_uniform(rng, 0.01, 0.08)}
        case "transport_delay":
            return {"delay": log_uniform(rng, max(0.006, 4.0 * sample), 0.05)}
    raise ValueError(f"unknown effect of a geared drive: {name}")


def _file(rng: np.random.Generator, drive: Drive, name: str) -> str:
    """Return the text of the nominal model without the hidden effect. Its friction is wrong by up to 20 %."""

    def off(value: float) -> float:
        return float(value / (1.0 + rng.uniform(-0.2, 0.2)))

    lines = ["[actuator]", 'kind = "geared_drive"', f"ratio = {drive.ratio!r}"]
    lines.append(f"efficiency = {min(1.0, drive.efficiency * rng.uniform(0.93, 1.07))!r}")
    if drive.coulomb > 0.0:
        lines.append(f"coulomb_friction = {off(drive.coulomb)!r}")
    if drive.viscous > 0.0 and name != "viscous_friction":
        lines.append(f"viscous_friction = {off(drive.viscous)!r}")
    return "\n".join(lines) + "\n"
