"""The files of a tuning: diff, backups and undo."""

from __future__ import annotations

import os
import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tsa_ctrl import settings
from tsa_ctrl.errors import UsageError
from tsa_ctrl.tune.session import backups, diff, last, replace, undo

MODEL, CONTROLLER = "a = 1\nb = 2\n", "rate = 1000\n"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "actuator.toml"
    path.write_text(MODEL)
    return path


@pytest.fixture
def controller(tmp_path: Path) -> Path:
    path = tmp_path / "controller.toml"
    path.write_text(CONTROLLER)
    return path


def test_a_diff_shows_what_changes(file: Path) -> None:
    assert "-b = 2\n+b = 3\n" in diff(file, "a = 1\nb = 3\n")
    assert diff(file, file.read_text()) == ""


def test_undo_goes_back_one_step_at_a_time(file: Path) -> None:
    for number in range(2, 12):
        kept = replace({file: f"a = {number}\n"})[file]
        assert kept.name == f"actuator.toml.~{number - 1}~"
    assert [other.name for other in backups(file).values()][-2:] == ["actuator.toml.~9~", "actuator.toml.~10~"]
    assert last(file)[file].name == "actuator.toml.~10~"
    undo(last(file))
    assert file.read_text() == "a = 10\n"
    with ThreadPoolExecutor(1) as pool:  # Python sets and runs signal handlers only in the main thread
        assert pool.submit(replace, {file: "a = 2\n"}).result()[file].read_text() == "a = 10\n"
        pool.submit(undo, last(file)).result()
    for _ in range(9):
        undo(last(file))
    assert file.read_text() == MODEL
    assert backups(file) == {}
    with pytest.raises(UsageError, match="nothing to undo"):
        last(file)


def test_files_that_were_replaced_together_go_back_together(file: Path, controller: Path) -> None:
    replace({file: "a = 2\n", controller: "rate = 500\n"})
    replace({file: "a = 3\n"}, beside=(controller,))
    assert set(last(file, controller)) == {file}
    undo(last(file, controller))
    assert controller.read_text() == "rate = 500\n"
    undo(last(file, controller))
    assert (file.read_text(), controller.read_text()) == (MODEL, CONTROLLER)
    assert backups(controller) == {}


def test_another_models_tuning_does_not_take_the_controller_back(tmp_path: Path, file: Path, controller: Path) -> None:
    other = tmp_path / "other.toml"
    other.write_text("c = 1\n")
    replace({file: "a = 2\n", controller: "rate = 500\n"})
    replace({other: "c = 2\n"}, beside=(controller,))
    assert set(last(other, controller)) == {other}
    replace({other: "c = 3\n", controller: "rate = 250\n"})
    with pytest.raises(UsageError, match="was replaced again later"):
        last(file, controller)


def test_ctrl_c_waits_until_both_files_are_written(
    file: Path, controller: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = settings.write_text

    def interrupted(path: Path, text: str) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        write(path, text)

    monkeypatch.setattr(settings, "write_text", interrupted)
    with pytest.raises(KeyboardInterrupt):
        replace({file: "a = 2\n", controller: "rate = 500\n"})
    assert (file.read_text(), controller.read_text()) == ("a = 2\n", "rate = 500\n")
    with pytest.raises(KeyboardInterrupt):
        undo(last(file, controller))
    assert (file.read_text(), controller.read_text()) == (MODEL, CONTROLLER)


@pytest.mark.parametrize("broken", ["actuator.toml", "controller.toml", "controller.toml.~1~"])
def test_a_file_that_cannot_be_written_leaves_no_trace(
    file: Path, controller: Path, broken: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = settings.write_text

    def fail(path: Path, text: str) -> None:
        if path.name == broken:
            raise UsageError("disk full")
        write(path, text)

    monkeypatch.setattr(settings, "write_text", fail)
    with pytest.raises(UsageError, match="disk full"):
        replace({file: "a = 2\n", controller: "rate = 500\n"})
    assert (file.read_text(), controller.read_text()) == (MODEL, CONTROLLER)
    assert backups(file) == backups(controller) == {}
