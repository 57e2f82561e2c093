"""Simulated rigs with a hidden cause, on which an investigation moves the joint itself.

The plant computes the hidden effects independently of the models of the diagnosis. A third of the causes are formulas
outside the catalogue. On some rigs no motion separates the causes. The rigs are single joints, the knee of a leg whose
other joints move as well, and drives with a gear.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import tomlkit

from tests.blind import geared, sensors
from tests.blind.motion import Motion
from tsa_ctrl import settings
from tsa_ctrl.cli.init import leg
from tsa_ctrl.demo import rig
from tsa_ctrl.demo.example import MOTION
from tsa_ctrl.demo.rig import VIRTUAL, Play
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import GearedDrive, save_model
from tsa_ctrl.tune.excitation import Bounds, Waveform

Effects = dict[str, dict[str, Any]]

RATE = 500.0  # Hz of the loop
ELASTIC = 0.01  # rad of travel over which the friction of stiff tendons reverses
LEG, KNEE, GEARED = "leg", "knee", "geared"
ROUTED = "routing_by_joint"
DRIVE = geared.Drive(ratio=9.0, efficiency=0.85, coulomb=0.6, viscous=0.15)
FINE = 8  # simulation steps of the gear per sample
GEAR_NOISE = 0.01  # N*m RMS of the joint torque sensor


@dataclass(frozen=True)
class Rig:
    """Describe a rig.

    `inside` is True if the cause is in the catalogue. `alike` lists the causes that no motion separates from it.
    """

    name: str
    load: str
    effects: Effects
    inside: bool = True
    alike: tuple[str, ...] = ()
    reach: float = 1.0  # factor of the prescribed joint motion

    @property
    def cause(self) -> str:
        return next(iter(self.effects), "")

    def judged(self, answer: str, causes: list[dict[str, Any]]) -> bool:
        """Return True if the answer is right."""
        if not self.inside:
            return answer == "outside"
        if not self.effects:
            return answer == "none" or (answer == "cause" and all(map(_of_the_loop, causes)))
        named = [{cause["effect"], *cause["alternatives"]} for cause in causes if not _of_the_loop(cause)]
        if len(named) != 1 or self.cause not in named[0]:
            return False
        return answer == ("group" if self.alike else "cause")


def _of_the_loop(cause: dict[str, Any]) -> bool:
    """Return True for effects that every rig has: a velocity delay of up to two cycles, and elastic tendons."""
    limits = {"velocity_lag": ("time_constant", 2.0 / RATE), "presliding_hysteresis": ("presliding_distance", ELASTIC)}
    if cause["effect"] not in limits:
        return False
    name, limit = limits[cause["effect"]]
    return bool(cause["parameters"][name]["value"] < limit)


def _draw(name: str, rng: np.random.Generator) -> Effects:
    sign = float(rng.choice([-1.0, 1.0]))

    def near(value: float) -> float:
        return float(value * rng.uniform(0.75, 1.3))

    table: dict[str, dict[str, Any]] = {
        "viscous_friction": {"coefficient": near(0.12)},
        "direction_asymmetric_friction": {"viscous_difference": sign * near(0.12)},
        "stribeck_friction": {"static_excess": near(0.8), "stribeck_velocity": near(0.15)},
        "load_dependent_friction": {"coefficient": near(0.15)},
        "sheath_asymmetry": {"relative_difference": sign * near(0.9)},
        "gravity_load": {"amplitude": near(0.3), "phase": near(0.5)},
        "joint_stiffness": {"stiffness": near(0.45), "rest_angle": near(0.2)},
        "torque_offset": {"offset": sign * near(0.12)},
        "torque_ripple": {"amplitude": near(0.08), "cycles_per_revolution": int(rng.integers(8, 15)), "phase": 0.5},
        "inertia": {"inertia": near(0.02)},
        "backlash": {"gap": near(0.04)},
        "presliding_hysteresis": {"presliding_distance": near(0.07), "displacement": "motor"},
        "transport_delay": {"delay": near(0.03)},
        "torque_sensor_lag": {"time_constant": near(0.06)},
        "torque_saturation": {"limit": near(0.45)},
        "configuration_dependent_bending": {"bending_per_joint_angle": sign * near(0.5)},
        "pulley_eccentricity": {"relative_eccentricity": near(0.25), "phase": near(0.5)},
    }
    return {name: table[name]}


OUTSIDE = {
    "gain that swings with the angle": "0.15*tau*sin(9*q_j)",
    "friction at one place": "0.3*sigma*exp(-((q_j - 0.15)/0.06)**2)",
    "gain that falls with the square": "0.12*tau*abs(tau)",
    "friction that grows towards the ends": "0.9*sigma*q_j**2",
    "loss of power": "0.12*tau*omega_j",
    "a wave in time": "0.08*sin(9.1*t)",
    "a step in time": "0.06*(1 + tanh((t - 6)/0.05))",
    "dead zone": "0.5*(abs(tau + 0.08) - abs(tau - 0.08))",
    "cubic spring": "2.0*q_j**3",
    "a slow second lag": "0.6*(tau - lag(tau, 0.4))",
}
SWINGS = {"gain that swings with the angle": "0.15*tau*sin(9*q_j)", "cubic spring": "6.0*q_j**3"}  # with a gear
INSIDE = (
    ("viscous_friction", "imposed"),
    ("direction_asymmetric_friction", "imposed"),
    ("stribeck_friction", "imposed"),
    ("load_dependent_friction", "imposed"),
    ("sheath_asymmetry", "imposed"),
    ("gravity_load", "imposed"),
    ("joint_stiffness", "imposed"),
    ("torque_offset", "imposed"),
    ("torque_ripple", "imposed"),
    ("backlash", "imposed"),
    ("presliding_hysteresis", "imposed"),
    ("transport_delay", "imposed"),
    ("torque_sensor_lag", "imposed"),
    ("torque_saturation", "imposed"),
    ("viscous_friction", "spring"),
    ("torque_sensor_lag", "spring"),
    ("torque_saturation", "spring"),
    ("gravity_load", "spring"),
    ("inertia", "imposed"),
    ("torque_offset", "spring"),
)


def rigs(seed: int) -> list[Rig]:
    """Return all rigs. `seed` determines the sizes of the effects."""
    out = [Rig("healthy", "imposed", {}), Rig("healthy spring", "spring", {})]
    for name, load in INSIDE:
        out.append(Rig(f"{name}, {load}", load, _draw(name, _generator(name + load, seed))))
    for name, expression in OUTSIDE.items():
        formula: Effects = {"custom": {"expression": expression, "stage": "joint"}}
        out.append(Rig(f"outside: {name}", "imposed", formula, inside=False))
    for name in ("", ROUTED, "torque_offset"):
        effects: Effects = {ROUTED: {}} if name == ROUTED else _draw(name, _generator(name + LEG, seed)) if name else {}
        out.append(Rig(f"{name or 'healthy'}, leg", LEG, effects))
    for name in ("", "torque_saturation", "torque_sensor_lag", "gravity_load"):
        out.append(Rig(f"{name or 'healthy'}, geared", GEARED, _of_the_gear(name, _generator(name + GEARED, seed))))
    for name, expression in SWINGS.items():
        formula = {"custom": {"expression": expression}}
        out.append(Rig(f"outside: {name}, geared", GEARED, formula, inside=False))
    short = _of_the_gear("gravity_load", _generator("short gear", seed))
    out.append(
        Rig("weight on a short stroke, geared", GEARED, short, alike=("joint_stiffness", "torque_offset"), reach=0.12)
    )
    weight = _draw("gravity_load", _generator("short", seed))
    out.append(
        Rig("weight on a short stroke", "imposed", weight, alike=("joint_stiffness", "torque_offset"), reach=0.12)
    )
    return out


def _generator(name: str, seed: int) -> np.random.Generator:
    digest = hashlib.sha256(f"{name}/{seed}".encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:8], "little"))


def write(folder: Path, hidden: Rig, seed: int) -> tuple[Path, Path]:
    """Write the files of the rig, and return the paths of controller and plant."""
    folder.mkdir(parents=True, exist_ok=True)
    if hidden.load == LEG:
        return _write_leg(folder, hidden, seed)
    rng = _generator("factors", seed)
    axis: Mapping[str, Mapping[str, Any]] = {
        "effects": hidden.effects,
        "perturbation": {
            "friction_coefficient": float(rng.uniform(0.85, 1.2)),
            "pretension": float(rng.uniform(0.85, 1.2)),
        },
        "tendon": {"kind": "full", "curvature": "joint_end"},
        "motor": {"inertia": 1e-5},
    }
    t = np.arange(0.0, 20.0 + 0.0025, 0.005)
    angle = hidden.reach * np.sum([a * np.sin(2.0 * np.pi * f * t) for f, a in MOTION], axis=0)
    controller = rig.controller(VIRTUAL, "rig", RATE, "nominal.toml", 0.0)
    controller["axis"][0]["limits"].update(joint_speed=8.0, over_speed=12.0)
    rig.write(
        folder,
        Play(t, np.zeros_like(t), angle),
        rig.plant(VIRTUAL, "full", axis, hidden.load),
        {"rig": controller},
    )
    save_model(
        dataclasses.replace(rig.NOMINAL, axial_stiffness=5e6, diameter=3e-3, bending_centre=0.98),
        folder / "nominal.toml",
    )
    return folder / "controller-rig.toml", folder / "plant.toml"


def _write_leg(folder: Path, hidden: Rig, seed: int) -> tuple[Path, Path]:
    """Write the leg of `tsa init --leg`. The knee's file lacks the routing if that is the hidden cause."""
    for files in leg():
        for name, text in files.items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8")
    rng = _generator("factors", seed)
    controller, plant = (tomlkit.parse((folder / f"{name}.toml").read_text()) for name in ("controller", "plant"))
    for axis in plant["axis"]:  # type: ignore[union-attr]
        if axis["name"] == KNEE:
            factors = {name: float(rng.uniform(0.9, 1.1)) for name in ("friction_coefficient", "pretension")}
            axis["perturbation"].update(factors)
            axis["effects"] = {name: effect for name, effect in hidden.effects.items() if name != ROUTED}
    if ROUTED in hidden.effects:
        file = tomlkit.parse((folder / f"{KNEE}.toml").read_text())
        del file["routing"]
        settings.write_text(folder / "nominal.toml", tomlkit.dumps(file))
        for axis in controller["axis"]:  # type: ignore[union-attr]
            if axis["name"] == KNEE:
                axis["model"] = "nominal.toml"
    settings.write_text(folder / "controller.toml", tomlkit.dumps(controller))
    settings.write_text(folder / "plant.toml", tomlkit.dumps(plant))
    return folder / "controller.toml", folder / "plant.toml"


