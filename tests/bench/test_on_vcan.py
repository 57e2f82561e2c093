"""Test `tsa bench` on a vcan: with substitute nodes, and with a plant."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.daemon.test_vcan import Rig

pytestmark = [pytest.mark.vcan, pytest.mark.hil, pytest.mark.slow]


@pytest.fixture
def rig(tmp_path: Path, vcan: str) -> Iterator[Rig]:
    made = Rig(tmp_path, vcan)
    yield made
    made.end()


def bench(rig: Rig) -> tuple[int, dict[str, Any], str]:
    command = ["tsa", "bench", "controller.toml", "--seconds", "0.4", "--json"]
    run = subprocess.run(command, cwd=rig.folder, capture_output=True, text=True, check=False)
    return run.returncode, json.loads(run.stdout or "{}"), run.stderr


def test_without_nodes_others_stand_in_and_the_rate_is_run(rig: Rig) -> None:
    """Simulated nodes answer, and the reported rate was run without lost or late answers."""
    code, found, err = bench(rig)
    assert code == 0, err
    assert found["nodes"] == "simulated"
    assert found["measured"][0]["enabled"] > 0
    if found["rate"]["highest"]:
        last = found["measured"][-1]
        assert (last["rate"], last["lost"], last["late"]) == (pytest.approx(found["rate"]["highest"]), 0, 0)


def test_real_nodes_are_measured_and_never_enabled(rig: Rig) -> None:
    """The nodes of the plant answer, and their drive is never enabled."""
    rig.plant()
    code, found, err = bench(rig)
    assert code == 0, err
    assert (found["nodes"], len(found["measured"]), found["measured"][0]["enabled"]) == ("real", 1, 0)
