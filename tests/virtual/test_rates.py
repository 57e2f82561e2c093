"""Healthy rigs cause no fault at any usual rate, although a slow loop undersamples a motor that oscillates."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import tomlkit

from tests.conftest import ROOT
from tests.virtual import joints
from tests.virtual.files import Tables
from tsa_ctrl import simulate_loop
from tsa_ctrl.demo import rig
from tsa_ctrl.demo.rig import BusChoice, gait
from tsa_ctrl.virtual.result import Simulation


@pytest.mark.parametrize(
    ("rate", "load"),
    [
        (100.0, "imposed"),
        (100.0, "wearer"),
        (125.0, "held"),
        (200.0, "imposed"),
        (250.0, "wearer"),
        (400.0, "held"),
        (500.0, "imposed"),
        (500.0, "wearer"),
    ],
)
def test_no_healthy_rig_latches(tmp_path: Path, rate: float, load: str) -> None:
    bus = BusChoice("virtual", "rates")
    plant = rig.plant(bus, "full")
    plant["axis"][0].setdefault("joint", {})["load"] = load
    rig.write(tmp_path, gait(), plant, {"with": rig.controller(bus, "with", rate, "nominal.toml", 0.95)})
    result = simulate_loop(tmp_path / "controller-with.toml", tmp_path / "plant.toml", 5.0)
    assert [event.text for event in result.summary.events if event.fault] == []
    assert not result.summary.failed


@pytest.mark.parametrize(("rate", "inertia"), [(400.0, 1e-5), (500.0, 5e-6)])
def test_a_light_motor_that_oscillates_between_two_samples_does_not_contradict_its_velocity(
    tmp_path: Path, rate: float, inertia: float
) -> None:
    """The motor has gear friction, so it stops at other velocities than it has on average."""
    friction = {"effects": {"motor_side_friction": {"coulomb": 0.03}}}
    result = at_rate(tmp_path, "weight", rate, inertia, friction, 2.0)
    assert [event.text for event in result.summary.events if event.fault] == []


def at_rate(folder: Path, load: str, rate: float, inertia: float, plant: Tables, seconds: float) -> Simulation:
    """Run the actuator of `joints` at another rate (Hz), with a motor of `inertia` (kg*m^2)."""
    law = {"delay": 1.5 / rate + joints.LAG}
    paths = joints.files(folder, load, joints.sine(0.5, 0.5), inertia=inertia, axis={"law": law}, plant=plant)
    tables = tomlkit.parse(paths[0].read_text(encoding="utf-8")).unwrap()
    tables["controller"]["rate"] = rate
    paths[0].write_text(tomlkit.dumps(tables), encoding="utf-8")
    return simulate_loop(*paths, seconds)


def test_the_shipped_example_rests_at_every_rate(tmp_path: Path) -> None:
    """The set-point is 0 on the example's moving joint, so only the friction is compensated."""
    for path in (ROOT / "config").glob("*.toml"):
        (tmp_path / path.name).write_text(path.read_text(encoding="utf-8"), encoding="utf-8")
    text = (tmp_path / "controller.toml").read_text(encoding="utf-8")
    text = re.sub(r"^amplitude = 0.5 ", "amplitude = 0.0 ", text, count=1, flags=re.MULTILINE)
    for rate in (100, 125, 250, 1000):
        changed = re.sub(r"^rate = \d+", f"rate = {rate}", text, count=1, flags=re.MULTILINE)
        (tmp_path / "controller.toml").write_text(changed, encoding="utf-8")
        result = simulate_loop(tmp_path / "controller.toml", tmp_path / "plant.toml", 4.0)
        assert [event.text for event in result.summary.events if event.fault] == []


@pytest.mark.parametrize("rate", [250.0, 500.0, 1000.0])
@pytest.mark.parametrize("truth", [{"axial_stiffness": 0.93}, {"friction_coefficient": 0.85, "axial_stiffness": 1.05}])
def test_tendons_within_the_uncertainty_of_the_file_are_not_reported(
    tmp_path: Path, rate: float, truth: dict[str, float]
) -> None:
    """Friction is 15 % off and stiffness 7 %. The observer learns them when both directions have slid."""
    bus = BusChoice("virtual", "rates")
    plant = rig.plant(bus, "distributed")
    plant["axis"][0]["perturbation"] = truth
    rig.write(tmp_path, gait(), plant, {"with": rig.controller(bus, "with", rate, "nominal.toml", 0.95)})
    result = simulate_loop(tmp_path / "controller-with.toml", tmp_path / "plant.toml", 5.0)
    assert not [event.text for event in result.summary.events if "elongation" in event.text]
