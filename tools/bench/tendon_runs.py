"""Runs of the plant's mechanics off the bus, for the tools that compare and time them."""

from __future__ import annotations

import math
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tomlkit
from numpy.typing import NDArray

from tsa_ctrl.model.parameters import TendonSheath, save_model
from tsa_ctrl.plant.axis import Axis
from tsa_ctrl.plant.settings import load_plant

PERIOD = 1e-3  # s between two commands
AMPLITUDE, FREQUENCY = 0.4, 0.5  # rad, Hz: of the imposed motion
TORQUE, OFFSET, LOAD_FREQUENCY = 0.5, 0.15, 0.31  # N*m, N*m, Hz: of the motor torque
SETTLE = 1.0  # s in which the motion grows from standstill


@dataclass(frozen=True)
class Course:
    """Signals (n) at PERIOD, and the processor time per simulated second."""

    t: NDArray[np.float64]
    tau_m: NDArray[np.float64]
    tau_j: NDArray[np.float64]
    q_j: NDArray[np.float64]
    omega_j: NDArray[np.float64]
    cost: float


def make_axis(model: TendonSheath, kind: str, elements: int = 40, step: float = 1e-4) -> Axis:
    """One axis with exactly the parameters of `model`, evenly bent, a motor without inertia and no noise."""
    axis = {
        "name": "joint",
        "actuator": "actuator.toml",
        "tendon": {"kind": kind, "curvature": "uniform", "elements": elements},
        "drive": {"torque_time_constant": 1e-5, "torque_noise": 0.0},
        "motor": {"inertia": 0.0},
        "torque_sensor": {"noise": 0.0},
        "motion": {"kind": "sine", "amplitude": AMPLITUDE, "frequency": FREQUENCY, "ramp": SETTLE},
    }
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        save_model(model, folder / "actuator.toml")
        (folder / "plant.toml").write_text(tomlkit.dumps({"physics": {"step": step}, "axis": [axis]}), encoding="utf-8")
        plant = load_plant(folder / "plant.toml")
        return Axis(plant.axis[0], plant.physics)


def run(axis: Axis, seconds: float) -> Course:
    """Play motion and torque on an axis; the first SETTLE s are left out of the course."""
    count = round((SETTLE + seconds) / PERIOD)
    rows = np.zeros((count, 5))
    axis.command.enabled = True
    axis.advance(1e-9)  # compiles, or loads what was compiled before
    begin = time.process_time()
    for i in range(count):
        t = (i + 1) * PERIOD
        axis.command.torque = OFFSET + TORQUE * math.sin(2.0 * math.pi * LOAD_FREQUENCY * t)
        axis.advance(t)
        v = axis.values()
        rows[i] = t, v["tau_m"], v["tau_j"], v["q_j"], v["omega_j"]
    cost = (time.process_time() - begin) / (count * PERIOD)
    kept = rows[rows[:, 0] > SETTLE]
    t, tau_m, tau_j, q_j, omega_j = np.ascontiguousarray(kept.T)
    return Course(t, tau_m, tau_j, q_j, omega_j, cost)
