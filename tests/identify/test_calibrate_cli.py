"""Output and files of `tsa calibrate`, and its one-line errors."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from tests.blind import tendon_logs
from tsa_ctrl import Dataset, calibrate, diagnose
from tsa_ctrl.cli import main
from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.table import sha256_of
from tsa_ctrl.model.parameters import load_tendon_sheath, model_from

COMMENT = "# measured with a calliper\n"


def tsa(*arguments: str) -> int:
    with pytest.raises(SystemExit) as done:
        main(["calibrate", *arguments])
    assert isinstance(done.value.code, int)
    return done.value.code


def write_csv(path: Path, columns: dict[str, np.ndarray]) -> None:
    np.savetxt(
        path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="", fmt="%.9g"
    )


@pytest.fixture(scope="module")
def recorded() -> tuple[str, dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return a nominal model file, a log, and a log with a tensioner force that is 20 N higher."""
    rng = np.random.default_rng(5)
    rig = tendon_logs.draw_rig(rng, "joint_end")
    text = COMMENT + tendon_logs.model_text(rig, rng)
    short = {"seconds": 20.0, "rate": 200.0}
    return text, tendon_logs.record(rig, rng, **short), tendon_logs.record(rig, rng, tensioner=20.0, **short)


@pytest.fixture
def folder(recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:  # type: ignore[no-untyped-def]
    monkeypatch.chdir(tmp_path)
    text, low, high = recorded
    (tmp_path / "a.toml").write_text(text)
    write_csv(tmp_path / "low.csv", low)
    write_csv(tmp_path / "high.csv", high)
    return tmp_path


def test_the_angles_of_other_joints_are_not_reported_as_unused(
    folder: Path, recorded: tuple[str, dict[str, np.ndarray], dict[str, np.ndarray]], capsys: pytest.CaptureFixture[str]
) -> None:
    """They are not used in a log that measures the wrap angle, because the file has no routing."""
    low = {**recorded[1], "q_j.hip": 0.3 * np.sin(recorded[1]["t"])}
    low.pop("theta", None)
    bent = load_tendon_sheath(folder / "a.toml").bending_angle
    for columns, unused in ((low, False), ({**low, "theta": np.full(low["t"].size, bent)}, True)):
        write_csv(folder / "two.csv", columns)
        assert tsa("two.csv", "--model", "a.toml") == 0
        assert ("q_j.hip" in capsys.readouterr().out.partition("not used by calibrate")[2].partition("\n")[0]) is unused


def test_json_has_exactly_the_public_keys(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert tsa("low.csv", "--model", "a.toml", "--json") == 0
    data = json.loads(capsys.readouterr().out)
    public = {
        "schema", "parameters", "combinations", "split", "condition_number", "admitted_seconds", "refused", "rms",
        "experiment",
    }  # fmt: skip
    assert set(data) == public | {"notes", "rms_in_sample", "worse_than_given", "errors"}
    assert data["schema"] == 1
    assert {name: value["unit"] for name, value in data["parameters"].items()} == {
        "friction_angle": "1",
        "pretension": "N",
    }
    assert {name: value["unit"] for name, value in data["combinations"].items()} == {
        "slope": "1",
        "half_loop_torque": "N*m",
    }
    for quantity in (*data["parameters"].values(), *data["combinations"].values()):
        assert quantity["low"] <= quantity["value"] <= quantity["high"]
    assert data["split"] is False
    assert data["condition_number"] is None
    assert data["rms"]["after"] < data["rms"]["before"]
    assert data["rms"]["held_out"] is True
    assert "tensioner" in data["experiment"]


def test_the_file_that_is_written_loads_again_and_says_where_it_came_from(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert tsa("low.csv", "high.csv", "--tensioner", "high.csv=+20", "--model", "a.toml", "--out", "new.toml") == 0
    text = (folder / "new.toml").read_text()
    new, old = load_tendon_sheath("new.toml"), load_tendon_sheath("a.toml")
    assert COMMENT in text
    assert new.friction_angle != old.friction_angle
    assert new.bending_angle == old.bending_angle
    source = tomllib.loads(text)["provenance"]
    assert source["logs"] == {name: sha256_of(folder / name) for name in ("low.csv", "high.csv")}
    assert source["nominal"] == "a.toml"
    assert source["split"] is True
    assert set(source) >= {"command", "date", "version"}
    low, high = source["intervals"]["friction_angle"]
    assert low <= new.friction_angle <= high
    low, high = source["intervals"]["pretension"]
    assert low <= new.pretension <= high
    derived = [line.split(":")[1] for line in capsys.readouterr().out.splitlines() if "is derived" in line]
    assert derived
    assert len(derived) == len(set(derived))  # a note on several logs is printed once


def test_text_says_what_is_not_parted_and_how_to_settle_it(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert tsa("low.csv", "--model", "a.toml") == 0
    out = capsys.readouterr().out
    assert "friction torque" in out
    assert "NOT separately identifiable" in out
    assert "to separate them" in out
    assert "held-out" in out
    assert "while sliding" in out


def of_another_drive(log: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the log with half the joint torque, like a drive with half the gain and half the friction."""
    return {**log, "tau_j": 0.5 * log["tau_j"]}


def test_the_error_told_is_that_of_the_file_written(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert tsa("low.csv", "--model", "a.toml", "--out", "new.toml", "--json") == 0
    calibrated = json.loads(capsys.readouterr().out)
    told = calibrated["rms_in_sample"]
    for file, value in (("a.toml", told["before"]), ("new.toml", told["after"])):
        with pytest.raises(SystemExit):
            main(["simulate", "low.csv", "--model", file, "--json"])
        simulated = json.loads(capsys.readouterr().out)["models"][0]
        assert simulated["rms"] == pytest.approx(value, rel=1e-6)
    assert simulated["errors"].pop("unit") == calibrated["errors"].pop("unit") == "N*m"
    assert simulated["errors"] == pytest.approx(calibrated["errors"], rel=1e-6)


def test_worse_than_given_is_told_and_not_written_unasked(
    folder: Path, recorded, capsys: pytest.CaptureFixture[str]
) -> None:  # type: ignore[no-untyped-def]
    """Two of three logs have a torque that contradicts (3.55). Their estimate makes the third log worse."""
    _, low, high = recorded
    for number, log in enumerate((low, of_another_drive(low), of_another_drive(high))):
        write_csv(folder / f"{number}.csv", log)
    logs = [f"{number}.csv" for number in range(3)]
    assert tsa(*logs, "--hold-out", "0.csv", "--model", "a.toml", "--out", "new.toml") == 2
    captured = capsys.readouterr()
    assert "LARGER than with the nominal model" in captured.out
    assert "new.toml: not written" in captured.err
    assert not (folder / "new.toml").exists()
    assert tsa(*logs, "--hold-out", "0.csv", "--model", "a.toml", "--out", "new.toml", "--yes") == 0
    assert (folder / "new.toml").exists()


def test_a_note_keeps_its_brackets(folder: Path, recorded, capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[no-untyped-def]
    write_csv(folder / "half.csv", of_another_drive(recorded[1]))
    assert tsa("half.csv", "--model", "a.toml") == 0
    assert "[uncertainty]" in capsys.readouterr().out


def test_a_calibrated_file_can_be_calibrated_again(folder: Path) -> None:
    assert tsa("low.csv", "--model", "a.toml", "--out", "a.toml") == 0
    once = load_tendon_sheath("a.toml")
    assert tsa("low.csv", "--model", "a.toml", "--out", "a.toml") == 0
    assert load_tendon_sheath("a.toml").friction_angle == pytest.approx(once.friction_angle, rel=1e-3)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("low.csv", "--model", "nowhere.toml"), "nowhere.toml: no such file"),
        (("low.csv", "--model", "drive.toml"), "tsa diagnose LOG --model drive.toml --out DIR"),
        (("low.csv", "--model", "slack.toml"), "must be above 0"),
        (("low.csv",), "Missing option '--model'"),
        (("low.csv", "low.csv", "--model", "a.toml"), "low.csv and low.csv are the same file"),
        (("low.csv", "--model", "a.toml", "--tensioner", "low.csv"), "write LOG=NEWTON"),
        (("low.csv", "--model", "a.toml", "--tensioner", "low.csv=1e300"), "at most 20000 N"),
        (("low.csv", "--model", "a.toml", "--tensioner", "other.csv=3"), "matches no log"),
        (("low.csv", "--model", "a.toml", "--hold-out", "low*"), "matches every log; leave at least one"),
        (("low.csv", "--model", "a.toml", "--out", "no/such/folder.toml"), "cannot be written"),
        (("no_tau_j.csv", "--model", "a.toml"), "column tau_j is missing"),
        (("reversed.csv", "--model", "a.toml"), "is reversed"),
        (("one_way.csv", "--model", "a.toml"), "backward motion"),
        (("flat.csv", "--model", "a.toml"), "does not change at all"),
    ],
)
def test_a_mistake_is_one_line_code_2_and_nothing_on_stdout(
    folder: Path, recorded, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str
) -> None:  # type: ignore[no-untyped-def]
    log = recorded[1]
    (folder / "drive.toml").write_text('[actuator]\nkind = "rigid_drive"\n')
    (folder / "slack.toml").write_text((folder / "a.toml").read_text().replace("\nvalue = ", "\nvalue = 0 #"))
    write_csv(folder / "no_tau_j.csv", {name: log[name] for name in ("t", "tau_m", "omega_j")})
    write_csv(folder / "reversed.csv", {**log, "tau_j": -log["tau_j"]})
    write_csv(folder / "one_way.csv", {**log, "omega_j": np.abs(log["omega_j"]) + 0.1})
    write_csv(folder / "flat.csv", {**log, "tau_m": 0.0 * log["tau_m"] + 0.1})
    assert tsa(*(arguments if "--out" in arguments else (*arguments, "--out", "new.toml")), "--json") == 2
    assert not (folder / "new.toml").exists()
    captured = capsys.readouterr()
    assert captured.out == ""
    assert said in captured.err
    assert captured.err.count("\n") == 1


def test_logs_of_one_name_in_several_folders_are_held_out_by_their_paths(
    folder: Path, recorded, capsys: pytest.CaptureFixture[str]
) -> None:  # type: ignore[no-untyped-def]
    _, low, high = recorded
    logs = {"a": low, "b": high, "c": {name: column[:3000] for name, column in low.items()}}
    for name, columns in logs.items():
        (folder / name).mkdir()
        write_csv(folder / name / "run.csv", columns)
    paths = [f"{name}/run.csv" for name in logs]
    assert tsa(*paths, "--model", "a.toml", "--out", "new.toml", "--json", "--yes") == 0
    assert json.loads(capsys.readouterr().out)["rms"]["after"] is not None
    assert sorted(tomllib.loads((folder / "new.toml").read_text())["provenance"]["logs"]) == paths
    assert tsa(*paths, "--model", "a.toml", "--hold-out", "none", "--json") == 2
    assert "the logs are a/run.csv, b/run.csv, c/run.csv" in capsys.readouterr().err


def test_two_logs_of_one_name_are_one_line_from_python(recorded) -> None:  # type: ignore[no-untyped-def]
    text, low, high = recorded
    logs = [Dataset.from_arrays(columns, "run") for columns in (low, high, low)]
    for command in (calibrate, diagnose):
        with pytest.raises(UsageError, match="two logs are named run; give each a different name"):
            command(logs, model_from(tomllib.loads(text), "a.toml"))


@pytest.mark.parametrize("name", ["tau_m", "tau_j"])
def test_samples_of_a_stuck_torque_do_not_move_the_fit(
    folder: Path, recorded: tuple[str, dict[str, np.ndarray], dict[str, np.ndarray]], name: str
) -> None:
    """The torque is saturated for a second. The samples are counted in the list of rejected ones."""
    columns = dict(recorded[1])
    columns[name] = columns[name].copy()
    clean = calibrate([Dataset.from_arrays(columns, "low")], load_tendon_sheath("a.toml"))
    columns[name][1200:1400] = 1.2 * np.abs(columns[name]).max()
    found = calibrate([Dataset.from_arrays(columns, "low")], load_tendon_sheath("a.toml"))
    assert any(reason.startswith(f"stuck {name} (") for reason in found.refused)
    assert found.admitted_seconds < clean.admitted_seconds
    half = 0.5 * (clean.half_loop_torque.high - clean.half_loop_torque.low)
    assert found.half_loop_torque.value == pytest.approx(clean.half_loop_torque.value, abs=1.5 * half)
