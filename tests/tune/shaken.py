"""Logs of a motor shaken on the plant's own mechanics, without bus and loop, so that the truth is known."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from tests.virtual.rigs import Drawn
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import save_model
from tsa_ctrl.plant.axis import Axis
from tsa_ctrl.plant.settings import AxisSettings, PhysicsSettings

PERIOD = 1e-3  # s
LAG = 0.5e-3  # s, of the drive's torque loop
COUNTS_M, COUNTS_J = 1 << 16, 1 << 20  # per revolution
STEADY = 0.5  # s; this beginning of a log is removed


def true_delay(drawn: Drawn) -> float:
    """Return the time from a measurement to the middle of the torque that responds to it (s)."""
    return (drawn.delay + 0.5) * PERIOD + LAG


def play(
    folder: Path,
    drawn: Drawn,
    command: NDArray[np.float64],
    frequency: float = 0.7,
    amplitude: float = 0.5,
    **more: Any,
) -> Dataset:
    """Return the log of a motor command (n) in N*m, one value per period, on a joint that moves sinusoidally (Hz, rad).

    `more`: further settings of the axis.
    """
    save_model(drawn.nominal, folder / "nominal.toml")
    tables: dict[str, Mapping[str, Any] | str] = {
        "name": "joint",
        "actuator": str(folder / "nominal.toml"),
        **drawn.axis(),
        "motion": {"kind": "sine", "amplitude": amplitude, "frequency": frequency, "ramp": 0.1},
        **more,
    }
    joint = Axis(msgspec.convert(tables, AxisSettings), PhysicsSettings())
    joint.command.enabled = True
    rng = np.random.default_rng(drawn.number)
    names = ("torque_loop", "q_m", "omega_m", "q_j", "omega_j", "tau_j")
    rows = np.empty((command.size, len(names)))
    for k in range(command.size):
        values = joint.values()
        rows[k] = [values[name] for name in names]
        joint.command.torque = float(command[k - drawn.delay]) if k >= drawn.delay else 0.0
        joint.advance((k + 1) * PERIOD)
    torque, q_m, omega_m, q_j, omega_j, tau_j = rows.T
    columns = {
        "t": PERIOD * np.arange(command.size),
        "tau_m_cmd": command,
        "tau_m": torque + rng.normal(0.0, 2e-3, command.size),
        "q_m": counted(q_m, COUNTS_M),
        "omega_m": omega_m,
        "q_j": counted(q_j, COUNTS_J),
        "omega_j": omega_j,
        "tau_j": tau_j + rng.normal(0.0, 5e-3, command.size),
    }
    steady = round(STEADY / PERIOD)
    return Dataset.from_arrays({name: values[steady:] for name, values in columns.items()}, "shaken")


def counted(angle: NDArray[np.float64], counts: int) -> NDArray[np.float64]:
    """Return the angle (rad) as an encoder with this number of counts reports it."""
    step = 2.0 * np.pi / counts
    found: NDArray[np.float64] = step * np.floor(angle / step)
    return found
