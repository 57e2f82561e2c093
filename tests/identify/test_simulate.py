"""Numbers, text and files of `tsa simulate`."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.identify.diagnosis.nominal import MODEL
from tests.identify.diagnosis.nominal import model as tendons
from tsa_ctrl import outputs
from tsa_ctrl.cli import main
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.dataset import Dataset, load_log
from tsa_ctrl.identify.motion import Made, in_words
from tsa_ctrl.identify.simulate import labels, simulate, simulate_all
from tsa_ctrl.identify.smoothing.bandwidth import LowPass
from tsa_ctrl.log.table import read_table
from tsa_ctrl.model.parameters import RigidDrive, load_model

R_M, R_J, X, PRETENSION = 0.02, 0.025, 0.26, 45.0  # of MODEL
DRIVE = """\
[actuator]
kind = "rigid_drive"
inertia = 2e-4
coulomb_friction = 0.05
viscous_friction = 1e-3
"""
T = np.arange(4000) * 1e-3
OMEGA = 2.0 * np.cos(4.0 * T + 0.3)
TAU_M = 0.7 * np.sin(2.3 * T) + 0.2 * np.cos(5.1 * T)
ERROR = 0.03 * np.sin(31.0 * T) + 0.01


def expected() -> np.ndarray:
    """Return the joint torque (N*m) by an independent evaluation of (3.55)."""
    return R_J * (TAU_M / R_M * math.cosh(X) - 2.0 * PRETENSION * np.sign(OMEGA) * math.sinh(X))


def write_csv(path: Path, **columns: np.ndarray) -> None:
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with logs and models. It is the working directory."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_text(MODEL)
    (tmp_path / "b.toml").write_text(MODEL + "[effects.torque_offset]\noffset = 0.01\n")
    (tmp_path / "drive.toml").write_text(DRIVE)
    tau_j = expected() + ERROR
    write_csv(tmp_path / "x.csv", t=T, tau_m=TAU_M, tau_j=tau_j, omega_j=OMEGA)
    write_csv(tmp_path / "no_joint.csv", t=T, tau_m=TAU_M, omega_j=OMEGA)
    omega_m = 30.0 * np.cos(4.0 * T + 0.3)
    tau = 2e-4 * np.gradient(omega_m, 1e-3) + 0.05 * np.sign(omega_m) + 1e-3 * omega_m + 0.004
    write_csv(tmp_path / "drive.csv", t=T, tau_m=tau, omega_m=omega_m)
    return tmp_path


def tsa(*arguments: str) -> int:
    with pytest.raises(SystemExit) as done:
        main(["simulate", *arguments])
    assert isinstance(done.value.code, int)
    return done.value.code


def test_the_prediction_is_the_simplified_model_over_all_samples(bench: Path) -> None:
    result = simulate(load_log("x.csv"), load_model("a.toml"))
    np.testing.assert_allclose(result.predicted, expected(), atol=1e-12)
    assert result.rms == pytest.approx(math.sqrt(np.mean(ERROR**2)))
    assert result.bias == pytest.approx(np.mean(ERROR))
    assert result.max_abs == pytest.approx(np.max(np.abs(ERROR)))


def test_text_ends_with_one_line_per_model_and_keeps_the_digits_of_a_small_error(
    bench: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert tsa("x.csv", "--model", "a.toml", "--model", "b.toml") == 0
    last = capsys.readouterr().out.splitlines()[-2:]
    rms = math.sqrt(np.mean(ERROR**2)), math.sqrt(np.mean((ERROR - 0.01) ** 2))
    assert last == [f"RMS error: {rms[0]:.4f} N*m (a.toml)", f"RMS error: {rms[1]:.4f} N*m (b.toml)"]
    write_csv(bench / "y.csv", t=T, tau_m=TAU_M, tau_j=expected() + 1.234e-6, omega_j=OMEGA)
    assert tsa("y.csv", "--model", "a.toml") == 0
    assert capsys.readouterr().out.splitlines()[-1] == "RMS error: 0.00000123 N*m (a.toml)"


def test_the_legends_of_the_picture_hide_no_data(bench: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figures: list[Figure] = []
    monkeypatch.setattr(outputs, "save_picture", lambda figure, path, **how: figures.append(figure))
    assert tsa("x.csv", "--model", "a.toml", "--model", "b.toml", "--picture", "x.png") == 0
    figures[0].draw_without_rendering()
    legends = [(axes, legend) for axes in figures[0].axes if (legend := axes.get_legend()) is not None]
    assert len(legends) == 2
    for axes, legend in legends:
        assert not legend.get_window_extent().overlaps(axes.get_window_extent().shrunk(0.99, 0.99))


def test_json_is_one_object_with_the_keys_that_programs_rely_on(
    bench: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert tsa("x.csv", "--model", "a.toml", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["schema"], found["log"]) == (1, "x.csv")
    (model,) = found["models"]
    assert model["model"] == "a.toml"
    assert model["rms"] == pytest.approx(math.sqrt(np.mean(ERROR**2)))
    assert (model["unit"], model["samples"], model["beyond_slack"]) == ("N*m", len(T), 0.0)
    assert {"bias", "max_abs"} <= set(model)


def test_without_a_joint_torque_it_predicts(bench: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert tsa("no_joint.csv", "--model", "a.toml", "--out", "o.csv", "--json") == 0
    (model,) = json.loads(capsys.readouterr().out)["models"]
    assert (model["rms"], model["bias"], model["max_abs"]) == (None, None, None)
    table = read_table("o.csv")
    assert list(table.columns) == ["t", "tau_j_sim"]
    np.testing.assert_allclose(table.columns["tau_j_sim"], expected(), atol=1e-12)
    assert tsa("no_joint.csv", "--model", "a.toml") == 0
    assert capsys.readouterr().out.splitlines()[-1] == "predicted only: the log has no tau_j (a.toml)"


def test_csv_has_the_columns_of_each_model_and_numbers_several(bench: Path) -> None:
    assert tsa("x.csv", "--model", "a.toml", "--out", "o.csv") == 0
    columns = read_table("o.csv").columns
    assert list(columns) == ["t", "tau_j", "tau_j_sim", "residual"]
    np.testing.assert_allclose(columns["residual"], ERROR, atol=1e-12)
    np.testing.assert_allclose(columns["tau_j"], columns["tau_j_sim"] + columns["residual"], atol=1e-12)
    assert tsa("x.csv", "--model", "a.toml", "--model", "b.toml", "--out", "o.csv.gz") == 0
    columns = read_table("o.csv.gz").columns
    assert list(columns) == ["t", "tau_j", "tau_j_sim_1", "tau_j_sim_2", "residual_1", "residual_2"]
    np.testing.assert_allclose(columns["tau_j_sim_2"] - columns["tau_j_sim_1"], 0.01, atol=1e-12)


def test_slack_is_said_with_its_share(bench: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_csv(bench / "y.csv", t=T, tau_m=3.0 * TAU_M, omega_j=OMEGA)
    (bench / "c.toml").write_text(MODEL + "[effects.tendon_slack]\n")
    assert tsa("y.csv", "--model", "a.toml", "--model", "c.toml") == 0
    out = capsys.readouterr().out
    share = np.mean(np.abs(3.0 * TAU_M) >= 2.0 * PRETENSION * R_M)
    assert f"{share:.1%} of the samples lie beyond abs(tau_m) = 2 T_p r_M" in out
    assert "outside the domain of (3.55) (a.toml)" in out
    assert "as modelled by [effects.tendon_slack] (c.toml)" in out


class TestPlainDrive:
    def test_it_predicts_the_motor_torque_and_its_files_name_it(self, bench: Path) -> None:
        result = simulate(load_log("drive.csv"), load_model("drive.toml"))
        assert result.quantity == "tau_m"
        assert result.rms == pytest.approx(0.004, rel=0.05)
        assert result.beyond_slack == 0.0
        assert tsa("drive.csv", "--model", "drive.toml", "--out", "o.csv", "--picture", "p.png") == 0
        assert list(read_table("o.csv").columns) == ["t", "tau_m", "tau_m_sim", "residual"]

    def test_it_is_not_set_beside_a_tendon_sheath(self, bench: Path) -> None:
        omega = {"omega_m": 1.25 * OMEGA, "omega_j": OMEGA}
        log = Dataset.from_arrays({"t": T, "tau_m": TAU_M, **omega})
        models = [("a", load_model("a.toml")), ("d", RigidDrive(torque_offset=0.1))]
        with pytest.raises(UsageError, match="in two calls"):
            simulate_all(log, models)


def test_models_of_one_name_are_told_apart_by_their_path() -> None:
    assert labels(["a/m.toml", "b/m.toml", "c/n.toml"]) == ["a/m.toml", "b/m.toml", "n.toml"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("x.csv",), "Missing option '--model'"),
        (("nope.csv", "--model", "a.toml"), "nope.csv: no such file"),
        (("x.csv", "--model", "nope.toml"), "nope.toml: no such file"),
        (("drive.csv", "--model", "a.toml"), "column omega_j or q_j is missing"),
        (("x.csv", "--model", "needs.toml"), "needs column temperature"),
        (("reversed.csv", "--model", "a.toml"), "column tau_j is reversed"),
        (("x.csv", "--model", "a.toml", "--out", "no/such/o.csv"), "no/such/o.csv: cannot be written"),
        (("x.csv", "--model", "a.toml", "--picture", "p.xyz"), "p.xyz: no picture of that kind"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_line_and_code_2(
    bench: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str
) -> None:
    thermal = "[effects.thermal_friction_drift]\ntemperature_coefficient = 0.01\n"
    (bench / "needs.toml").write_text(MODEL + thermal)
    write_csv(bench / "reversed.csv", t=T, tau_m=TAU_M, tau_j=-expected(), omega_j=OMEGA)
    assert tsa(*arguments, "--json") == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert said in output.err
    assert output.err.count("\n") == 1


@pytest.mark.parametrize(
    ("moves", "changed", "factor", "words"),
    [
        ("one way", "tau_j", -1.0, "column tau_j is likely reversed: .*slope .* -0.999"),
        ("locked", "tau_m", -1.0, "column tau_j or tau_m is likely reversed"),
        ("one way", "tau_j", 10.197, "column tau_j is likely in kgf.cm: with 0.09807 .* 10.*; convert it to N.m"),
        ("steady load", "tau_j", 100.0, "column tau_j is likely in N.cm: with 0.01 .*; convert it to N.m"),
        ("steady load", "tau_j", -100.0, "column tau_j is likely reversed and in N.cm.* and turn its sign"),
        ("one way", "tau_j", 1.0, ""),
        ("steady load", "tau_j", 1.0, ""),
    ],
)
def test_a_likely_sign_or_unit_is_named(moves: str, changed: str, factor: float, words: str) -> None:
    """The check of energy needs motion in both directions, and the check of units a load that changes."""
    omega = {"one way": 1.0 + 0.5 * np.sin(T), "locked": 0.0 * T, "steady load": OMEGA}[moves]
    tau_m = 0.1 + 0.0 * T if moves == "steady load" else TAU_M
    loss = 2.0 * PRETENSION * np.sign(omega) * math.sinh(X)
    log = {"t": T, "tau_m": tau_m, "tau_j": R_J * (tau_m / R_M * math.cosh(X) - loss), "omega_j": omega}
    log["tau_j"] = log["tau_j"] + 0.1 * ERROR
    log[changed] = factor * log[changed]
    assert re.match(words or "$", simulate(Dataset.from_arrays(log, "log"), tendons()).likely)


def test_the_likely_sign_is_a_note_in_one_line(bench: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_csv(bench / "one_way.csv", t=T, tau_m=TAU_M, tau_j=-expected() + 2.0 * R_J * TAU_M / R_M, omega_j=0.0 * T + 1)
    assert tsa("one_way.csv", "--model", "a.toml", "--json") == 0
    assert not any("likely" in note for note in json.loads(capsys.readouterr().out)["notes"])
    write_csv(bench / "locked.csv", t=T, tau_m=TAU_M, tau_j=-R_J * TAU_M / R_M, omega_j=0.0 * T)
    assert tsa("locked.csv", "--model", "a.toml") == 0
    assert "note: column tau_j or tau_m is likely reversed: " in capsys.readouterr().out


@pytest.mark.slow
def test_the_measured_cable_drive_as_given_has_the_published_error(data_dir: Path) -> None:
    """The published error is 61 mN*m, with angles low-passed at 10 Hz.

    It is slightly smaller at the bandwidth of the data.
    """
    folder = data_dir / "davinci"
    model = load_model(folder / "actuator.toml")
    results = [simulate(load_log(path), model) for path in sorted(folder.glob("*.csv.gz"))]
    assert len(results) == 25
    samples = sum(len(result.predicted) for result in results)
    squares = sum(float(np.sum(result.residual**2)) for result in results if result.residual is not None)
    assert round(1e3 * math.sqrt(squares / samples)) == 60
    slack = sum(result.beyond_slack * len(result.predicted) for result in results)
    assert round(100.0 * slack / samples) == 39


def test_a_log_in_which_nothing_changes_is_said_to_be_one_point(
    bench: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    still = np.full_like(T, 0.5)
    write_csv(bench / "still.csv", t=T, tau_m=still, tau_j=0.8 * still, omega_j=0.0 * still)
    assert tsa("still.csv", "--model", "a.toml") == 0
    assert (
        "note: tau_m, tau_j, omega_j never change: an error of this log belongs to one point" in capsys.readouterr().out
    )
    assert tsa("x.csv", "--model", "a.toml") == 0
    assert "one point" not in capsys.readouterr().out


def test_the_measured_linear_axis_as_given_has_the_published_error(data_dir: Path) -> None:
    """The published error is 2.4 N with a filter designed for this axis.

    A low-pass at 10 Hz ahead of the derivatives gave 14 N.
    """
    folder = data_dir / "emps"
    found = simulate(load_log(folder / "emps.csv.gz"), load_model(folder / "emps.toml"))
    assert found.rms is not None
    assert found.rms < 1.1 * 2.4


def test_how_a_column_was_derived_is_told_in_plain_numbers() -> None:
    (line,) = in_words([Made("omega_m", "q_m", LowPass(2, 187.4), 7.42e-6, 6.04e-6, None)])
    assert "low-pass at 190 Hz" in line
    assert "7.4e-06 rad/s RMS" in line
