"""Create logs of plain drives with inertia, Coulomb friction, viscous friction, an offset and hidden effects.

All torques act at the shaft of the drive. A term that the base file does not contain is a hidden cause.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from . import memory, sensors
from .bench import rms
from .cases import Case, Truth, generator
from .motion import Motion, grid, rich_motion, wander
from .plant import stribeck_factor
from .recording import HiddenLog
from .rig import log_uniform

Array = np.ndarray

NAMES = (
    "none",
    "stribeck_friction",
    "direction_asymmetric_friction",
    "presliding_hysteresis",
    "torque_offset",
    "viscous_friction",
    "inertia",
    "gravity_load",
    "joint_stiffness",
    "torque_ripple",
    "thermal_friction_drift",
    "transport_delay",
)

# If one of these base parameters is missing in the file, the corresponding effect is a cause.
ABSENT = {"torque_offset": "torque_offset", "viscous_friction": "viscous_friction", "inertia": "inertia"}


@dataclass(frozen=True)
class Drive:
    """True values of the base model in SI units."""

    inertia: float
    coulomb: float
    viscous: float
    offset: float


def torque(drive: Drive, motion: Motion, temperature: Array, effects: dict[str, dict[str, Any]]) -> Array:
    """Return the motor torque (N*m) that moves the drive, on the motion's grid."""
    sigma = memory.direction(motion.omega)
    coulomb = np.full_like(motion.t, drive.coulomb)
    if "presliding_hysteresis" in effects:
        e = effects["presliding_hysteresis"]
        sigma = memory.bristle(motion.q, e["presliding_distance"], float(sigma[0]))
    if "stribeck_friction" in effects:
        coulomb = coulomb * stribeck_factor(motion.omega, effects["stribeck_friction"])
    if "thermal_friction_drift" in effects:
        e = effects["thermal_friction_drift"]
        coulomb = coulomb * (1.0 + e["temperature_coefficient"] * (temperature - 25.0))
    out = drive.inertia * motion.acceleration + coulomb * sigma + drive.viscous * motion.omega + drive.offset
    for name, e in effects.items():
        match name:
            case "direction_asymmetric_friction":
                out = out + e["viscous_difference"] * np.abs(motion.omega)
            case "viscous_friction":
                out = out + e["coefficient"] * motion.omega
            case "inertia":
                out = out + e["inertia"] * motion.acceleration
            case "torque_offset":
                out = out - e["offset"]  # the sign is opposite to an offset of tau_J, which this drive lacks
            case "gravity_load":
                out = out + e["amplitude"] * np.sin(motion.q + e["phase"])
            case "joint_stiffness":
                out = out + e["stiffness"] * (motion.q - e["rest_angle"])
            case "torque_ripple":
                out = out - e["amplitude"] * np.sin(e["cycles_per_revolution"] * motion.q + e["phase"])
            case "transport_delay":
                pass
    if "transport_delay" in effects:
        out = np.interp(motion.t - effects["transport_delay"]["delay"], motion.t, out)
    return out


def rigid_case(name: str, seed: int, short: bool = False) -> Case:
    """Return a plain drive with one hidden effect, or with "none". The effect is one to six times the noise."""
    for attempt in range(200):
        rng = generator("rigid", name, seed, attempt)
        rate = int(rng.choice([250, 500, 1000]))
        every = 4000 // rate
        seconds = rng.uniform(14.0, 20.0) if short else rng.uniform(25.0, 60.0)
        # The motor torque limits the jerk, so this motion has wider corners than a joint that is moved externally.
        t = grid(seconds, float(rate * every), before=0.25)
        # at small angles a weight resembles a spring
        reach = rng.uniform(1.6 if name in ("gravity_load", "joint_stiffness") else 0.8, 3.0)
        motion = rich_motion(rng, t, reach, rounding=rng.uniform(0.035, 0.08))
        drive = _draw_drive(rng, motion, name)
        temperature = 25.0 + rng.uniform(5.0, 12.0) * (1.0 + wander(rng, motion.t, seconds / 1.5))
        plain = torque(drive, motion, temperature, {})
        scale = rms(plain)
        ratio = log_uniform(rng, 1.15, 6.0)
        noise = scale * log_uniform(rng, 0.004, 0.03)
        first = round(0.25 * rate * every)
        fixed = _base_columns(motion, name)[first::every]
        effects: dict[str, dict[str, Any]] = {}
        reached = 0.0
        if name != "none":
            effects = {name: _draw_effect(rng, name, drive, motion, scale, noise * ratio, 1.0 / rate)}
            change = torque(drive, motion, temperature, effects)[first::every]
            reached = rms(change - fixed @ np.linalg.lstsq(fixed, change, rcond=None)[0])
            noise = reached / ratio
            if not 1.5e-3 * scale < noise < 0.1 * scale:
                continue
        exact = torque(drive, motion, temperature, effects)[first::every]
        step = min(1e-3 * float(np.max(np.abs(exact))) * rng.uniform(1.0, 1.6), 2.0 * noise)
        measured = sensors.quantised(exact + noise * sensors.coloured_noise(rng, exact.size, rate), step)
        columns = _columns(rng, motion, every, first, rate, measured, name)
        if name == "thermal_friction_drift" or rng.random() < 0.3:
            columns["temperature"] = np.round(temperature[first::every] + 0.03 * rng.standard_normal(exact.size), 2)
        truth = Truth(effects, rms(measured - exact), 0.0, reached, setting="; ".join(motion.kinds))
        if name == "none" or reached >= truth.noise:
            return Case("rigid", name, seed, [HiddenLog("run_00", columns)], _file(rng, drive, name), truth)
    raise RuntimeError(f"no drive with {name} for seed {seed}")


