"""`tsa tune` without a rig: plan, estimate from logs, diff, confirmation, undo, and one-line errors."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import math
import shutil
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.blind import tendon_logs
from tsa_ctrl.cli import main
from tsa_ctrl.config import load_configuration
from tsa_ctrl.control.setpoint import waveform
from tsa_ctrl.control.settings import SetPointSettings
from tsa_ctrl.identify.diagnosis.report.result import Experiment
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.model.parameters import load_tendon_sheath
from tsa_ctrl.tune import report
from tsa_ctrl.tune.mechanics import Key, LawTuning
from tsa_ctrl.tune.report import parameter_rows
from tsa_ctrl.tune.session import Plan, Session, draw

CONFIG = Path(__file__).resolve().parents[2] / "config"
COMMENT = "# measured with a calliper\n"
FROM_LOG = ("controller.toml", "--from-log", "a.csv")

Recorded = tuple[str, dict[str, np.ndarray]]


def tsa(*arguments: str) -> int:
    with pytest.raises(SystemExit) as done:
        main(["tune", *arguments])
    assert isinstance(done.value.code, int)
    return done.value.code


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    """Return a nominal model file and a log of a rig that differs from it."""
    rng = np.random.default_rng(5)
    rig = tendon_logs.draw_rig(rng, "joint_end")
    return COMMENT + tendon_logs.model_text(rig, rng), tendon_logs.record(rig, rng, seconds=20.0, rate=200.0)


def write(folder: Path, recorded: Recorded) -> None:
    shutil.copy(CONFIG / "controller.toml", folder)
    text, log = recorded
    (folder / "actuator.toml").write_text(text)
    table = np.column_stack(list(log.values()))
    np.savetxt(folder / "a.csv", table, delimiter=",", header=",".join(log), comments="", fmt="%.9g")


@pytest.fixture
def folder(recorded: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    write(tmp_path, recorded)
    return tmp_path


@pytest.fixture(scope="module")
def once(recorded: Recorded, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Return a folder in which the file was tuned with a report, and the printed text."""
    folder = tmp_path_factory.mktemp("tuned")
    write(folder, recorded)
    printed = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(printed):
        assert tsa(*FROM_LOG, "--yes", "--out", "out") == 0
    return folder, printed.getvalue()


