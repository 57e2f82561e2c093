"""The distribution is complete and acceptable for an index, and the licences of all dependencies are known."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tools.package import check, licences
from tsa_ctrl.cli.help import TOPICS

pytestmark = pytest.mark.skipif(not (ROOT / ".git").exists(), reason="not a checkout: git names the files")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    archive, wheel = check.build(tmp_path_factory.mktemp("dist"))
    assert check.twine([archive, wheel]).count("PASSED") == 2
    return wheel


@pytest.mark.slow
def test_the_wheel_alone_has_pages_files_and_profiles(wheel: Path, tmp_path: Path) -> None:
    """The unpacked wheel has the page of every topic and the example files."""
    zipfile.ZipFile(wheel).extractall(tmp_path / "site")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "site")}

    def tsa(*words: str) -> str:
        line = [sys.executable, "-c", "from tsa_ctrl.cli import main; main()", *words]
        return subprocess.run(line, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True).stdout

    where = [sys.executable, "-c", "import tsa_ctrl; print(tsa_ctrl.__file__)"]
    assert str(tmp_path) in subprocess.run(where, cwd=tmp_path, env=environment, capture_output=True, text=True).stdout
    every = "from click.testing import CliRunner; from tsa_ctrl.cli import cli\n"
    every += f"for topic in {list(TOPICS)}: print(CliRunner().invoke(cli, ['help', topic]).output[:2])"
    told = subprocess.run(
        [sys.executable, "-c", every], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert told.stdout == "# \n" * len(TOPICS)
    tsa("init", "--desk", "rig")  # a rig is rejected until its empty values are filled in
    assert sorted(path.name for path in (tmp_path / "rig" / "drives").iterdir()) == sorted(
        path.name for path in (ROOT / "config" / "drives").iterdir()
    )
    tsa("run", "--check", "rig/controller.toml")


def test_the_default_wheel_fits_every_machine(wheel: Path) -> None:
    """Without TSA_COMPILE the package is pure Python. It is built from the source archive, which has the backend."""
    assert wheel.name.endswith("-py3-none-any.whl")


def test_every_direct_dependency_stands_in_the_list_with_a_licence_that_fits() -> None:
    listed = json.loads(licences.FILE.read_text(encoding="utf-8"))
    assert {name for name, row in listed.items() if row["direct"]} == set(licences.runtime())
    assert {"foxglove-sdk", "gpiod", "mujoco-core"} <= listed.keys()  # of the extras live, gpio and limb
    assert [name for name, row in listed.items() if not licences.COMPATIBLE.search(row["licence"])] == []


def test_the_licence_is_apache_and_travels_with_the_wheel(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (about,) = (archive.read(name).decode() for name in names if name.endswith(".dist-info/METADATA"))
        (text,) = (archive.read(name) for name in names if name.endswith("/licenses/LICENSE"))
    assert "License-Expression: Apache-2.0" in about
    assert "The tsa_ctrl authors" in about
    assert text == (ROOT / "LICENSE").read_bytes()


def test_no_hint_installs_a_name_of_an_index() -> None:
    """In an index, this project's name is unused or belongs to another project."""
    line = ["git", "grep", "-nE", r"pip3? install [^`|]*tsa[-_]ctrl", "--", ":!tests/tools/test_package.py"]
    assert subprocess.run(line, cwd=ROOT, capture_output=True, text=True).stdout == ""
