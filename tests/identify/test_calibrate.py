"""Calibration on logs from the elongation equilibrium (tendon_logs), which shares no code with the package."""

from __future__ import annotations

import json
import tomllib

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.blind import tendon_logs
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.calibrate import Calibration, calibrate
from tsa_ctrl.identify.calibrate.prepared import admit
from tsa_ctrl.identify.calibrate.regression import solve
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import TendonSheath, model_from


def rig_and_model(seed: int, profile: str = "joint_end") -> tuple[np.random.Generator, tendon_logs.Rig, TendonSheath]:
    rng = np.random.default_rng([11, seed])
    rig = tendon_logs.draw_rig(rng, profile)
    model = model_from(tomllib.loads(tendon_logs.model_text(rig, rng)), "nominal.toml")
    assert isinstance(model, TendonSheath)
    return rng, rig, model


def log(rig: tendon_logs.Rig, rng: np.random.Generator, name: str = "a.csv", **options: object) -> Dataset:
    return Dataset.from_arrays(tendon_logs.record(rig, rng, **options), name)  # type: ignore[arg-type]


def hits(result: Calibration, rig: tendon_logs.Rig, *names: str) -> int:
    truth = rig.truth()
    return sum(getattr(result, name).low <= truth[name] <= getattr(result, name).high for name in names)


@pytest.mark.slow
@pytest.mark.parametrize(
    "profile", ["joint_end", *(pytest.param(name, marks=pytest.mark.soak) for name in ("uniform", "motor_end"))]
)
def test_intervals_of_the_two_combinations_cover_the_truth(profile: str) -> None:
    """40 logs have two intervals each.

    With 95 % coverage, fewer than 70 hits of 80 have a probability below 1 in 1000.
    """
    found = 0
    for seed in range(40):
        rng, rig, model = rig_and_model(seed, profile)
        found += hits(calibrate([log(rig, rng, seconds=25.0, rate=250.0)], model), rig, "slope", "half_loop_torque")
    assert found >= 70


def test_one_configuration_keeps_the_half_loop_and_is_not_split() -> None:
    rng, rig, model = rig_and_model(1)
    result = calibrate([log(rig, rng)], model)
    assert json.loads(result.to_json())["split"] is False
    assert "tensioner" in result.experiment
    proportion = result.friction_angle.value / result.pretension.value
    assert proportion == pytest.approx(model.friction_angle / model.pretension)
    loop = 2.0 * result.model.pretension * rig.r_j * np.sinh(result.model.friction_angle)
    found = result.half_loop_torque
    assert loop == pytest.approx(found.value, abs=0.1 * (found.high - found.low))  # rounded to the digits of the file


def test_the_interval_of_an_unsplit_parameter_is_what_is_left_open() -> None:
    for seed in range(6):
        rng, rig, model = rig_and_model(seed)
        found = calibrate([log(rig, rng, seconds=25.0, rate=250.0)], model)
        assert hits(found, rig, "friction_angle", "pretension") == 2


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["tensioner", "theta", "tensions", "certified"])
def test_split_recovers_both_parameters(kind: str) -> None:
    for seed in range(2):
        rng, rig, model = rig_and_model(seed)
        change = 0.4 * rig.pretension
        if kind == "tensioner":
            logs = [log(rig, rng), log(rig, rng, "b.csv", tensioner=change)]
            result = calibrate(logs, model, tensioner={"b.csv": change})
        elif kind == "theta":
            result = calibrate([log(rig, rng, theta_swing=0.3 * rig.theta)], model)
        elif kind == "tensions":
            result = calibrate([log(rig, rng, tensions=True)], model)
        else:
            result = calibrate([log(rig, rng)], model, certified_gain=True)
        assert result.split
        truth = rig.truth()
        assert result.friction_angle.value == pytest.approx(truth["friction_angle"], rel=0.03)
        assert result.pretension.value == pytest.approx(truth["pretension"], rel=0.03)


def test_a_motor_torque_that_varies_by_its_noise_alone_is_refused() -> None:
    rng, rig, model = rig_and_model(5)
    columns = tendon_logs.record(rig, rng, seconds=25.0, rate=250.0)
    columns["tau_m"] = 0.1 + 1e-3 * rng.normal(size=columns["t"].size)
    with pytest.raises(UsageError, match="slope cannot be seen"):
        calibrate([Dataset.from_arrays(columns, "bad.csv")], model)


