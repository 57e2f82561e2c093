"""Test that the daemon and the commands for a running daemon import no unused libraries."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.virtual.files import controller, plant, write
from tsa_ctrl.cli import main

HEAVY = {"matplotlib", "duckdb", "jinja2", "scipy.linalg", "scipy.optimize", "scipy.signal", "pandas", "polars"}
CONFIG = Path(__file__).resolve().parents[2] / "config"
TSA = [sys.executable, "-X", "importtime", "-m", "tsa_ctrl"]


def imported(stderr: str) -> set[str]:
    return {line.rpartition("|")[2].strip() for line in stderr.splitlines() if line.startswith("import time:")}


@pytest.mark.hil
@pytest.mark.slow
def test_a_daemon_that_plays_a_file_loads_none_of_them(tmp_path: Path) -> None:
    """A daemon that plays a set-point file imports no large library, because all of its memory is locked."""
    bus = {"interface": "datagram", "channel": f"imports-{os.getpid()}"}
    (tmp_path / "motion.csv").write_text("t,tau_j_des\n0,0\n1,0.3\n2,0\n")
    common = {"bus": bus, "realtime": {"allow_without": True}, "socket": {"path": str(tmp_path / "tsa.sock")}}
    tables = controller(file={"controller": {"rate": 250.0}, **common}, setpoint={"kind": "file", "file": "motion.csv"})
    for name in ("amplitude", "frequency"):
        del tables["axis"][0]["setpoint"][name]
    files = write(tmp_path, tables, plant(joint={"load": "held"}) | {"bus": bus})
    with subprocess.Popen([sys.executable, "-m", "tsa_ctrl", "plant", str(files[1])], stdout=subprocess.PIPE) as nodes:
        try:
            assert nodes.stdout is not None
            assert any(line.startswith(b"plant: ready") for line in nodes.stdout)
            run = [*TSA, "run", str(files[0]), "--seconds", "1"]
            done = subprocess.run(run, capture_output=True, text=True, timeout=120.0)
        finally:
            nodes.terminate()
    assert done.returncode == 0, done.stderr[-2000:]
    assert "tsa_ctrl.daemon.loop" in imported(done.stderr)
    assert not imported(done.stderr) & HEAVY


def test_a_check_from_python_leaves_the_diagnosis_usable() -> None:
    with pytest.raises(SystemExit) as done:
        main(["run", str(CONFIG / "controller.toml"), "--check"])
    assert done.value.code == 0
    assert importlib.import_module("scipy.linalg").expm is not None
