"""Test the tendon torque calculated from a torque measured behind a joint whose formula has memory."""

from __future__ import annotations

import numpy as np
import pytest

from tests.blind.memory import bristle, first_order_lag
from tests.model.actuator import ACTUATOR
from tsa_ctrl.control.estimator import EstimateState, Sample
from tsa_ctrl.control.kalman import EffectRemoval, KalmanEstimator, unsupported_reason
from tsa_ctrl.control.settings import EstimatorSettings

PERIOD = 1e-3
EXPRESSION = "0.4*(tau - lag(tau, 0.2)) + 0.03*dahl(tau, 0.3)"


def test_a_formula_with_a_memory_is_taken_off_cycle_by_cycle() -> None:
    """The result is independent of the number of calls per cycle and of the history before the last reset."""
    tendons = 0.6 * np.sin(7.0 * PERIOD * np.arange(400)) + 0.1
    taken = 0.4 * (tendons - first_order_lag(tendons, PERIOD, 0.2)) + 0.03 * bristle(tendons, 0.3, 0.0)
    removal = EffectRemoval(ACTUATOR.with_effects({"custom": {"expression": EXPRESSION}}), PERIOD)
    assert removal.remembers
    for _ in range(2):
        removal.reset()
        for left, brought in zip((tendons - taken).tolist(), tendons.tolist(), strict=True):
            removal.measure(Sample(1.0, 0.5, 0.0, 0.0, 0.0, True, 0.1, 0.1))
            removal.joint(left + 0.2)
            assert removal.joint(left) == pytest.approx(brought, abs=1e-9)


def test_the_memory_of_a_formula_counts_skipped_cycles() -> None:
    """A late loop calls the estimator in two of three periods only."""
    t = PERIOD * np.arange(3000)
    tendons = 0.6 * np.sin(2.0 * t) + 0.1
    taken = 0.4 * (tendons - first_order_lag(tendons, PERIOD, 0.2))
    removal = EffectRemoval(ACTUATOR.with_effects({"custom": {"expression": "0.4*(tau - lag(tau, 0.2))"}}), PERIOD)
    for n in np.flatnonzero(np.arange(len(t)) % 3 < 2).tolist():
        removal.measure(Sample(1.0, 0.5, 0.0, 0.0, 0.0, True, 0.1, 0.1, t=float(t[n])))
        assert removal.joint(float(tendons[n] - taken[n])) == pytest.approx(tendons[n], abs=1e-6)


def sliding() -> tuple[np.ndarray, ...]:
    """Return t, omega, sigma, tau_m and the torque of the nominal tendons for 8 s of motion in both directions."""
    t = PERIOD * np.arange(8000)
    omega = 0.8 * np.sign(np.sin(2.0 * t)) * np.minimum(1.0, 20.0 * np.abs(np.sin(2.0 * t)))
    sigma = np.sign(omega)
    tau_m = 0.4 * np.sin(3.0 * t)
    x, r_m, r_j = ACTUATOR.friction_angle, ACTUATOR.motor_pulley_radius, ACTUATOR.joint_pulley_radius
    tendons = r_j / r_m * np.cosh(x) * tau_m - 2.0 * ACTUATOR.pretension * r_j * np.sinh(x) * sigma
    return t, omega, sigma, tau_m, tendons


def test_the_estimator_follows_it_through_cycles_that_it_does_not_learn_from() -> None:
    """The estimated friction torque equals the one of a joint without the formula.

    The formula is evaluated in every cycle, although the estimator only uses cycles of steady sliding.
    """
    model = ACTUATOR.with_effects({"custom": {"expression": EXPRESSION}})
    estimators = [
        KalmanEstimator(each, EstimatorSettings(kind="sensor", use=True), PERIOD) for each in (ACTUATOR, model)
    ]
    _, omega, sigma, tau_m, tendons = sliding()
    taken = 0.4 * (tendons - first_order_lag(tendons, PERIOD, 0.2)) + 0.03 * bristle(tendons, 0.3, 0.0)
    for estimator, measured in zip(estimators, (tendons, tendons - taken), strict=True):
        for row in zip(sigma.tolist(), omega.tolist(), tau_m.tolist(), measured.tolist(), strict=True):
            estimator.update(Sample(row[0], row[1], 0.0, row[2], row[3], True, 0.1, 0.1))
    plain, remembering = estimators
    assert plain.state == remembering.state == EstimateState.ESTIMATED
    assert remembering.half_loop == pytest.approx(plain.half_loop, rel=1e-6)


