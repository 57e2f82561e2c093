"""Estimate the joint torque of a measured cable drive from the tendon elongation and the motor torque.

Usage: tools/run measured/stretch

Linear models are fitted with one load level or one frequency held out. Their error is pooled over all samples of the
held-out trials, including reversals. The models have these regressors:

  1. a constant
  2. motor torque and direction, which is (3.55) with free coefficients
  3. the elongation s = r_M q_M - r_J q_J
  4. elongation and motor torque, tau_J = P s - Q tau_M as in `tsa_ctrl/model/stretch.py`
  5. elongation and joint angle
  6. elongation, motor torque and joint angle

The coefficient of the joint angle is a spring at the joint or an error of a pulley radius, because only the ratio of
the radii is known. The models do not use friction or pretension, and only the second one uses the direction. The
command looks for the data in TSA_DATA, and then in ../shared/data. Without data it prints one line.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tools import command
from tools.measured.diagnose import FOLDS
from tsa_ctrl.identify.dataset import Dataset, load_log, matches
from tsa_ctrl.model.parameters import TendonSheath, load_tendon_sheath

EVERY = 10  # samples; every tenth sample of 1 kHz is sufficient, because the motion is below 1 Hz
LINES: dict[str, tuple[str, ...]] = {
    "a constant": (),
    "motor torque and direction": ("tau_m", "direction"),
    "stretch": ("stretch",),
    "stretch and motor torque": ("stretch", "tau_m"),
    "stretch and joint angle": ("stretch", "q_j"),
    "stretch, motor torque and joint angle": ("stretch", "tau_m", "q_j"),
}


def columns(log: Dataset, model: TendonSheath) -> dict[str, np.ndarray]:
    """Return the regressors and the measured joint torque of a log."""
    stretch = model.motor_pulley_radius * log["q_m"] - model.joint_pulley_radius * log["q_j"]
    found = {name: log[name] for name in ("tau_m", "q_j", "tau_j")}
    found |= {"stretch": stretch, "direction": np.sign(log["omega_j"]), "one": np.ones_like(stretch)}
    return {name: values[::EVERY] for name, values in found.items()}


def rows(logs: list[dict[str, np.ndarray]], names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    table = [np.column_stack([log[name] for name in (*names, "one")]) for log in logs]
    return np.concatenate(table), np.concatenate([log["tau_j"] for log in logs])


def left_out(logs: dict[str, dict[str, np.ndarray]], names: tuple[str, ...], split: str) -> float:
    """Return the RMS error on held-out trials over all folds of a split, mN*m."""
    errors = []
    for pattern in FOLDS[split]:
        inside = [log for name, log in logs.items() if not matches(name, pattern)]
        outside = [log for name, log in logs.items() if matches(name, pattern)]
        matrix, torque = rows(inside, names)
        numbers = np.linalg.lstsq(matrix, torque, rcond=None)[0]
        matrix, torque = rows(outside, names)
        errors.append(torque - matrix @ numbers)
    return 1e3 * float(np.sqrt(np.mean(np.square(np.concatenate(errors)))))


def main() -> int:
    command.parser(__name__, __doc__).parse_args()
    data = command.measured_data(__name__)
    if data is None:
        return 0
    model = load_tendon_sheath(data / "actuator.toml")
    logs = {path.name: columns(load_log(path), model) for path in sorted(Path(data).glob("load*.csv.gz"))}
    found = [(label, *(f"{left_out(logs, names, split):.1f}" for split in FOLDS)) for label, names in LINES.items()]
    command.print_table(("regressors of tau_J", "load left out, mN·m", "frequency left out, mN·m"), found)
    print("data: O'Neill, Stephens, Kowalewski, IEEE RA-L 3(4):3027-3034, 2018 (Open Database License 1.0)")
    return 0
