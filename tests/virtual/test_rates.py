"""Healthy rigs at every usual rate: a slow loop samples a motor that rings on its tendons too seldom to judge it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tsa_ctrl import simulate_loop
from tsa_ctrl.demo import rig
from tsa_ctrl.demo.motion import gait
from tsa_ctrl.demo.rig import BusChoice


@pytest.mark.parametrize("load", ["imposed", "held", "wearer"])
@pytest.mark.parametrize("rate", [100.0, 125.0, 200.0, 250.0, 400.0, 500.0])
def test_no_healthy_rig_latches(tmp_path: Path, rate: float, load: str) -> None:
    bus = BusChoice("virtual", "rates")
    plant = rig.plant(bus, "full")
    plant["axis"][0].setdefault("joint", {})["load"] = load
    rig.write(tmp_path, gait(), plant, {"with": rig.controller(bus, "with", rate, "nominal.toml", 0.95)})
    result = simulate_loop(tmp_path / "controller-with.toml", tmp_path / "plant.toml", 5.0)
    assert [event.text for event in result.summary.events if event.fault] == []
    assert not result.summary.failed
