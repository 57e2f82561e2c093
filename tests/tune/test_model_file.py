"""The model file: diff, the kept files, and back again."""

from __future__ import annotations

from pathlib import Path

import pytest

from tsa_ctrl import settings
from tsa_ctrl.errors import UsageError
from tsa_ctrl.tune.model_file import backups, diff, replace, undo


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "actuator.toml"
    path.write_text("a = 1\nb = 2\n")
    return path


def test_a_diff_shows_what_changes(file: Path) -> None:
    assert "-b = 2\n+b = 3\n" in diff(file, "a = 1\nb = 3\n")
    assert diff(file, file.read_text()) == ""


def test_replacing_keeps_the_file_before(file: Path) -> None:
    kept = replace(file, "a = 2\n")
    assert kept.name == "actuator.toml.~1~"
    assert kept.read_text() == "a = 1\nb = 2\n"
    assert file.read_text() == "a = 2\n"


def test_undo_goes_back_one_step_at_a_time(file: Path) -> None:
    for number in range(2, 12):
        replace(file, f"a = {number}\n")
    assert [other.name for other in backups(file)][-2:] == ["actuator.toml.~9~", "actuator.toml.~10~"]
    assert undo(file).name == "actuator.toml.~10~"
    assert file.read_text() == "a = 10\n"
    for _ in range(9):
        undo(file)
    assert file.read_text() == "a = 1\nb = 2\n"
    assert backups(file) == []


def test_nothing_to_undo_is_one_line(file: Path) -> None:
    with pytest.raises(UsageError, match="nothing to undo"):
        undo(file)


def test_a_file_that_cannot_be_written_leaves_no_trace(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = settings.write_text

    def fail(path: Path, text: str) -> None:
        if path == file:
            raise UsageError("disk full")
        write(path, text)

    monkeypatch.setattr(settings, "write_text", fail)
    with pytest.raises(UsageError, match="disk full"):
        replace(file, "a = 2\n")
    assert file.read_text() == "a = 1\nb = 2\n"
    assert backups(file) == []