WARM = 45.0  # degC


@pytest.mark.parametrize("expression", ["0.02*(temperature - 25)*omega_j", "0.2*omega_j*t/(1 + t)"])
def test_a_formula_gets_the_temperature_and_the_time(expression: str) -> None:
    """The friction torque is that of the tendons. A temperature that arrives late only delays the estimate."""
    model = ACTUATOR.with_effects({"custom": {"expression": expression}})
    estimator = KalmanEstimator(model, EstimatorSettings(kind="sensor", use=True), PERIOD)
    t, omega, sigma, tau_m, tendons = sliding()
    factor = 0.02 * (WARM - 25.0) if "temperature" in expression else 0.2 * t / (1.0 + t)
    warm = np.where(t < 1.0, np.nan, WARM)
    rows = zip(*(each.tolist() for each in (sigma, omega, tau_m, tendons - factor * omega, warm, t)), strict=True)
    for s, w, motor, joint, temperature, time in rows:
        estimator.update(Sample(s, w, 0.0, motor, joint, True, 0.1, 0.1, temperature=temperature, t=time))
    assert estimator.state is EstimateState.ESTIMATED
    assert estimator.half_loop_ratio == pytest.approx(1.0, abs=0.01)


def test_an_unknown_joint_torque_does_not_stay_in_the_filter() -> None:
    """With the kind "motor", the estimate recovers from a joint torque that was unknown for a second."""
    model = ACTUATOR.with_effects({"custom": {"expression": "0.02*(temperature - 25)*omega_j"}})
    estimator = KalmanEstimator(model, EstimatorSettings(kind="motor", use=True), PERIOD)
    t, omega, sigma, _, _ = sliding()
    x, r_m, r_j = ACTUATOR.friction_angle, ACTUATOR.motor_pulley_radius, ACTUATOR.joint_pulley_radius
    taken = 0.02 * (WARM - 25.0) * omega
    tau_m = 2.0 * ACTUATOR.pretension * r_m * np.tanh(x) * sigma + taken * r_m / r_j / np.cosh(x)
    for s, w, motor, time in zip(*(each.tolist() for each in (sigma, omega, tau_m, t)), strict=True):
        temperature = np.nan if 4.0 < time < 5.0 else WARM
        estimator.update(Sample(s, w, 0.0, motor, np.nan, True, 0.1, 0.1, temperature=temperature, t=time))
    assert estimator.state is EstimateState.ESTIMATED
    assert estimator.half_loop_ratio == pytest.approx(1.0, abs=0.01)


def test_a_missing_speed_does_not_stay_in_the_acceleration() -> None:
    removal = EffectRemoval(ACTUATOR.with_effects({"inertia": {"inertia": 0.1}}), PERIOD)
    for omega in (0.5, np.nan, 0.5, 0.5):
        removal.measure(Sample(1.0, omega, 0.0, 0.0, 0.0, True, 0.1, 0.1))
    assert removal.joint(0.2) == pytest.approx(0.2)


def test_a_temperature_that_is_not_measured_prevents_an_estimate() -> None:
    model = ACTUATOR.with_effects({"custom": {"expression": "0.02*(temperature - 25)*omega_j"}})
    assert "custom depends on the temperature, which this axis does not measure" in unsupported_reason(model)
    assert unsupported_reason(model, has_temperature=True) == ""
