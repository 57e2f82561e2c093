"""The random rigs: the same seed draws the same rig, every rig is inside its ranges, and its files load."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.bench.rigs import draw
from tsa_ctrl.config import load_configuration
from tsa_ctrl.model.curvature import Profile
from tsa_ctrl.plant.process import check


def test_a_seed_and_a_number_draw_the_same_rig_and_others_draw_another() -> None:
    assert draw(3, 1) == draw(3, 1)
    assert draw(3, 1) != draw(3, 2)
    assert draw(3, 1) != draw(4, 1)


def test_the_rigs_cover_their_ranges_and_every_effect() -> None:
    rigs = [draw(7, number) for number in range(200)]
    angles = [rig.truth.friction_angle for rig in rigs]
    assert 0.05 <= min(angles) < 0.15
    assert 1.1 < max(angles) <= 1.2
    for rig in rigs:
        assert abs(rig.nominal.friction_angle / rig.truth.friction_angle - 1.0) <= 0.2
        assert abs(rig.nominal.pretension / rig.truth.pretension - 1.0) <= 0.2
        assert abs(rig.nominal.axial_stiffness / rig.truth.axial_stiffness - 1.0) <= 0.2
    assert {bits for rig in rigs for bits in rig.bits} == set(range(12, 21))
    assert {rig.delay for rig in rigs} == {1, 2, 3}
    drift = {"thermal_friction_drift", "pretension_relaxation"}
    assert {name for rig in rigs for name in rig.effects} == drift | {
        "torque_ripple",
        "motor_side_friction",
        "backlash",
        "joint_play",
        "pulley_eccentricity",
    }
    centres = [Profile(rig.profile).centre for rig in rigs]
    assert min(centres) < 0.15
    assert max(centres) > 0.85


@pytest.mark.parametrize("number", [0, 1, 2])
def test_the_files_of_a_rig_load_and_the_controller_gets_no_effect(number: int, tmp_path: Path) -> None:
    rig = draw(11, number)
    rig.write(tmp_path)
    configuration = load_configuration(tmp_path / "controller.toml")
    assert not configuration.models[0].effects
    assert configuration.models[0].bending_centre is None
    for joint in ("imposed", "held", "wearer"):
        axis = check(tmp_path / f"plant-{joint}.toml").axis[0]
        assert set(axis.effects) == set(rig.effects)
        assert axis.drive.peak_torque > configuration.file.axes[0].limits.torque
