"""Test `tsa log info` and `tsa log convert`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from tests.log.logs import HEADER, write_log
from tsa_ctrl.cli import main

MODEL = Path(__file__).resolve().parents[2] / "config/actuator.toml"


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    write_log(Path("run.mcap"))
    return "run.mcap"


def tsa(*arguments: str) -> int:
    with pytest.raises(SystemExit) as done:
        main(list(arguments))
    assert isinstance(done.value.code, int)
    return done.value.code


def test_info_prints_the_keys_that_programs_rely_on(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert tsa("log", "info", log, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["schema"] == 1
    assert found["rate"] == pytest.approx(1000.0)
    assert found["seconds"] == pytest.approx(0.399)
    assert found["columns"] == ["t", "tau_m", "omega_j", "cycle", "state"]
    assert found["axes"] == ["hip", "knee"]
    assert found["jitter_percent"] == pytest.approx(0.0, abs=1e-6)
    assert found["problems"] == []


def test_a_log_of_virtual_time_has_no_date(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    write_log(Path("virtual.mcap"), header=replace(HEADER, started=0.0))
    assert tsa("log", "info", "virtual.mcap") == 0
    out = capsys.readouterr().out
    assert "simulated in virtual time by tsa-ctrl" in out
    assert "1970" not in out


def test_info_and_convert_for_people(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The information contains axes, columns and units, and a log that was cut off. A table has no axes."""
    assert tsa("log", "info", log) == 0
    out = capsys.readouterr().out
    for words in ("axis knee: 400 rows, 0.399 s at 1000 Hz", "rad/s", "operation_enabled"):
        assert words in out
    assert "recorded 2023-11-14T22:13:20Z by tsa-ctrl" in out
    Path("cut.mcap").write_bytes(Path(log).read_bytes()[:-300])
    assert tsa("log", "info", "cut.mcap") == 0
    assert "cut off" in capsys.readouterr().out
    Path("x.csv").write_text("t,tau_m,mark\n" + "".join(f"{i / 100},{i},on\n" for i in range(20)))
    assert tsa("log", "info", "x.csv", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["axes"], found["columns"]) == ([], ["t", "tau_m", "mark"])
    assert tsa("log", "convert", log, "--out", "out.csv") == 0
    assert capsys.readouterr().out.split() == ["out_hip.csv", "out_knee.csv"]


MISTAKES = [
    (("info", "nope.csv"), "nope.csv: no such file"),
    (("info", "."), "is a folder"),
    (
        ("info", "x.xlsx"),
        "unknown kind of log '.xlsx'; allowed are .csv, .csv.gz, .parquet, .mcap; tsa log import reads",
    ),
    (("convert", "units.csv", "--out", "y.csv"), "units.csv: no column has only numbers; tsa log import reads"),
    (("info", "empty.csv"), "is empty"),
    (("info", "notime.csv"), "column t is missing (found: tau_m); add it, or run tsa log import"),
    (("info", "back.csv"), "column t, row 3 (line 4): time 0.5 s does not increase"),
    (("info", "still.csv"), "column t: all 3 times are 5 s"),
    (("trend", "still", "--model", str(MODEL)), "column t: all 3 times are 5 s"),
    (("info", "run.mcap:elbow"), "has no axis 'elbow'"),
    (("info", "bad.parquet"), "is not a readable Parquet file"),
    (("convert", "run.mcap", "--out", "x.txt"), "unknown kind of file"),
    (("convert", "run.mcap"), "Missing option '--out'"),
]


def test_a_mistake_is_one_line_and_code_2(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path("x.xlsx").write_text("x")
    Path("empty.csv").touch()
    Path("units.csv").write_text("time;torque\n0 s;1 Nm\n1 s;1 Nm\n")
    Path("notime.csv").write_text("tau_m\n1\n2\n")
    Path("back.csv").write_text("t,tau_m\n0,1\n1,1\n0.5,1\n")
    Path("still").mkdir()
    for path in (Path("still.csv"), Path("still/x.csv")):
        path.write_text("t,tau_m\n5,1\n5,1\n5,1\n")
    Path("bad.parquet").write_text("x")
    for arguments, said in MISTAKES:
        assert tsa("log", *arguments) == 2
        output = capsys.readouterr()
        assert output.out == ""
        assert said in output.err
        assert output.err.count("\n") == 1