def _of_the_gear(name: str, rng: np.random.Generator) -> Effects:
    """Return a hidden effect of the gear. The joint torque reaches 6 N*m, and the motor torque 0.7 N*m."""
    table: dict[str, dict[str, Any]] = {
        "torque_saturation": {"limit": float(rng.uniform(0.35, 0.5))},
        "torque_sensor_lag": {"time_constant": float(rng.uniform(0.03, 0.08))},
        "gravity_load": {"amplitude": float(rng.uniform(0.8, 1.5)), "phase": float(rng.uniform(-0.5, 0.5))},
    }
    return {name: table[name]} if name else {}


@dataclass
class Gear:
    """Play set-points on a simulated gear with a prescribed joint motion."""

    hidden: Rig
    seed: int

    bounds: ClassVar[Bounds] = Bounds(torque=6.0, speed=8.0)

    @property
    def nominal(self) -> GearedDrive:
        """Return the model file of the rig. The true losses differ from its values by up to 18 %."""
        rng = _generator("gear", self.seed)
        efficiency, coulomb, viscous = (
            value * float(rng.uniform(0.85, 1.15)) for value in (DRIVE.efficiency, DRIVE.coulomb, DRIVE.viscous)
        )
        return GearedDrive(DRIVE.ratio, efficiency, coulomb, viscous)

    def play(self, name: str, wave: Waveform) -> tuple[list[Dataset], Path]:
        """Return the log of one set-point, and the path of a folder that is not created."""
        rng = _generator(f"{self.hidden.name}/{name}", self.seed)
        period = 1.0 / RATE
        t = np.arange(0.0, wave.seconds, period / FINE)
        angle, speed, rate = (
            self.hidden.reach * np.sum([a * (2.0 * np.pi * f) ** n * wave_of(2.0 * np.pi * f * t)
                                        for f, a in MOTION], axis=0)
            for n, wave_of in enumerate((np.sin, np.cos, lambda x: -np.sin(x)))
        )  # fmt: skip
        motion = Motion(t, angle, speed, rate, ("sine",), float(np.abs(speed).max()))
        tau_m = np.interp(t, wave.t, wave.tau_j_des) / DRIVE.ratio
        catalogued = {name: effect for name, effect in self.hidden.effects.items() if name != "custom"}
        tau_j = geared.torque(DRIVE, motion, tau_m, catalogued)
        if "custom" in self.hidden.effects:
            tau, q = tau_j, angle
            tau_j = tau_j - (0.15 * tau * np.sin(9.0 * q) if "sin" in str(self.hidden.effects) else 6.0 * q**3)
        kept = slice(None, None, FINE)
        count = t[kept].size
        noise = GEAR_NOISE * sensors.coloured_noise(rng, count, RATE)
        columns = {
            "t": t[kept],
            "tau_m": tau_m[kept] + 2e-3 * rng.standard_normal(count),
            "tau_j": tau_j[kept] + noise,
            "q_j": sensors.quantised(angle[kept], 2.0 * np.pi / 2**20),
            "omega_j": speed[kept] + 2e-3 * rng.standard_normal(count),
        }
        return [Dataset.from_arrays(columns, name)], Path(name)