@pytest.fixture
def tuned(once: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a separate copy of that folder."""
    shutil.copytree(once[0], tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_dry_run_tells_the_plan_and_touches_nothing(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = files(folder)
    bounds = ("--torque", "0.3", "--seconds", "15", "--speed", "3", "--travel", "-1", "1")
    assert tsa("controller.toml", "--dry-run", *bounds) == 0
    out = capsys.readouterr().out
    assert "0.3 N*m at the joint" in out
    assert "excitation, 15 s" in out
    assert tsa("controller.toml", "--dry-run", "--json", *bounds) == 0
    data = json.loads(capsys.readouterr().out)
    assert (data["schema"], data["axis"]) == (1, "knee")
    assert (data["bounds"]["speed"], data["bounds"]["travel"]) == (3.0, [-1.0, 1.0])
    assert files(folder) == before


def test_the_experiment_of_a_diagnosis_is_the_excitation(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t = np.arange(0.0, 60.0, 0.01)
    (folder / "experiment.csv").write_text(Experiment("", tuple(t), tuple(0.3 * np.sin(t))).csv())
    assert tsa("controller.toml", "--dry-run", "--setpoint", "experiment.csv") == 0
    assert "excitation, 59.98 s of the given file" in capsys.readouterr().out
    played = waveform(SetPointSettings(kind="file", file="experiment.csv"), folder)
    assert played(math.pi / 2.0) == pytest.approx(0.3, abs=1e-3)


@pytest.mark.slow
def test_a_yes_writes_the_file_keeps_the_one_before_and_makes_a_page(
    recorded: Recorded, once: tuple[Path, str], tuned: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A second tuning on the same log changes the held-out error by at most 5 %. An undo restores the file."""
    nominal, folder, out = recorded[0], tuned, once[1]
    diff, table = out.index("+++ actuator.toml (new)"), out.index("95 % interval")
    assert diff < table < out.index("written: actuator.toml")  # the table is printed before the question
    text = (folder / "actuator.toml").read_text()
    assert COMMENT in text
    assert (
        load_tendon_sheath("actuator.toml").friction_angle != tomllib.loads(nominal)["sheath"]["friction_coefficient"]
    )
    data = tomllib.loads(text)
    source = data["provenance"]
    new = [data["sheath"]["friction_coefficient"], data["pretension"]["value"], *source["intervals"]["friction_angle"]]
    # as many digits as the interval justifies
    assert max(len(str(number).replace(".", "").lstrip("0")) for number in new) <= 5
    assert source["command"] == "tune --from-log"
    assert set(source["logs"]) == {"a.csv"}
    page = (folder / "out" / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 2
    assert "http" not in page.replace("http-equiv", "")
    assert (folder / "out" / "fit.png").read_bytes().startswith(b"\x89PNG")
    assert not list(folder.glob(".tune-*"))

    assert tsa(*FROM_LOG, "--json", "--dry-run") == 0
    rms = json.loads(capsys.readouterr().out)["calibration"]["rms"]
    assert rms["after"] == pytest.approx(rms["before"], rel=0.05)

    assert tsa("controller.toml", "--undo") == 0
    assert "restored from actuator.toml.~1~" in capsys.readouterr().out
    assert (folder / "actuator.toml").read_text() == nominal
    assert tsa("controller.toml", "--undo") == 2


def test_what_was_measured_of_the_motor_goes_into_the_controllers_file_and_back_with_the_model(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = files(folder)
    session = Session(Path("controller.toml"), None, Plan())
    inertia = Quantity(1.02e-4, 1.0e-4, 1.04e-4, "kg*m^2")
    keys = {"motor_inertia": Key(1.02e-4, "measured"), "damping": Key(0.02, "gain margin 3.1 at 2 ms")}
    tuning = LawTuning(keys, {"motor_inertia": inertia}, 3.1)
    outcome = dataclasses.replace(session.from_logs(["a.csv"]), law=tuning)
    assert "+damping = 0.02 # tsa tune: gain margin 3.1 at 2 ms" in session.difference(outcome)
    law = report.to_dict(outcome, "knee", None, None)["law"]
    assert (law["keys"]["damping"], law["gain_margin"]) == (0.02, 3.1)
    assert law["quantities"]["motor_inertia"]["low"] == 1.0e-4
    assert ("motor inertia", "", "0.000102", "0.0001 to 0.000104", "kg·m²") in parameter_rows(outcome)
    stiffness = {"axial_stiffness": Quantity(5.5e4, 5.4e4, 5.6e4, "N")}
    stiff = dataclasses.replace(outcome, estimate=dataclasses.replace(outcome.estimate, parameters=stiffness))
    file = f"{outcome.nominal.axial_stiffness:.4g}"
    assert ("axial stiffness", file, "5.5e+04", "5.4e+04 to 5.6e+04", "N") in parameter_rows(stiff)
    assert set(session.write(outcome)) == {Path("actuator.toml"), Path("controller.toml")}
    assert load_configuration(folder / "controller.toml").file.axes[0].law.damping == 0.02

    edited = (folder / "controller.toml").read_text() + "# mine\n"
    tuned = (folder / "controller.toml").read_bytes()
    (folder / "controller.toml").write_text(edited)
    assert tsa("controller.toml", "--undo") == 2
    assert "was edited since the tuning" in capsys.readouterr().err
    assert (folder / "controller.toml").read_text() == edited
    assert (folder / "actuator.toml").read_bytes() != before["actuator.toml"]

    (folder / "controller.toml").write_bytes(tuned)
    assert tsa("controller.toml", "--undo") == 0
    assert "controller.toml: restored from controller.toml.~1~" in capsys.readouterr().out
    assert files(folder) == before


@pytest.mark.slow
def test_json_has_the_estimate_and_writes_only_with_yes(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A dry run shows the changes. Without a terminal for the answer, nothing is written either."""
    before = files(folder)
    assert tsa(*FROM_LOG, "--dry-run") == 0
    assert "+++ actuator.toml (new)" in capsys.readouterr().out
    assert files(folder) == before
    assert tsa(*FROM_LOG) == 0
    assert "without a terminal" in capsys.readouterr().err
    assert tsa(*FROM_LOG, "--json") == 0
    data = json.loads(capsys.readouterr().out)
    assert (data["schema"], data["written"], data["verification"], data["errors"]["unit"]) == (1, None, None, "N*m")
    assert 0.0 < data["errors"]["sensor_noise"] <= 1.1 * data["errors"]["sliding"] < 0.1
    assert data["calibration"]["rms"]["after"] < data["calibration"]["rms"]["before"]
    assert files(folder)["actuator.toml"] == before["actuator.toml"]
    assert tsa(*FROM_LOG, "--json", "--yes") == 0
    assert json.loads(capsys.readouterr().out)["written"].endswith("actuator.toml.~1~")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("nowhere.toml",), "nowhere.toml: no such file"),
        (("controller.toml", "--axis", "hip", "--dry-run"), "--axis hip; give one of knee"),
        (("controller.toml", "--torque", "50", "--dry-run"), "more than limits.torque and the pretension allow"),
        (("controller.toml", "--speed", "50", "--dry-run"), "above limits.joint_speed"),
        (("controller.toml", "--travel", "1", "-1", "--dry-run"), "wider than two travel margins"),
        (("controller.toml", "--seconds", "1"), "--seconds"),
        (("controller.toml", "--from-log", "nowhere.csv"), "nowhere.csv: no such file"),
        ((*FROM_LOG, "--out", "full"), "is not empty"),
        ((*FROM_LOG, "--setpoint", "a.csv"), "--setpoint"),
        ((*FROM_LOG, "--undo"), "only restores the previous files"),
        (("controller.toml", "--undo", "--dry-run"), "only restores the previous files"),
        (("controller.toml", "--undo"), "nothing to undo"),
    ],
)
def test_a_mistake_is_one_line_code_2_and_nothing_on_stdout(
    folder: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str
) -> None:
    (folder / "full").mkdir()
    (folder / "full" / "x").touch()
    before = files(folder)
    assert tsa(*arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert said in captured.err
    assert captured.err.count("\n") == 1
    assert files(folder) == before


def test_the_pictures_have_one_unit_of_the_error_one_zero_of_the_time_and_legends_beside_the_data(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    figures: list[Figure] = []
    saved = Figure.savefig

    def keep(figure: Figure, *places: Any, **how: Any) -> None:
        figures.append(figure)
        saved(figure, *places, **how)

    monkeypatch.setattr(Figure, "savefig", keep)
    t, zero = np.linspace(1.0, 9.0, 81), np.zeros(81)
    run = SimpleNamespace(t=t, wanted=zero, delivered=zero + 0.05, rms=0.05)
    verification = SimpleNamespace(without=run, before=None, after=run)
    outcome = Session(Path("controller.toml"), None, Plan()).from_logs(["a.csv"])
    draw(dataclasses.replace(outcome, verification=cast(Any, verification)), Path())
    fit, residual, verified = figures
    error = verified.axes[1]
    assert error.get_ylabel() == "torque error (mN·m)"
    assert error.lines[0].get_ydata() == pytest.approx(50.0)
    assert residual.axes[0].lines[0].get_xdata()[0] == 0.0
    for panel in (axes for figure in (fit, residual, verified) for axes in figure.axes):
        legend = panel.get_legend()
        assert legend is not None
        assert not legend.get_window_extent().overlaps(panel.get_window_extent().shrunk(0.99, 0.99))