def _draw_drive(rng: np.random.Generator, motion: Motion, name: str) -> Drive:
    coulomb = log_uniform(rng, 0.02, 2.0)
    return Drive(
        inertia=0.0 if name == "inertia" else coulomb * rng.uniform(0.3, 1.2) / float(np.std(motion.acceleration)),
        coulomb=coulomb,
        viscous=0.0 if name == "viscous_friction" else coulomb * rng.uniform(0.2, 1.0) / motion.speed,
        offset=0.0 if name == "torque_offset" else coulomb * rng.uniform(-0.3, 0.3),
    )


def _base_columns(motion: Motion, name: str) -> Array:
    columns = {
        "inertia": motion.acceleration,
        "coulomb": memory.direction(motion.omega),
        "viscous_friction": motion.omega,
        "torque_offset": np.ones_like(motion.t),
    }
    columns.pop(name, None)
    return np.stack(list(columns.values()), axis=1)


def _draw_effect(
    rng: np.random.Generator, name: str, drive: Drive, motion: Motion, scale: float, wanted: float, sample: float
) -> dict[str, Any]:
    """Return parameters of an effect with a size near `wanted` (N*m).

    Parameters that do not set the size are drawn from a typical range.
    """
    speed, reach = motion.speed, 0.5 * float(np.ptp(motion.q))
    sign = float(rng.choice([-1.0, 1.0]))
    match name:
        case "stribeck_friction":
            drawn = {"stribeck_velocity": speed * log_uniform(rng, 0.05, 0.25), "shape": float(rng.choice([1.0, 2.0]))}
            return {"static_excess": min(2.0, 3.0 * wanted / drive.coulomb), **drawn}
        case "direction_asymmetric_friction":
            return {"viscous_difference": sign * 4.0 * wanted / speed}
        case "presliding_hysteresis":
            return {"presliding_distance": reach * log_uniform(rng, 0.006, 0.12)}
        case "torque_offset":
            return {"offset": sign * wanted}
        case "viscous_friction":
            return {"coefficient": 4.0 * wanted / speed}
        case "inertia":
            return {"inertia": wanted / float(np.std(motion.acceleration))}
        case "gravity_load":
            return {"amplitude": 2.0 * wanted, "phase": rng.uniform(-np.pi, np.pi)}
        case "joint_stiffness":
            return {"stiffness": 2.0 * wanted / reach, "rest_angle": rng.uniform(-0.3, 0.3) * reach}
        case "torque_ripple":
            cycles = int(rng.choice([3, 6, 7, 12, 18, 24]))
            return {"amplitude": 1.4 * wanted, "cycles_per_revolution": cycles, "phase": rng.uniform(-np.pi, np.pi)}
        case "thermal_friction_drift":
            return {"temperature_coefficient": sign * min(0.03, wanted / drive.coulomb / 5.0)}
        case "transport_delay":
            return {"delay": log_uniform(rng, max(0.004, 3.0 * sample), 0.04)}
    raise ValueError(f"unknown effect of a drive: {name}")


def _columns(
    rng: np.random.Generator, motion: Motion, every: int, first: int, rate: int, measured: Array, name: str
) -> dict[str, Array]:
    counts = 2 ** int(rng.integers(17, 21))
    fine = sensors.encoder(rng, motion.q, counts)
    columns = {"t": np.arange(measured.size) / rate, "tau_m": measured}
    kind = rng.random()
    needs_angle = name in ("gravity_load", "joint_stiffness", "torque_ripple", "presliding_hysteresis")
    if needs_angle or kind < 0.7:
        columns["q_m"] = fine[first::every]
    if kind > 0.3:
        noise = motion.speed * log_uniform(rng, 1e-4, 1e-3)
        columns["omega_m"] = sensors.tachometer(rng, motion.omega[first::every], noise, int(rng.choice([1, 3, 5])))
    return columns


def _file(rng: np.random.Generator, drive: Drive, name: str) -> str:
    """Return the nominal drive as model text, without the hidden parameter. Its values are wrong by up to 20 %."""
    lines = ['[actuator]\nkind = "rigid_drive"']
    values = {
        "inertia": drive.inertia,
        "coulomb_friction": drive.coulomb,
        "viscous_friction": drive.viscous,
        "torque_offset": drive.offset,
    }
    for key, value in values.items():
        if key != ABSENT.get(name):
            lines.append(f"{key} = {float(value / (1.0 + rng.uniform(-0.2, 0.2)))!r}")
    return "\n".join(lines) + "\n"
