"""Calibration of logs of several joints.

In the rig of `tests.blind`, the angles of a hip and an ankle bend the sheath.
"""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.blind.routed import Gains, routed_case
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.calibrate import Calibration, calibrate
from tsa_ctrl.identify.calibrate.routing import fit_routing, of_elongation
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.motion import tied_joints
from tsa_ctrl.model.parameters import TendonSheath, load_tendon_sheath, model_from, save_model
from tsa_ctrl.model.routing import Route, Routing


def logs_of(name: str, seed: int) -> tuple[list[Dataset], TendonSheath, Gains]:
    case, gains = routed_case(name, seed, short=True)
    model = model_from(tomllib.loads(case.model), "nominal.toml")
    assert isinstance(model, TendonSheath)
    return [Dataset.from_arrays(log.columns, log.name) for log in case.logs], model, gains


def gains_of(result: Calibration) -> dict[str, float]:
    assert result.model.routing is not None
    assert result.model.routing.alike
    return dict(result.model.routing.a.gains)


@pytest.mark.parametrize("name", ["absent", "wrong", "two"])
def test_the_gains_of_all_joints_are_found_with_the_rest(name: str, tmp_path: Path) -> None:
    logs, model, gains = logs_of(name, 2)
    result = calibrate(logs, model)
    for joint, true in gains.true.items():
        found = result.routing[f"gain.{joint}"]
        assert found.low < true < found.high
        assert found.high - found.low < abs(true)
    assert result.rms_after < 0.5 * result.rms_before
    save_model(result.model, tmp_path / "new.toml")
    assert load_tendon_sheath(tmp_path / "new.toml").routing == result.model.routing


def test_right_gains_and_joints_without_effect_stay_as_they_are() -> None:
    """The second joint of this rig moves without changing the wrap angle."""
    logs, model, gains = logs_of("right", 2)
    result = calibrate(logs, model)
    assert gains_of(result) == gains.file
    assert "the logs show no other routing by hip than the file: it is kept" in result.notes


def test_a_small_error_of_a_gain_in_the_file_does_not_shift_the_gains_of_other_joints() -> None:
    """The file's gain of the ankle is 0.2 rad/rad too large, less than a joint outside the file may have.

    All gains are relative to x. A wrong gain that counts as exact would give x, and every other gain, the same error.
    """
    logs, model, gains = logs_of("two", 2)
    small = gains.true["ankle"] + 0.2
    model = dataclasses.replace(model, routing=Routing.sum_of(None, {"ankle": small}))
    result = calibrate(logs, model)
    for joint, true in gains.true.items():
        found = result.routing[f"gain.{joint}"]
        assert found.low < true < found.high


def rig_of(gain_a: float, gain_b: float, curve: float = 0.0) -> tuple[dict[str, NDArray[np.float64]], TendonSheath]:
    """Return a log of two tendons by the capstan equation, and a file without routing and with wrong friction."""
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 60.0, 0.004)
    q, hip = 0.6 * np.sin(2.1 * t), 0.5 * np.sin(0.7 * t)
    speed = 0.6 * 2.1 * np.cos(2.1 * t)
    sigma = np.sign(speed)
    tau_m = 0.5 * np.sin(3.7 * t) + 0.2 * np.sin(0.31 * t)
    mu, theta, pretension, slope, r_m, r_j = 0.1, 3.0, 50.0, 30.0, 0.02, 0.025
    bent_a, bent_b = theta + gain_a * hip + curve * hip**2, theta + gain_b * hip + curve * hip**2
    tension = pretension + slope * (0.5 * (bent_a + bent_b) - theta)
    t1, t3 = tension - tau_m / (2.0 * r_m), tension + tau_m / (2.0 * r_m)
    tau_j = r_j * (t3 * np.exp(-sigma * mu * bent_b) - t1 * np.exp(sigma * mu * bent_a))
    stiffness = slope / 0.0006
    elongation = (tau_m / r_m + tau_j / r_j) / (4.0 * stiffness)  # curvature in the middle: the mean of both ends
    noise = [scale * rng.standard_normal(t.size) for scale in (0.004, 0.004, 1e-6)]
    log = {"t": t, "tau_m": tau_m + noise[0], "tau_j": tau_j + noise[1], "omega_j": speed, "q_j": q, "q_j.hip": hip}
    paths = 0.5 * 0.0006 * (bent_a - bent_b)
    log["q_m"] = (r_j * q + elongation + paths + noise[2]) / r_m + 0.1
    model = TendonSheath(
        motor_pulley_radius=r_m,
        joint_pulley_radius=r_j,
        axial_stiffness=stiffness,
        unstrained_length=1.0,
        diameter=0.0006,
        contact_offset=0.0003,
        friction_coefficient=0.11,
        bending_angle=theta,
        pretension=46.0,
    )
    return log, model


