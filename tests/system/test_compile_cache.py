"""Compiled functions are stored where the user can write. A machine without such a folder still works."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from tsa_ctrl.system import compile_cache


@pytest.fixture(autouse=True)
def _unset(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(compile_cache.VARIABLE, "")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)


def chosen() -> Path:
    compile_cache.choose()
    return Path(os.environ[compile_cache.VARIABLE])


def test_the_users_cache_is_taken_unless_the_user_has_set_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert chosen() == tmp_path / ".cache/tsa-ctrl/numba"
    monkeypatch.setenv(compile_cache.VARIABLE, str(tmp_path / "mine"))
    assert chosen() == tmp_path / "mine"


def test_without_a_writable_home_a_temporary_folder_is_taken_and_said_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "home").write_text("a file where a folder should be")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    first = chosen()
    assert stat.S_IMODE(first.stat().st_mode) == 0o700
    assert capsys.readouterr().err.count("\n") == 1
    monkeypatch.setenv(compile_cache.VARIABLE, "")
    assert (chosen(), capsys.readouterr().err) == (first, "")


def test_a_temporary_folder_that_others_can_write_is_not_believed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "home").write_text("")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    trap = tmp_path / f"tsa-ctrl-numba-{os.getuid()}"
    trap.mkdir()
    trap.chmod(0o777)
    assert chosen() != trap
