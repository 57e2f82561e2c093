"""Test `tsa demo --full`: the possible hidden effects, the calculation of the gain, and a run in virtual time."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tsa_ctrl.cli import main
from tsa_ctrl.demo import rig
from tsa_ctrl.demo.example import EFFECTS, OFF, draw, motion
from tsa_ctrl.demo.rig import BusChoice
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.feedforward import Feedforward
from tsa_ctrl.plant.process import check as check_plant


def test_the_seed_draws_the_effect_its_size_and_the_errors_of_the_nominal_file() -> None:
    assert draw(3) == draw(3)
    assert len({draw(seed).name for seed in range(60)}) > 8
    sizes = {draw(seed, ["viscous_friction"]).effects["viscous_friction"]["coefficient"] for seed in range(9)}
    assert len(sizes) == 9
    for seed in range(20):
        assert all(1.0 / (1.0 + OFF) <= factor <= 1.0 / (1.0 - OFF) for factor in draw(seed).factors.values())


@pytest.mark.parametrize("name", EFFECTS)
def test_what_is_hidden_is_a_plant_and_a_model_that_a_controller_can_use(name: str, tmp_path: Path) -> None:
    hidden = draw(1, [name])
    tables = rig.plant(BusChoice("socketcan", "vcan0"), "full", hidden.axis())
    rig.write(tmp_path, motion(), tables, {})
    check_plant(tmp_path / "plant.toml")
    assert name in hidden.truth(rig.NOMINAL).effects
    assert np.isfinite(Feedforward(hidden.truth(rig.NOMINAL), 1e-3).update(0.5, 1.0, 0.5))


def test_the_load_varies_apart_from_the_motion_and_stays_within_the_domain() -> None:
    play = motion()
    omega = np.gradient(play.q_j, play.t)
    assert abs(np.corrcoef(play.tau_j_des, omega)[0, 1]) < 0.1
    assert np.abs(play.tau_j_des).max() < rig.MOST_TORQUE
    assert play.q_j[0] == pytest.approx(play.q_j[-1], abs=1e-9)


def test_an_effect_that_cannot_be_hidden_is_one_line() -> None:
    with pytest.raises(UsageError, match="--hidden backlash is not one of"):
        draw(1, ["backlash"])


@pytest.mark.parametrize("arguments", [("--hidden", "inertia"), ("--full", "--setpoint", "a.csv")])
def test_options_that_do_not_go_together_are_refused(
    arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["demo", *arguments])
    assert stop.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.slow
def test_a_hidden_effect_is_named_and_compensated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The diagnosis uses only the log of the nominal run and finds the effect hidden in the plant.

    The extended model then reduces the torque error of the next run to less than 60 %.
    """
    options = ("--full", "--hidden", "gravity_load", "--seed", "8", "--seconds", "5", "--rate", "500")
    with pytest.raises(SystemExit) as stop:
        main(["demo", *options, "--virtual", "--out", str(tmp_path), "--json"])
    assert stop.value.code == 0
    data = json.loads(capsys.readouterr().out)
    assert "gravity_load" in [cause["effect"] for cause in data["found"]]
    rms = data["rms"]
    assert rms["extended"] < 0.6 * rms["calibrated"]
    assert data["share_of_reachable"]["from_none"] > 0.8
    assert (tmp_path / "diagnosis" / "report.html").is_file()
