"""Test that each command reports the measured columns that it does not use, for each kind of model."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tsa_ctrl.cli import cli
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.unused import with_unused
from tsa_ctrl.log.convert import write_columns
from tsa_ctrl.model.parameters import GearedDrive, Model, RigidDrive, load_model

TENDON = Path(__file__).parents[2] / "config" / "actuator.toml"
T = np.arange(0.0, 10.0, 2e-3)
JOINT = {"q_j": 0.5 * np.sin(2.0 * T), "omega_j": np.cos(2.0 * T)}
MOTOR = {"q_m": 0.6 * np.sin(2.0 * T), "omega_m": 1.2 * np.cos(2.0 * T)}
TORQUES = {"tau_m": 0.4 * np.sin(3.0 * T), "tau_j": 0.4 * np.sin(3.0 * T), "tau_j_des": 0.4 * np.sin(3.0 * T)}


def measured(*more: str) -> Dataset:
    columns = {"t": T, **TORQUES, **JOINT, **MOTOR, **{name: np.full(T.size, 20.0) for name in more}}
    return Dataset.from_arrays(columns)


def tendon(**effects: dict[str, float]) -> Model:
    return load_model(TENDON).with_effects(effects)


UNUSED = [
    (RigidDrive(inertia=0.1), False, (), "column tau_j, q_j, omega_j; a joint torque sensor behind a gear needs"),
    (RigidDrive(inertia=0.1), True, ("temperature",), "column tau_j, q_j, omega_j;"),
    (GearedDrive(9.0), False, ("t1", "theta"), "column q_m, omega_m, t1, theta"),
    (GearedDrive(9.0), True, ("t1", "theta"), "column t1, theta"),
    (tendon(), False, ("t1", "theta", "temperature"), "column q_m, omega_m, t1, temperature"),
    (tendon(), True, ("theta", "temperature", "q_j.hip"), ""),
    (tendon(), False, ("q_j.hip",), "column q_m, omega_m, q_j.hip"),
    (tendon(torque_ripple={"amplitude": 0.01, "cycles_per_revolution": 6.0}), False, (), ""),
    (tendon(thermal_friction_drift={"temperature_coefficient": 0.01}), False, ("temperature",), "column q_m, omega_m"),
]


@pytest.mark.parametrize(("model", "hypotheses", "more", "said"), UNUSED)
def test_the_columns_that_are_not_used_are_listed(
    model: Model, hypotheses: bool, more: tuple[str, ...], said: str
) -> None:
    log = measured(*more)
    found = [note for note in with_unused(log, model, "it", hypotheses=hypotheses).notes if note not in log.notes]
    assert [note.startswith(f"not used by it with a {model.kind.value}: {said}") for note in found] == [True] * bool(
        said
    )


def test_every_command_reports_them(tmp_path: Path) -> None:
    """Columns with unknown names, such as a current, are listed as well. The list is cut after eight names."""
    rigid, log = tmp_path / "rigid.toml", tmp_path / "log.csv"
    rigid.write_text('[actuator]\nkind = "rigid_drive"\ninertia = 0.1\n')
    write_columns(log, {"t": T, **TORQUES, **JOINT, **MOTOR, "i_q": T, "t1": T, **{f"x{n}": T for n in range(9)}})
    run = CliRunner().invoke(cli, ["simulate", str(log), "--model", str(rigid), "--json"])
    (note,) = [note for note in json.loads(run.stdout)["notes"] if note.startswith("not used")]
    assert "simulate with a rigid_drive: column tau_j, q_j, omega_j, t1, i_q, x0, x1, x2 and 6 more" in note
    assert "tsa log import renames" in note
    run = CliRunner().invoke(cli, ["diagnose", str(log), "--model", str(rigid), "--out", str(tmp_path / "out")])
    assert run.exit_code == 0, run.output
    assert "not used by diagnose with a rigid_drive: column tau_j" in (tmp_path / "out" / "report.html").read_text()
    run = CliRunner().invoke(cli, ["simulate", str(log), "--model", str(TENDON)])
    assert "note: not used by simulate with a tendon_sheath: column q_m, omega_m, t1, i_q" in run.output
