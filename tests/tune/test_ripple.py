"""Torque ripple in tune. The logs come from a mechanism without code of the package, and the test adds the ripple."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.tune.test_estimate import rig_and_log
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.tune.estimate import estimate
from tsa_ctrl.tune.ripple import with_torque_ripple


def geared(log: Dataset, model: TendonSheath) -> Dataset:
    """Return the log with the angle of a motor on rigid tendons."""
    columns = {name: log[name].copy() for name in log.columns}
    angle = np.cumsum(columns["omega_j"]) * float(np.median(np.diff(columns["t"])))
    columns["q_m"] = angle * model.joint_pulley_radius / model.motor_pulley_radius
    return Dataset.from_arrays(columns, "geared.csv")


def with_wave(log: Dataset, amplitude: float, cycles: float, phase: float) -> Dataset:
    """Return the log of a motor with a torque of `amplitude` sin(cycles q_m + phase) (N*m) that it does not report."""
    columns = {name: log[name].copy() for name in log.columns}
    columns["tau_m"] -= amplitude * np.sin(cycles * columns["q_m"] + phase)
    return Dataset.from_arrays(columns, "ripple.csv")


@pytest.mark.parametrize("profile", ["joint_end", "uniform"])
@pytest.mark.parametrize("cycles", [12, 84])
def test_the_wave_of_a_motor_is_found(profile: str, cycles: int) -> None:
    rng = np.random.default_rng(cycles)
    _, model, log = rig_and_log(profile)
    log = geared(log, model)
    amplitude, phase = float(rng.uniform(0.02, 0.05)), float(rng.uniform(-math.pi, math.pi))
    log = with_wave(log, amplitude, cycles, phase)
    found = with_torque_ripple(estimate([log], model, certified_gain=False, forms=True), [log])
    assert found is not None
    values = found.model.effects["torque_ripple"]
    assert values["cycles_per_revolution"] == pytest.approx(cycles, abs=1)
    assert values["amplitude"] == pytest.approx(amplitude, rel=0.2)
    q_m = log["q_m"]
    truth = amplitude * np.sin(cycles * q_m + phase)
    wave = values["amplitude"] * np.sin(values["cycles_per_revolution"] * q_m + values["phase"])
    assert np.sqrt(np.mean((wave - truth) ** 2)) < 0.4 * np.sqrt(np.mean(truth**2))
    assert "torque ripple of" in found.notes[-1]
    assert found.calibration.model is found.model


@pytest.mark.parametrize(("profile", "seed"), [("joint_end", 0), ("uniform", 1), ("motor_end", 2), ("uniform", 3)])
def test_a_motor_without_a_wave_keeps_its_model(profile: str, seed: int) -> None:
    _, model, bare = rig_and_log(profile, seed)
    log = geared(bare, model)
    found = estimate([log], model, certified_gain=False, forms=True)
    assert with_torque_ripple(found, [log]) is None
    assert with_torque_ripple(found, [bare]) is None  # a log without the motor's angle shows no wave


@pytest.mark.parametrize("profile", ["joint_end", "uniform"])
def test_a_motion_of_little_more_than_one_cycle_shows_the_wave(profile: str) -> None:
    """A motor with 6 cycles per revolution turns by a fifth of a revolution in a gait."""
    _, model, log = rig_and_log(profile)
    log = geared(log, model)
    cycles = math.ceil(1.1 * 2.0 * math.pi / float(np.ptp(log["q_m"])))
    log = with_wave(log, 0.03, cycles, 0.3)
    found = with_torque_ripple(estimate([log], model, certified_gain=False, forms=True), [log])
    assert found is not None
    values = found.model.effects["torque_ripple"]
    wave = values["amplitude"] * np.sin(values["cycles_per_revolution"] * log["q_m"] + values["phase"])
    truth = 0.03 * np.sin(cycles * log["q_m"] + 0.3)
    assert np.std(wave - truth) < 0.4 * np.std(truth)


def test_a_motion_of_less_than_one_cycle_shows_no_wave() -> None:
    _, model, log = rig_and_log("uniform")
    log = geared(log, model)
    span = float(np.ptp(log["q_m"]))
    log = with_wave(log, 0.1, 0.7 * 2.0 * math.pi / span, 0.3)
    found = with_torque_ripple(estimate([log], model, certified_gain=False, forms=True), [log])
    if found is not None:  # a ripple faster than the remaining error of the slow one
        assert found.model.effects["torque_ripple"]["cycles_per_revolution"] * span >= 2.0 * math.pi