def test_tendons_that_are_routed_differently_have_gains_of_their_own() -> None:
    """The true gains are 0.9 rad/rad and -0.3 rad/rad."""
    log, model = rig_of(0.9, -0.3)
    del log["q_m"]
    result = calibrate([Dataset.from_arrays(log, "run")], model)
    for tendon, true in (("a", 0.9), ("b", -0.3)):
        found = result.routing[f"gain_{tendon}.hip"]
        assert found.low < true < found.high
        assert found.value == pytest.approx(true, abs=0.05)


def test_path_lengths_show_the_difference_of_the_gains_and_thereby_all_gains() -> None:
    """The errors of the gains are 0.4 % of the larger one, and 1.2 % without the angle of the motor.

    A motor angle that follows the hip for another reason is not used.
    """
    log, model = rig_of(0.9, -0.3)
    without = {name: column for name, column in log.items() if name != "q_m"}
    foreign = {**log, "q_m": log["q_m"] + 0.02 * log["q_j.hip"]}
    by_paths, alone, unused = (calibrate([Dataset.from_arrays(each, "run")], model) for each in (log, without, foreign))
    for tendon, true in (("a", 0.9), ("b", -0.3)):
        found, wide = by_paths.routing[f"gain_{tendon}.hip"], alone.routing[f"gain_{tendon}.hip"]
        assert found.low < true < found.high
        assert found.high - found.low < 0.8 * (wide.high - wide.low)
        assert unused.routing[f"gain_{tendon}.hip"].value == pytest.approx(wide.value, rel=0.01)


def test_gains_are_totals_for_each_tendon_and_changes_of_a_table() -> None:
    """The file's gains of both tendons are 0.2 rad/rad too small, or its table has that slope."""
    log, model = rig_of(0.9, -0.3)
    del log["q_m"]
    apart = Routing(Route({"hip": 0.7}, {}), Route({"hip": -0.5}, {}))
    found = calibrate([Dataset.from_arrays(log, "run")], dataclasses.replace(model, routing=apart)).routing
    assert found["gain_a.hip"].value == pytest.approx(0.9, abs=0.05)
    assert found["gain_b.hip"].value == pytest.approx(-0.3, abs=0.05)
    log, model = rig_of(0.9, 0.9)
    table = Route({}, {"hip": ((-0.6, -0.42), (0.6, 0.42))})
    result = calibrate([Dataset.from_arrays(log, "run")], dataclasses.replace(model, routing=Routing(table, table)))
    assert result.routing["change_of_table.hip"].value == pytest.approx(0.2, abs=0.05)
    assert any("beyond its table" in note for note in result.notes)


@pytest.mark.parametrize("curve", [0.0, -1.5, 0.9])
def test_a_wrap_angle_that_is_not_proportional_is_reported_with_a_table(curve: float) -> None:
    """The wrap angle has its maximum at 0.2 rad of the hip. The proposed table leaves the noise of the sensors."""
    log, model = rig_of(0.6, 0.6, curve)
    del log["q_m"]
    data = Dataset.from_arrays(log, "run")
    result = calibrate([data], model)
    proposed = [note for note in result.notes if "not proportional to the angle of hip" in note]
    assert len(proposed) == bool(curve)
    assert bool(result.routing) is not bool(curve)
    assert result.model.routing == (model.routing if curve else result.model.routing)
    if proposed:
        table = tomllib.loads(proposed[0].partition("Write ")[2].partition(" in [routing]")[0])["table"]["hip"]
        route = Route({}, {"hip": tuple((q, theta) for q, theta in table)})
        again = calibrate([data], dataclasses.replace(result.model, routing=Routing(route, route)))
        assert again.rms_written < 0.3 * result.rms_written
        assert again.rms_written < 0.01


