"""Repeat a virtual run from one field report to the last bit. A damaged report causes one line."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from tsa_ctrl import simulate_loop
from tsa_ctrl.cli import cli
from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.mcap_file import McapFile
from tsa_ctrl.log.process import LogHeader
from tsa_ctrl.log.reader import LogFile
from tsa_ctrl.settings import MOST_TEXT, referenced
from tsa_ctrl.virtual.script import Replay, first_difference


def tsa(*words: str | Path) -> Result:
    return CliRunner().invoke(cli, [str(word) for word in words])


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run with a fault and a change, and of its report. The input files are deleted."""
    folder = tmp_path_factory.mktemp("bundle")
    assert tsa("init", "--desk", folder / "desk").exit_code == 0
    (folder / "models").mkdir()
    (folder / "desk/actuator.toml").rename(folder / "models/actuator.toml")  # outside the controller's folder
    for name in ("controller.toml", "plant.toml"):
        path = folder / "desk" / name
        text = path.read_text(encoding="utf-8").replace('"actuator.toml"', '"../models/actuator.toml"')
        path.write_text(text, encoding="utf-8")
    arguments = ("--seconds", "3", "--seed", "5", "--fault", "torn_tendon@2", "--set", "compensation=0.5@1")
    files = (folder / "desk/controller.toml", folder / "desk/plant.toml")
    assert tsa("simulate-loop", *files, *arguments, "--out", folder / "run").exit_code == 0
    result = tsa("bundle", folder / "run/tsa.mcap", "--out", folder / "report.zip", "--minutes", "0.02", "--no-doctor")
    assert result.exit_code == 0, result.output
    assert "the last 1.2 s" in result.output
    for name in ("desk/controller.toml", "desk/plant.toml", "models/actuator.toml"):
        (folder / name).unlink()
    return folder


def test_a_report_holds_what_a_reader_needs(desk: Path) -> None:
    with zipfile.ZipFile(desk / "report.zip") as report:
        names = set(report.namelist())
        assert {"README.txt", "log.mcap", "summary.json", "files/controller.toml", "files/plant.toml"} <= names
        assert {"files/above/models/actuator.toml", "files/drives/generic.toml"} <= names
        assert json.loads(report.read("summary.json"))["cause"] == "3 s are over"
        assert json.loads(report.read("files/run.json"))["faults"] == ["torn_tendon@2.0"]


@pytest.mark.parametrize("name", ["report.zip", "run/tsa.mcap"])
def test_a_run_is_repeated_to_the_last_bit_without_its_files(desk: Path, name: str) -> None:
    result = tsa("simulate-loop", desk / name, "--json")
    assert result.exit_code == 0, result.output
    assert "every record is identical to the log, bit by bit" in result.stderr
    assert json.loads(result.stdout)["seconds"] == 3.0


def test_other_arguments_are_not_compared_and_a_difference_is_named(desk: Path, tmp_path: Path) -> None:
    assert "not compared" in tsa("simulate-loop", desk / "report.zip", "--seed", "6").stderr
    log = desk / "run/tsa.mcap"
    (tmp_path / "files").mkdir()
    replay = Replay(log, tmp_path / "files")
    assert replay.plant is not None
    run = simulate_loop(replay.controller, replay.plant, 3.0, seed=5)
    assert "t = " in first_difference(log, {"knee": run.log})  # repeated without the change and the fault
    columns = {name: values.copy() for name, values in LogFile(log).columns("knee", LogFile(log).fields).items()}
    assert first_difference(log, {"knee": columns}) == ""
    columns["tau_m"][700] = np.nextafter(columns["tau_m"][700], np.inf)
    assert first_difference(log, {"knee": columns}).startswith(f"axis 'knee', tau_m at t = {columns['t'][700]:.6g} s")
    assert first_difference(log, {"hip": columns}) == "axis 'knee' is missing"


def test_a_report_of_hardware_runs_on_a_plant_that_is_given(desk: Path, tmp_path: Path) -> None:
    """Its log has no arguments, like the log of a daemon."""
    file = LogFile(desk / "run/tsa.mcap")
    files = {name: text for name, text in file.files.items() if name != "run.json"}
    target = McapFile(tmp_path / "hardware.mcap", LogHeader(tuple(file.axes), file.about["rate"], files, file.codes))
    for _, block in file.blocks(file.fields):
        target.write([block])
    target.finish()
    with pytest.raises(UsageError, match="run on hardware; give a"):
        raise tsa("simulate-loop", tmp_path / "hardware.mcap").exception or AssertionError
    assert tsa("init", "--desk", tmp_path / "desk").exit_code == 0
    result = tsa("simulate-loop", tmp_path / "hardware.mcap", tmp_path / "desk/plant.toml", "--seconds", "1")
    assert result.exit_code == 0, result.output