def test_admission_refuses_the_neighbourhood_of_reversals() -> None:
    t = np.arange(0.0, 20.0, 0.002)
    omega = np.cos(2.0 * np.pi * 0.5 * t)
    admission = admit(t, omega)
    reversals = np.arange(0.5, 20.0, 1.0)
    for instant in reversals:
        assert not admission.mask[np.searchsorted(t, instant)]
    assert admission.reversals == reversals.size
    assert 10.0 < admission.seconds < 17.0


def test_the_interval_of_a_mean_over_equal_blocks_is_students() -> None:
    """It is the variance of the block means divided by their number, with one degree of freedom less."""
    means = np.random.default_rng(1).normal(size=7)
    ones, labels = np.ones((70, 1)), np.repeat(np.arange(7), 10)
    estimate = solve(ones, ones, np.repeat(means, 10), labels)
    assert estimate.covariance[0, 0] == pytest.approx(np.var(means, ddof=1) / 7)
    assert estimate.degrees_of_freedom(np.ones(1)) == pytest.approx(6.0)


def test_a_coefficient_that_rests_on_few_blocks_has_few_degrees_of_freedom() -> None:
    rng = np.random.default_rng(2)
    labels = np.repeat(np.arange(10), 20)
    x = np.column_stack([np.ones(200), np.where(labels < 2, rng.normal(size=200), 0.0)])
    estimate = solve(x, x, rng.normal(size=200), labels)
    assert estimate.degrees_of_freedom(np.array([0.0, 1.0])) < 2.5
    assert estimate.degrees_of_freedom(np.array([1.0, 0.0])) > 7.0


def test_a_sensor_zero_that_moves_between_logs_widens_nothing() -> None:
    """Each log has its own sensor zero. A common zero would widen every interval by the difference."""
    rng, rig, model = rig_and_model(6)
    change = 0.4 * rig.pretension
    first = tendon_logs.record(rig, rng, seconds=25.0, rate=250.0)
    second = tendon_logs.record(rig, rng, seconds=25.0, rate=250.0, tensioner=change)

    def width(zero: float) -> float:
        moved = {**second, "tau_j": second["tau_j"] + zero}
        logs = [Dataset.from_arrays(first, "a.csv"), Dataset.from_arrays(moved, "b.csv")]
        half = calibrate(logs, model, tensioner={"b.csv": change}).half_loop_torque
        return half.high - half.low

    assert width(0.2 * float(np.std(first["tau_j"]))) == pytest.approx(width(0.0), rel=0.05)


def drifting(seed: int, rate: float, phase: float, model: TendonSheath) -> Dataset:
    """Return a log by (3.55) whose motor torque has noise with a correlation time of 0.06 s."""
    rng, w = np.random.default_rng(seed), 2.0 * np.pi
    t = np.arange(0.0, 30.0, 1.0 / rate)
    omega, tau_m = 0.75 * np.cos(w * 0.2 * t + phase), 0.3 * np.sin(w * 0.07 * t + phase)
    loop = 2.0 * model.pretension * np.sinh(model.friction_angle) * np.sign(omega)
    tau_j = model.joint_pulley_radius * (tau_m / model.motor_pulley_radius * np.cosh(model.friction_angle) - loop)
    kept = np.exp(-1.0 / (0.06 * rate))
    noise = 0.06 * lfilter([np.sqrt(1.0 - kept**2)], [1.0, -kept], rng.normal(size=t.size))
    tau_j += 4e-3 * rng.normal(size=t.size)
    return Dataset.from_arrays({"t": t, "tau_m": tau_m + noise, "omega_j": omega, "tau_j": tau_j}, f"{rate} Hz")


def test_coloured_noise_biases_no_slope_of_logs_with_different_rates() -> None:
    """The noise of the motor torque is correlated over a time, not over a number of samples."""
    _, _, model = rig_and_model(1)
    true = model.joint_pulley_radius / model.motor_pulley_radius * np.cosh(model.friction_angle)
    slopes = [
        calibrate([drifting(seed, 100.0, 0.0, model), drifting(seed + 6, 500.0, 1.0, model)], model).slope
        for seed in range(6)
    ]
    assert sum(slope.low < true < slope.high for slope in slopes) >= 5