@pytest.mark.parametrize("exact", ["friction_angle", "pretension"])
def test_a_value_that_the_file_calls_exact_is_kept(exact: str) -> None:
    log, model = rig_of(0.9, 0.9)
    del log["q_m"]
    certain = dataclasses.replace(model, **{f"{exact}_uncertainty": 0.0})
    result = calibrate([Dataset.from_arrays({name: column[:8000] for name, column in log.items()}, "run")], certain)
    assert getattr(result.model, exact) == pytest.approx(getattr(model, exact), rel=0.005)
    assert "gain.hip" in result.routing


@pytest.mark.parametrize("gain", [0.7, -0.5])
def test_the_elongation_shows_the_gain_without_a_joint_torque(gain: float) -> None:
    """The elongation of tendons bent in the middle is the mean of the tension differences of both ends."""
    log, model = rig_of(gain, gain)
    del log["tau_j"]
    found = fit_routing(of_elongation([Dataset.from_arrays(log, "run")], model), model, False, by_elongation=True)
    assert found is not None
    assert found.gains["gain.hip"].low < gain < found.gains["gain.hip"].high
    assert found.gains["gain.hip"].value == pytest.approx(gain, rel=0.15)


def test_a_joint_whose_angle_is_a_sum_of_others_is_tied_to_them() -> None:
    t = np.arange(0.0, 60.0, 0.01)
    hip, knee, toe = (np.sin(rate * t) for rate in (0.7, 1.1, 1.9))
    ankle = 0.3 * hip - 0.8 * knee + 0.5
    assert tied_joints({"hip": hip, "knee": knee, "toe": toe, "ankle": ankle}) == {"ankle": ("hip", "knee")}
    assert tied_joints({"hip": hip, "knee": hip + 0.2 * knee}) == {}


def test_gains_of_joints_that_move_in_proportion_are_not_attributed_to_one_of_them() -> None:
    """The knee bends the sheath by 0.5 rad/rad. The error was "no effect of knee" and a wrong gain of the hip."""
    log, model = rig_of(0.8, 0.8)
    del log["q_m"]
    log["q_j.knee"] = 1.6 * log["q_j.hip"]
    data = Dataset.from_arrays(log, "run")
    with pytest.raises(UsageError) as caught:
        calibrate([data], model)
    assert str(caught.value) == (
        "calibrate: the joints hip and knee move in proportion in these logs, so their effects on the wrap angle "
        "cannot be separated; move each of them alone as well, or remove the column q_j.NAME of a joint that does not "
        "bend the sheath"
    )
    right = dataclasses.replace(model, routing=Routing.sum_of(None, {"knee": 0.5}))
    assert gains_of(calibrate([data], right)) == {"knee": 0.5}


@pytest.mark.parametrize("file", [{}, {"ankle": 0.4}])
def test_a_joint_at_rest_is_reported(file: dict[str, float]) -> None:
    log, model = rig_of(0.9, 0.9)
    del log["q_m"]
    log["q_j.ankle"] = np.full(log["t"].size, 0.3)
    result = calibrate(
        [Dataset.from_arrays(log, "run")], dataclasses.replace(model, routing=Routing.sum_of(None, file))
    )
    rest = "[routing] of the file is used for it" if file else "the result holds with the joint at this angle"
    assert f"joint ankle rests at 0.3 rad in these logs and shows no gain: {rest}" in result.notes


def test_path_lengths_count_although_an_error_of_the_torque_disagrees_slightly() -> None:
    """A torque of 10 mN*m/rad that follows the hip shifts the difference of the gains by 1.7 intervals of the torques.

    Without the path lengths, the gains were 0.77 and -0.18 rad/rad.
    """
    log, model = rig_of(0.9, -0.3)
    log["tau_j"] += 0.01 * log["q_j.hip"]
    found = calibrate([Dataset.from_arrays(log, "run")], model).routing
    for tendon, true in (("a", 0.9), ("b", -0.3)):
        assert found[f"gain_{tendon}.hip"].value == pytest.approx(true, abs=0.06)