@pytest.mark.parametrize("name", ["a/../../escape.toml", "../../../escape.toml", "ABSOLUTE/escape.toml"])
def test_no_head_writes_a_file_outside_of_the_folder(tmp_path: Path, name: str) -> None:
    """A relative path that leaves the folder is placed in a deeper folder. An absolute path is rejected."""
    folder = tmp_path / "place"
    folder.mkdir()
    log = tmp_path / "log.mcap"
    files = {"controller.toml": "", name.replace("ABSOLUTE", str(tmp_path)): "x = 1"}
    McapFile(log, LogHeader(("knee",), 1000.0, files)).finish()
    if name.startswith("ABSOLUTE"):
        with pytest.raises(UsageError, match="outside of its folder"):
            Replay(log, folder)
    else:
        Replay(log, folder)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.mcap", "place"]


ELSEWHERE = '{"controller":"/etc/passwd","plant":"p","seconds":1,"seed":null,"faults":[],"changes":[]}'


def test_damaged_arguments_of_a_run_are_one_line(tmp_path: Path) -> None:
    log, folder = tmp_path / "log.mcap", tmp_path / "place"
    folder.mkdir()
    for run in ("", "[]", "{}", '{"controller": 1}', ELSEWHERE):
        McapFile(log, LogHeader(("knee",), 1000.0, {"controller.toml": "", "run.json": run})).finish()
        with pytest.raises(UsageError, match=r"run\.json in its head"):
            Replay(log, folder)
        log.unlink()


def test_what_is_no_report_is_one_line(tmp_path: Path) -> None:
    """Every third byte of a small report is changed in turn; the flags of its entry then also mean encryption."""
    path = tmp_path / "x.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as report:
        report.writestr("log.mcap", b"records" * 3)
    content = path.read_bytes()
    changed = [content[:n] + bytes((content[n] ^ 0xFF,)) + content[n + 1 :] for n in range(0, len(content), 3)]
    for damaged in (b"", b"PK\x05\x06" + bytes(18), *changed):
        path.write_bytes(damaged)
        error = tsa("simulate-loop", path).exception
        assert isinstance(error, UsageError), damaged
        assert "\n" not in str(error)
        assert "not a field report" in str(error) or damaged in changed
    assert isinstance(tsa("simulate-loop", tmp_path / "none.zip").exception, UsageError)
    assert isinstance(tsa("bundle", tmp_path / "none.mcap", "--out", tmp_path / "o.zip").exception, UsageError)
    assert "is a folder; give" in str(tsa("bundle", tmp_path, "--out", tmp_path / "o.zip").exception)


def test_the_files_of_a_configuration_are_those_that_it_names(tmp_path: Path) -> None:
    (tmp_path / "drives").mkdir()
    (tmp_path / "a.toml").write_text(
        'x = "b.csv"\n[t]\nprofile = "p"\nwords = ["no file", "long.csv", "raw.bin", ""]\n'
    )
    (tmp_path / "b.csv").write_text("t\n0\n")
    (tmp_path / "drives/p.toml").write_text('again = "../a.toml"\n')
    (tmp_path / "long.csv").write_text("0\n" * MOST_TEXT)
    (tmp_path / "raw.bin").write_bytes(b"\xff\xfe")
    assert sorted(referenced(tmp_path / "a.toml")) == ["a.toml", "b.csv", "drives/p.toml"]


def test_two_dumps_of_one_name_are_rejected(tmp_path: Path) -> None:
    paths = [tmp_path / "log.mcap", tmp_path / "a" / "knee.toml", tmp_path / "b" / "knee.toml"]
    for path in paths:
        path.parent.mkdir(exist_ok=True)
        path.touch()
    run = tsa("bundle", paths[0], "--out", tmp_path / "o.zip", "--drive", paths[1], "--drive", paths[2])
    assert isinstance(run.exception, UsageError)
    assert "have the same name in the report" in str(run.exception)
