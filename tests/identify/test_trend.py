"""Trend over runs: hidden wear is reported with its first run, plain scatter is not, and bad logs are reported."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest

from tests.blind.tendon_logs import Rig, draw_rig, model_text, record
from tests.identify.test_calibrate_cli import write_csv
from tsa_ctrl.cli import main
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.identify.trend import ALARM, Run, judged, measured, trend
from tsa_ctrl.model.parameters import load_tendon_sheath

RUNS, WORN = 8, 5
SECONDS = 8.0


def folder_of(folder: Path, wear: float) -> Path:
    """Return a folder with runs of one rig.

    From run `WORN` on, the friction coefficient is (1 + wear) times its value before.
    """
    rng = np.random.default_rng(5)
    rig: Rig = draw_rig(rng, "joint_end")
    (folder / "actuator.txt").write_text(model_text(rig, rng), encoding="utf-8")
    logs = folder / "logs"
    logs.mkdir()
    for number in range(RUNS):
        today = dataclasses.replace(rig, mu=rig.mu * (1.0 + wear * (number >= WORN)))
        write_csv(logs / f"run{number}.csv", record(today, rng, seconds=SECONDS, rate=250.0))
    (folder / "actuator.txt").rename(folder / "actuator.toml")
    return folder


@pytest.mark.slow
def test_a_liner_that_wears_is_told_with_its_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = folder_of(tmp_path, 0.15)
    picture = folder / "trend.png"
    options = ["--model", str(folder / "actuator.toml")]
    with pytest.raises(SystemExit) as stop:
        main(["log", "trend", str(folder / "logs"), *options, "--picture", str(picture), "--json"])
    assert stop.value.code in (0, None)
    found = json.loads(capsys.readouterr().out)
    assert len(found["runs"]) == RUNS
    (change,) = found["changes"]
    assert (change["quantity"], change["since"]) == ("half_loop_torque", f"run{WORN}.csv")
    assert change["after"] / change["before"] == pytest.approx(1.15, abs=0.04)
    assert "a liner wears" in change["words"]
    assert picture.stat().st_size > 10_000


def test_a_rig_that_stays_as_it_is_changes_nothing(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, 0.0)
    assert not trend(folder / "logs", load_tendon_sheath(folder / "actuator.toml")).changes


def runs(values: np.ndarray, name: str = "axial_stiffness", half: float = 0.0, warmth: float = math.nan) -> list[Run]:
    """Return synthetic runs. `warmth` is the rise of the temperature per run (K)."""
    return [
        Run(f"run{k}", f"2026-01-{k + 1:02}", 20.0 + warmth * k, {name: Quantity(v, v - half, v + half, "N")})
        for k, v in enumerate(values.tolist())
    ]


def test_false_alarms_are_as_rare_as_is_said() -> None:
    """400 rigs of twelve runs have random scatter only.

    The scatter is 10 %, so that the minimum change does not suppress alarms.
    """
    rng = np.random.default_rng(1)
    told = sum(bool(judged(runs(6e4 * (1.0 + 0.1 * rng.standard_normal(12)))).changes) for _ in range(400))
    assert told <= 10  # 4 are expected at 1 %; the probability of more than 10 is 0.3 %
    assert ALARM == 0.01


def test_a_tendon_that_softens_is_told() -> None:
    rng = np.random.default_rng(2)
    values = 6e4 * (1.0 + 0.005 * rng.standard_normal(10))
    values[6:] *= 0.93
    (change,) = judged(runs(values)).changes
    assert change.since == "run6"
    assert "one frays" in str(change)


def test_what_the_intervals_leave_open_is_no_change() -> None:
    values = np.array([1.0, 1.0, 1.0, 1.0, 1.1, 1.1, 1.1, 1.1]) + 1e-6 * np.arange(8)
    assert judged(runs(values)).changes
    assert not judged(runs(values, half=0.3)).changes


def test_friction_that_follows_the_temperature_is_no_wear() -> None:
    rng = np.random.default_rng(3)
    values = 0.6 * (1.0 - 0.01 * np.arange(10.0)) + 0.001 * rng.standard_normal(10)
    found = judged(runs(values, "half_loop_torque", warmth=2.0))
    assert found.by_temperature == pytest.approx(-0.003, rel=0.2)
    assert not found.changes
    assert judged(runs(values, "half_loop_torque")).changes


def test_fewer_runs_than_six_tell_no_change() -> None:
    assert not judged(runs(np.array([1.0, 1.0, 1.0, 2.0, 2.0]))).changes


def test_bad_input_is_one_line(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    rig = draw_rig(rng, "joint_end")
    (tmp_path / "actuator.toml").write_text(model_text(rig, rng), encoding="utf-8")
    model = load_tendon_sheath(tmp_path / "actuator.toml")
    logs = tmp_path / "logs"
    with pytest.raises(UsageError, match="no such folder"):
        trend(logs, model)
    logs.mkdir()
    with pytest.raises(UsageError, match="holds no log"):
        trend(logs, model)
    log = record(rig, rng, seconds=2.0, rate=250.0)
    write_csv(logs / "run.csv", {name: log[name] for name in ("t", "tau_m", "omega_j")})
    with pytest.raises(UsageError, match=r"run.csv: has neither column tau_j nor both q_m and q_j; log the joint"):
        trend(logs, model)
    write_csv(logs / "run.csv", record(rig, rng, seconds=SECONDS, rate=250.0))
    for name, target in (("copy.csv", logs / "run.csv"), ("gone.csv", logs / "nowhere.csv")):
        (logs / name).symlink_to(target)
    (logs / "folder.csv").mkdir()
    notes = {run.log: " ".join(run.notes) for run in trend(logs, model).runs if not run.quantities}
    assert notes["run.csv"].endswith("run.csv: has the same data as copy.csv")
    assert "no such file" in notes["gone.csv"]
    assert "is a folder" in notes["folder.csv"]
    (logs / "copy.csv").unlink()
    (logs / "gone.csv").unlink()
    (logs / "folder.csv").rmdir()
    (logs / "run.csv").write_text("t,tau_m\n0,nonsense\n", encoding="utf-8")
    with pytest.raises(UsageError, match=r"none of 1 logs shows friction torque or stiffness; .*run.csv") as caught:
        trend(logs, model)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_the_lever_is_told_where_the_bending_varied(tmp_path: Path) -> None:
    """The reference is k_t = EA/l of a rig by independent code, at the true friction coefficient.

    A softer tendon is reported as a change.
    """
    rng = np.random.default_rng(8)
    rig: Rig = draw_rig(rng, "joint_end")
    runs = []
    for number, share in enumerate((1.0,) * 4 + (0.8,) * 4):
        today = dataclasses.replace(rig, ea=share * rig.ea)
        path = tmp_path / f"run{number}.csv"
        write_csv(path, record(today, rng, seconds=20.0, rate=100.0, theta_swing=0.6))
        (tmp_path / "actuator.toml").write_text(model_text(rig, rng), encoding="utf-8")
        nominal = load_tendon_sheath(tmp_path / "actuator.toml")
        model = dataclasses.replace(nominal, friction_coefficient=rig.mu)
        runs.append(dataclasses.replace(measured(path, model), started=f"2026-01-0{number + 1}"))
    first = runs[0].quantities["tension_per_path"]
    assert first.value == pytest.approx(rig.ea / rig.length, rel=0.1)
    assert first.low < rig.ea / rig.length < first.high
    (change,) = [change for change in judged(runs).changes if change.quantity == "tension_per_path"]
    assert change.since == "run4.csv"
    assert change.after / change.before == pytest.approx(0.8, abs=0.05)
