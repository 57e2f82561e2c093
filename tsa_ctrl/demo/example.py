"""Make an example log for the diagnosis: the real loop on the simulated plant in virtual time, with a hidden cause.

The effects, their sizes and the parameter errors are random and repeatable by seed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tsa_ctrl.demo import rig
from tsa_ctrl.demo.rig import VIRTUAL, Play
from tsa_ctrl.demo.run import runs_on
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.effects.specification import Draw
from tsa_ctrl.model.parameters import TendonSheath

OFF = 0.2  # limit of |nominal / true - 1| of friction and pretension
SECONDS = 20.0  # s until motion and torque repeat; all frequencies below are whole multiples of its inverse
RATE = 500.0  # Hz: sufficient for the diagnosis of these motions, at half the time of 1 kHz
MOTION = ((0.25, 0.35), (0.6, 0.20), (1.35, 0.08))  # Hz, rad: slow and fast strokes
TORQUE = ((0.35, 0.25), (0.55, 0.25), (0.85, 0.25), (1.2, 0.25))  # Hz, N*m: none of the motion's frequencies

EFFECTS = tuple(name for name, spec in CATALOGUE.items() if spec.demo is not None)


@dataclass(frozen=True)
class Hidden:
    """Differences between the plant and the nominal file: `effects`, and factors on parameters."""

    effects: Mapping[str, Mapping[str, Any]]
    factors: Mapping[str, float]

    @property
    def name(self) -> str:
        return " + ".join(self.effects) or "nothing"

    def axis(self) -> dict[str, dict[str, Any]]:
        """Return the tables of the plant's axis. Stiff tendons, bent at the joint: only the effects violate (3.55)."""
        return {
            "effects": {name: dict(values) for name, values in self.effects.items()},
            "perturbation": {**self.factors, "axial_stiffness": 10.0},
            "tendon": {"kind": "full", "curvature": "joint_end"},
            "motor": {"inertia": 1e-5},
        }

    def truth(self, nominal: TendonSheath) -> TendonSheath:
        """Return the true model, which is the limit for any estimate."""
        x = nominal.friction_angle * self.factors["friction_coefficient"]
        tension = nominal.pretension * self.factors["pretension"]
        return nominal.recalibrated(x, tension).with_effects(dict(self.effects))


def draw(seed: int, names: Sequence[str] = ()) -> Hidden:
    """Return random factors and effect sizes for a seed, and a random effect if no names are given.

    Raises:
        UsageError: a name is not an effect that the demo can hide.
    """
    for name in names:
        if name not in EFFECTS:
            raise UsageError(f"demo: --hidden {name} is not one of {', '.join(EFFECTS)}; choose one of these")
    rng = np.random.default_rng(seed)
    factors = {key: float(1.0 / (1.0 + rng.uniform(-OFF, OFF))) for key in ("friction_coefficient", "pretension")}
    chosen = list(names) or [str(rng.choice(EFFECTS))]
    return Hidden({name: _sized(name, rng) for name in chosen}, factors)


def _sized(name: str, rng: np.random.Generator) -> dict[str, Any]:
    """Return the parameters of one effect, with random ones from `rng`."""
    sizes = CATALOGUE[name].demo or {}
    return {key: size.value(rng) if isinstance(size, Draw) else size for key, size in sizes.items()}


def motion() -> Play:
    """Return strokes of many speeds with an independently varying load, which are sufficient for a diagnosis."""
    t = np.arange(0.0, SECONDS + 0.5 / rig.RATE, 1.0 / rig.RATE)
    angle = np.sum([a * np.sin(2.0 * math.pi * f * t) for f, a in MOTION], axis=0)
    phases = [-math.pi * k * (k + 1) / len(TORQUE) for k in range(len(TORQUE))]  # Schroeder's: a low crest factor
    waves = [a * np.sin(2.0 * math.pi * f * t + p) for (f, a), p in zip(TORQUE, phases, strict=True)]
    return Play(t, np.sum(waves, axis=0), angle)


@dataclass(frozen=True)
class Example:
    """Paths of a log and of the model file without the hidden cause, and that cause."""

    log: Path
    model: Path
    hidden: Hidden

    def told(self) -> str:
        """Return the hidden cause as text."""
        sizes = "; ".join(
            f"{name} with "
            + ", ".join(
                f"{key} {value}" if isinstance(value, str) else f"{key} {value:.3g}" for key, value in values.items()
            )
            for name, values in self.hidden.effects.items()
        )
        factors = ", ".join(
            f"{key.replace('_', ' ')} {100 * (value - 1):+.0f} %" for key, value in self.hidden.factors.items()
        )
        return f"{sizes}; relative to the model file: {factors}"


def make(folder: Path, seed: int) -> Example:
    """Write an example and run it; the same seed hides the same cause. Raises BusError if the loop ends in a fault."""
    hidden = draw(seed)
    controllers = {"example": rig.controller(VIRTUAL, "example", RATE, "nominal.toml", 0.0)}
    rig.write(folder, motion(), rig.plant(VIRTUAL, "full", hidden.axis()), controllers)
    summary = runs_on(VIRTUAL)(folder, "example", SECONDS, lambda share: None)
    if summary["log"] is None or summary["failed"]:
        raise BusError(f"diagnose --example: the run failed: {summary['cause']}")
    return Example(folder / str(summary["log"]), folder / "nominal.toml", hidden)
