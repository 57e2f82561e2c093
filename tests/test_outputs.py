"""Output files of commands.

Commands never overwrite their input files, they keep a backup of a replaced file, and they reject a folder in which
another command is writing.
"""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.table import Table

from tsa_ctrl import outputs
from tsa_ctrl.cli import main
from tsa_ctrl.errors import UsageError
from tsa_ctrl.outputs import terminal


def row(i: int) -> str:
    way, load = (1.0, -1.0)[i % 200 >= 100], math.sin(0.013 * i)
    return f"{i / 100:.2f},{0.5 * load + 0.3 * way:.6f},{0.4 * load:.6f},{way}\n"


LOG = "t,tau_m,tau_j,omega_j\n" + "".join(row(i) for i in range(4000))
MODEL = """[actuator]
motor_pulley_radius = 0.02
joint_pulley_radius = 0.025
[tendon]
axial_stiffness = 60e3
unstrained_length = 1.2
diameter = 0.6e-3
[sheath]
friction_coefficient = 0.1
bending_angle = 2.6
contact_offset = 0.4e-3
[pretension]
value = 45.0
"""


@pytest.fixture
def files(tmp_path: Path) -> Path:
    (tmp_path / "keep.csv").write_text(LOG)
    (tmp_path / "a.toml").write_text(MODEL)
    return tmp_path


@pytest.mark.parametrize(
    "line",
    [
        "calibrate keep.csv --model a.toml --out keep.csv",
        "calibrate keep.csv --model a.toml --out link.csv",
        "simulate keep.csv --model a.toml --out keep.csv",
        "simulate keep.csv --model a.toml --picture keep.csv",
        "simulate keep.csv --model a.toml --out a.toml",
        "log convert keep.csv --out keep.csv",
    ],
)
def test_no_verb_writes_over_what_it_reads(
    line: str, files: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(files)
    (files / "link.csv").symlink_to("keep.csv")
    with pytest.raises(SystemExit) as ended:
        main(line.split())
    said = capsys.readouterr()
    assert (ended.value.code, said.out, said.err.count("\n")) == (2, "", 1)
    assert "which is read" in said.err
    assert ((files / "keep.csv").read_text(), (files / "a.toml").read_text()) == (LOG, MODEL)


@pytest.mark.parametrize(
    "line",
    ["calibrate keep.csv --model a.toml --out old.toml", "simulate keep.csv --model a.toml --out old.toml"],
)
def test_what_is_replaced_is_kept_beside_and_said(
    line: str, files: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(files)
    (files / "old.toml").write_text("precious")
    with pytest.raises(SystemExit) as ended:
        main(line.split())
    assert ended.value.code == 0
    assert (files / "old.toml.~1~").read_text() == "precious"
    assert "the file before is old.toml.~1~" in capsys.readouterr().out


def test_each_replaced_file_gets_a_number_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    for text in ("first", "second"):
        path.write_text(text)
        outputs.keep(path)
    assert [kept.read_text() for kept in outputs.backups(path).values()] == ["first", "second"]


def test_a_file_that_cannot_be_kept_is_said_and_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.toml"
    path.write_text("here")
    monkeypatch.setattr("shutil.copy2", lambda *_: (_ for _ in ()).throw(PermissionError(13, "Permission denied")))
    with pytest.raises(UsageError, match="cannot be kept"):
        outputs.keep(path)


def test_a_second_writer_of_a_folder_is_told_so(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    first = outputs.sole_writer(folder)
    with first, pytest.raises(UsageError, match="another command is writing there"), outputs.sole_writer(folder):
        pass
    with outputs.sole_writer(folder):
        pass
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("fault", [OSError(28, "No space left on device"), ValueError("no such format")])
def test_a_picture_that_cannot_be_written_leaves_the_old_file(tmp_path: Path, fault: Exception) -> None:
    def savefig(part: Path, **_: object) -> None:
        part.write_text("half")
        raise fault

    path = tmp_path / "trend.png"
    path.write_text("precious")
    with pytest.raises(UsageError, match=r"trend\.png: "):
        outputs.save_picture(SimpleNamespace(savefig=savefig), path, 100)
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("trend.png", "precious")]


def test_the_terminal_shows_text_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    """The title and the cells of a table are also shown without markup and emoji codes."""
    text = "datagram:b: [axis.law] [bus]"
    table = Table(text, title=text)
    table.add_row(text)
    for shown in (text, table):
        terminal().print(shown)
    assert capsys.readouterr().out.count(text) == 4


def test_a_narrow_terminal_cuts_no_cell(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "30")
    path = "/rig/logs/tsa-20261128-183544.mcap"
    table = Table("file", "records")
    table.add_row(path, "2781")
    terminal().print(table)
    lines = [line.split("│") for line in capsys.readouterr().out.splitlines() if "│" in line]
    assert "".join(line[1].strip() for line in lines) == path


def test_every_console_is_that_terminal() -> None:
    package = Path(outputs.__file__).parent
    found = {path.name for path in package.rglob("*.py") if "import Console" in path.read_text(encoding="utf-8")}
    assert found == {"outputs.py", "summary.py"}  # the latter imports a type
