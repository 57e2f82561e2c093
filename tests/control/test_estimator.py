"""Test that online estimators recover known parameters, and that insufficient or false data do not change them."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from tests.control.sliding import PERIOD, R_J, R_M, Sliding, actuator
from tests.model.capstan import Pair
from tests.model.test_curvature import S_BENT
from tsa_ctrl.control.estimator import ConfigurationMap, EstimateState, Fixed, Sample, Split
from tsa_ctrl.control.kalman import KalmanEstimator, unsupported_reason
from tsa_ctrl.control.settings import Attribution, EstimatorSettings
from tsa_ctrl.model.curvature import Points
from tsa_ctrl.model.parameters import TendonSheath

MODEL = actuator()
X, PRETENSION = MODEL.friction_angle, MODEL.pretension


def feed(estimator: KalmanEstimator, data: Sliding) -> None:
    for sigma, omega, tau_m, tau_j in data.samples():
        estimator.update(Sample(sigma, omega, math.nan, tau_m, tau_j, True))


@pytest.mark.parametrize("change", [0.7, 1.4])
@pytest.mark.parametrize("kind", ["sensor", "motor"])
def test_follows_a_change_of_bending(kind: str, change: float) -> None:
    """Within ten seconds of motion, x and T_p are within 4 % of their values at 70 to 140 % of the wrap angle."""
    settings = EstimatorSettings(kind=kind, use=True)  # type: ignore[arg-type]
    estimator = KalmanEstimator(MODEL, settings, PERIOD)
    theta = MODEL.bending_angle * change
    lever = MODEL.contact_offset + MODEL.diameter / 2.0
    stiffness = MODEL.axial_stiffness / MODEL.unstrained_length
    pretension = PRETENSION + stiffness * lever * (theta - MODEL.bending_angle)
    x = MODEL.friction_coefficient * theta
    feed(estimator, Sliding(x, pretension, seconds=12.0, load=0.0 if kind == "motor" else 0.8))
    assert estimator.state is EstimateState.ESTIMATED
    assert estimator.friction_angle == pytest.approx(x, rel=0.04)
    assert estimator.pretension == pytest.approx(pretension, rel=0.04)


@pytest.mark.parametrize(
    ("attribute", "x", "pretension"),
    [(Attribution.FRICTION, 1.2 * X, PRETENSION), (Attribution.PRETENSION, X, 1.2 * PRETENSION)],
)
def test_attributes_the_change_as_told(attribute: Attribution, x: float, pretension: float) -> None:
    """The change is attributed to the configured parameter, and the other one stays nominal."""
    estimator = KalmanEstimator(MODEL, EstimatorSettings(kind="sensor", attribute=attribute), PERIOD)
    feed(estimator, Sliding(x, pretension, seconds=10.0))
    assert estimator.friction_angle == pytest.approx(x, rel=0.03)
    assert estimator.pretension == pytest.approx(pretension, rel=0.03)


def test_sensor_offset_is_not_taken_for_friction() -> None:
    """A constant offset of the torque sensor is estimated as an offset and does not change the friction."""
    estimator = KalmanEstimator(MODEL, EstimatorSettings(kind="sensor"), PERIOD)
    feed(estimator, Sliding(X, PRETENSION, seconds=10.0, offset=0.05))
    assert estimator.offset == pytest.approx(0.05, abs=0.01)
    assert estimator.friction_angle == pytest.approx(X, rel=0.02)


def test_a_reversal_that_runs_through_the_sheath_is_not_taken_for_less_friction() -> None:
    """The friction reverses over 0.4 of the joint travel 2 h/K of bends at the motor, long after the term."""
    estimator = KalmanEstimator(MODEL, EstimatorSettings(kind="sensor"), PERIOD)
    friction = 2.0 * R_J * PRETENSION * math.sinh(X)  # N*m at the joint
    way = 2.0 * friction * MODEL.unstrained_length / (2.0 * MODEL.axial_stiffness * R_J**2)  # rad
    speed, passed, t = 0.3, 0.0, 0.0  # rad/s, rad since the reversal, s
    for stroke in range(60):
        sigma = 1.0 if stroke % 2 else -1.0
        passed = 0.0
        while passed < 2.0 * way:
            t, passed = t + PERIOD, passed + speed * PERIOD
            held = sigma * min(1.0, 2.0 * passed / (0.4 * way) - 1.0)  # direction of the friction, -1 to 1
            load = 0.4 * math.sin(1.3 * t)
            tau_m = (load + sigma * friction) * R_M / R_J / math.cosh(X)
            estimator.update(Sample(sigma, sigma * speed, math.nan, tau_m, load + (sigma - held) * friction, True))
    assert estimator.state is EstimateState.ESTIMATED
    assert estimator.half_loop_ratio == pytest.approx(1.0, abs=0.02)


def test_one_direction_is_too_little() -> None:
    """Motion in one direction cannot separate friction from an offset, so the estimate does not change."""
    estimator = KalmanEstimator(MODEL, EstimatorSettings(kind="sensor"), PERIOD)
    for sigma, omega, tau_m, tau_j in Sliding(1.3 * X, PRETENSION, seconds=8.0).samples():
        if sigma > 0.0:
            estimator.update(Sample(sigma, omega, math.nan, tau_m, tau_j, True))
    assert estimator.state is EstimateState.UNESTIMATED
    assert (estimator.friction_angle, estimator.pretension) == (X, PRETENSION)


def test_frozen_without_excitation() -> None:
    """An estimate is kept at standstill and while samples are not admitted."""
    estimator = KalmanEstimator(MODEL, EstimatorSettings(kind="sensor"), PERIOD)
    feed(estimator, Sliding(1.2 * X, PRETENSION, seconds=12.0))
    before = estimator.half_loop, estimator.state
    for _ in range(5000):
        estimator.update(Sample(0.0, 0.0, math.nan, 0.3, 5.0, True))
        estimator.update(Sample(1.0, 1.0, math.nan, 0.3, 5.0, False))
    assert (estimator.half_loop, estimator.state) == before


def test_wild_data_is_invalid_and_returns_to_nominal() -> None:
    """If the sensor contradicts the model, the estimate is invalid and the outputs return to the file's values."""
    estimator = KalmanEstimator(MODEL, EstimatorSettings(kind="sensor"), PERIOD)
    feed(estimator, Sliding(1.2 * X, PRETENSION, seconds=8.0))
    noise = np.random.default_rng(5)
    for sigma, omega, tau_m, _ in Sliding(X, PRETENSION, seconds=20.0).samples():
        slow = 2.0 * math.sin(1e-3 * noise.integers(0, 10_000)) if noise.random() < 0.02 else 1.5
        estimator.update(Sample(sigma, omega, math.nan, tau_m, slow * (1.0 + math.sin(3.0 * omega)), True))
    assert estimator.state is EstimateState.INVALID
    assert estimator.friction_angle == pytest.approx(X)
    assert estimator.pretension == pytest.approx(PRETENSION)


def locked_joint(friction: float, amplitude: float, spread: float, seconds: float) -> list[Sample]:
    """Return samples of a locked joint under a sinusoidal motor torque.

    Parallel plays represent parts of the sheath that slide one after the other.

    Args:
        friction: friction torque at the joint once all plays slide, N*m
        amplitude: amplitude of the motor torque, N*m
        spread: relative deviation of the plays from their mean
        seconds: duration, s
    """
    rng = np.random.default_rng(4)
    slope = R_J / R_M * math.cosh(X)
    plays = [friction * (1.0 + spread * k) for k in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    held = [0.0] * len(plays)
    samples = []
    for n in range(round(seconds / PERIOD)):
        phase = 2.0 * math.pi * 0.5 * n * PERIOD
        tau_m = amplitude * math.sin(phase)
        held = [max(slope * tau_m - h, min(slope * tau_m + h, was)) for h, was in zip(plays, held, strict=True)]
        tau_j = float(np.mean(held)) + 5e-3 * rng.standard_normal()
        samples.append(Sample(math.copysign(1.0, math.cos(phase)), 0.0, math.nan, tau_m, tau_j, True))
    return samples


@pytest.mark.parametrize("spread", [0.0, 0.9])
@pytest.mark.parametrize("change", [0.6, 1.3])
def test_a_torque_sensor_shows_the_friction_of_a_locked_joint(change: float, spread: float) -> None:
    estimator = KalmanEstimator(MODEL, EstimatorSettings(kind="sensor"), PERIOD)
    friction = 2.0 * PRETENSION * R_J * math.sinh(X)
    for sample in locked_joint(change * friction, 4.0 * friction * R_M / R_J, spread, 12.0):
        estimator.update(sample)
    assert estimator.state is EstimateState.ESTIMATED
    assert estimator.half_loop == pytest.approx(change * friction, rel=0.04)


@pytest.mark.parametrize("spread", [0.0, 0.9])
def test_a_torque_that_never_slides_all_of_the_sheath_shows_no_friction(spread: float) -> None:
    estimator = KalmanEstimator(MODEL, EstimatorSettings(kind="sensor"), PERIOD)
    friction = 2.0 * PRETENSION * R_J * math.sinh(X)
    for sample in locked_joint(friction, 0.8 * friction * R_M / R_J, spread, 12.0):
        estimator.update(sample)
    assert estimator.half_loop == pytest.approx(friction, rel=0.04)
    assert estimator.state is EstimateState.UNESTIMATED


@pytest.mark.parametrize("stuck", [0.0, 0.4])
def test_stuck_sensor_is_invalid(stuck: float) -> None:
    """A constant torque reading implies a friction beyond the bounds, so the estimate is invalid."""
    estimator = KalmanEstimator(MODEL, EstimatorSettings(kind="sensor", use=True), PERIOD)
    for sigma, omega, tau_m, _ in Sliding(X, PRETENSION, seconds=20.0).samples():
        estimator.update(Sample(sigma, omega, math.nan, tau_m, stuck, True))
    assert estimator.state is EstimateState.INVALID


def test_missing_sensor_value_does_not_poison() -> None:
    """The estimate stays correct if the sensor value is nan for half a second."""
    estimator = KalmanEstimator(MODEL, EstimatorSettings(kind="sensor"), PERIOD)
    for n, (sigma, omega, tau_m, tau_j) in enumerate(Sliding(X, PRETENSION, seconds=16.0).samples()):
        estimator.update(Sample(sigma, omega, math.nan, tau_m, math.nan if 2000 < n < 2500 else tau_j, True))
    assert estimator.state is EstimateState.ESTIMATED
    assert estimator.friction_angle == pytest.approx(X, rel=0.02)


@pytest.mark.parametrize("kind", ["sensor", "motor"])
def test_moves_no_faster_than_its_rate_and_stays_in_bounds(kind: str) -> None:
    """For random samples, no parameter changes faster than the rate, and the friction angle stays within its bounds."""
    settings = EstimatorSettings(kind=kind, rate=0.3, bounds=0.4)  # type: ignore[arg-type]
    estimator = KalmanEstimator(MODEL, settings, PERIOD)
    random = np.random.default_rng(6)
    last = estimator.friction_angle, estimator.pretension
    for _ in range(20_000):
        sign = 1.0 if random.random() < 0.5 else -1.0
        estimator.update(
            Sample(sign, sign * 2.0, math.nan, float(random.normal(0.0, 1.0)), float(random.normal(0.0, 5.0)), True)
        )
        now = estimator.friction_angle, estimator.pretension
        assert abs(now[0] - last[0]) <= 0.3 * X * PERIOD * (1.0 + 1e-9)
        assert abs(now[1] - last[1]) <= 0.3 * PRETENSION * PERIOD * (1.0 + 1e-9)
        assert X / 1.4 <= now[0] <= X * 1.4
        last = now


def test_reset_returns_to_nominal_at_once() -> None:
    """A reset restores the nominal values immediately."""
    estimator = KalmanEstimator(MODEL, EstimatorSettings(kind="sensor"), PERIOD)
    feed(estimator, Sliding(1.2 * X, PRETENSION, seconds=10.0))
    estimator.reset()
    assert (estimator.friction_angle, estimator.pretension) == (X, PRETENSION)
    assert estimator.state is EstimateState.UNESTIMATED


def test_map_follows_bending_by_its_equations() -> None:
    """x = mu Theta, and T_p changes by EA/l_us (p + d/2) per radian, without delay."""
    estimator = ConfigurationMap(MODEL, EstimatorSettings(kind="map"), PERIOD)
    theta = MODEL.bending_angle + 0.02
    for part in (0.0, 0.5, 1.0):
        estimator.update(Sample(0.0, 0.0, MODEL.bending_angle + 0.02 * part, 0.0, 0.0, True))
    slope = MODEL.axial_stiffness / MODEL.unstrained_length * (MODEL.contact_offset + MODEL.diameter / 2.0)
    assert estimator.friction_angle == pytest.approx(MODEL.friction_coefficient * theta)
    assert estimator.pretension == pytest.approx(PRETENSION + slope * 0.02)
    assert estimator.state is EstimateState.ESTIMATED


def test_map_approaches_a_jump_at_its_rate_and_follows_the_motion_meanwhile() -> None:
    """A jump of the wrap angle is approached at 0.2 of the nominal value per second, and a small motion is followed.

    A jump occurs at a command of a client or at the first value after a gap.
    """
    estimator = ConfigurationMap(MODEL, EstimatorSettings(kind="map", rate=0.2), PERIOD)
    theta, step = MODEL.bending_angle, 0.2 * MODEL.bending_angle * PERIOD
    for value, behind in ((theta, 0.0), (theta + 0.5, 0.5 - step), (theta + 0.53, 0.5 - 2.0 * step)):
        estimator.update(Sample(0.0, 0.0, value, 0.0, 0.0, True))
        assert estimator.friction_angle == pytest.approx(MODEL.friction_coefficient * (value - behind))
    for value in (math.nan, theta + 0.53):
        before = estimator.friction_angle
        estimator.update(Sample(0.0, 0.0, value, 0.0, 0.0, True))
        assert abs(estimator.friction_angle - before) < 1.01 * MODEL.friction_coefficient * step


@pytest.mark.parametrize("theta", [1.7, 10.0, 1e6])
def test_map_stops_at_its_bounds_and_says_so(theta: float) -> None:
    """x and T_p stop at their largest permitted values, and the state is then invalid.

    `theta` is a multiple of the model file's wrap angle.
    """
    settings = EstimatorSettings(kind="map", rate=10.0, bounds=0.6)
    estimator, most = ConfigurationMap(MODEL, settings, PERIOD), ConfigurationMap(MODEL, settings, PERIOD)
    for _ in range(2000):
        estimator.update(Sample(0.0, 0.0, theta * MODEL.bending_angle, 0.0, 0.0, True))
        most.update(Sample(0.0, 0.0, 1.6 * MODEL.bending_angle, 0.0, 0.0, True))
    assert (estimator.friction_angle, estimator.pretension) == (most.friction_angle, most.pretension)
    assert estimator.friction_angle == pytest.approx(1.6 * X)
    assert (estimator.state, most.state) == (EstimateState.INVALID, EstimateState.ESTIMATED)
    estimator.update(Sample(0.0, 0.0, MODEL.bending_angle, 0.0, 0.0, True))
    assert estimator.state is EstimateState.ESTIMATED


@pytest.mark.parametrize("theta", [math.nan, math.inf, -math.inf])
def test_map_without_bending_angle_is_invalid_and_frozen(theta: float) -> None:
    estimator = ConfigurationMap(MODEL, EstimatorSettings(kind="map"), PERIOD)
    estimator.update(Sample(0.0, 0.0, theta, 0.0, 0.0, True))
    assert estimator.state is EstimateState.INVALID
    assert (estimator.friction_angle, estimator.pretension) == (X, PRETENSION)


def test_fixed_keeps_what_the_user_set() -> None:
    """A reset keeps a value that the user has set."""
    estimator = Fixed(MODEL)
    estimator.friction_angle = 0.3
    estimator.reset()
    assert estimator.friction_angle == 0.3


@pytest.mark.parametrize("attribute", list(Attribution))
@pytest.mark.parametrize("at_motor", [True, False])
@pytest.mark.parametrize("factor", [0.75, 1.0, 1.3])
def test_split_inverts_its_half_loop(attribute: Attribution, at_motor: bool, factor: float) -> None:
    """The parameters calculated for a friction torque result in this friction torque."""
    split = Split(MODEL, attribute, at_motor, bounds=0.5)
    wanted = split.nominal * factor
    angle, pretension, inside = split.solve(wanted)
    arm, function = (MODEL.motor_pulley_radius, math.tanh) if at_motor else (MODEL.joint_pulley_radius, math.sinh)
    assert inside
    assert 2.0 * pretension * arm * function(angle) == pytest.approx(wanted, rel=1e-5)


@pytest.mark.parametrize("at_motor", [True, False])
@pytest.mark.parametrize("points", [((0.0, 0.0), (1.0, 1.0)), ((0.0, 1.0), (1.0, 1.0)), S_BENT], ids=str)
def test_split_knows_where_the_sheath_bends(points: Points, at_motor: bool) -> None:
    """For a sheath with much more friction, the friction angle is calculated correctly with its curvature profile.

    The friction torque comes from the capstan equation.
    """
    bent = MODEL.recalibrated(0.8).with_effects({"elongation_coupling": {"curvature_profile": points}})
    pair = Pair(points, 1.0, axial_stiffness=6e3)
    at_rest = pair.joint_torque(0.0, 1.0)
    per_torque = pair.joint_torque(1.0, 1.0) - at_rest
    seen = -at_rest / per_torque if at_motor else -at_rest
    angle, pretension, inside = Split(bent, Attribution.FRICTION, at_motor, bounds=0.5).solve(seen)
    assert inside
    assert (angle, pretension) == pytest.approx((1.0, PRETENSION), rel=1e-5)


@pytest.mark.parametrize("half_loop", [-1.0, 0.0, 1e3])
def test_split_says_when_the_bounds_do_not_reach(half_loop: float) -> None:
    """For a friction torque beyond the bounds, the parameters stay within them and `inside` is False."""
    angle, pretension, inside = Split(MODEL, Attribution.BENDING, False, bounds=0.3).solve(half_loop)
    assert not inside
    assert X / 1.3 - 1e-9 <= angle <= X * 1.3 + 1e-9
    assert pretension >= 0.0


FRICTION, COULOMB, WEIGHT = 0.12, 0.05, 0.6  # N*m*s/rad, N*m, N*m


def with_effect(name: str, load: float) -> tuple[TendonSheath, list[tuple[float, float, float, float, float]]]:
    """Return a model with this effect, and samples (sigma, omega_j, tau_m, tau_j, q_j) measured with it."""
    effects = {
        "viscous_friction": {"coefficient": FRICTION},
        "motor_side_friction": {"coulomb": COULOMB},
        "gravity_load": {"amplitude": WEIGHT, "phase": 0.3},
    }
    samples, angle = [], 0.0
    for sigma, omega, tau_m, tau_j in Sliding(1.2 * X, PRETENSION, seconds=14.0, load=load).samples():
        angle += omega * PERIOD
        if name == "motor_side_friction":
            tau_m += COULOMB * sigma
        if name == "viscous_friction":
            tau_j -= FRICTION * omega
        if name == "gravity_load":
            tau_j -= WEIGHT * math.sin(angle + 0.3)
        samples.append((sigma, omega, tau_m, tau_j, angle))
    return dataclasses.replace(MODEL, effects={name: effects[name]}), samples


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("sensor", "viscous_friction"),
        ("sensor", "motor_side_friction"),
        ("sensor", "gravity_load"),
        ("motor", "viscous_friction"),
    ],
)
def test_what_the_effects_take_is_not_taken_for_the_sheaths(kind: Any, name: str) -> None:
    """With friction or a load outside the sheath that the model contains, x of the sheath is recovered."""
    model, samples = with_effect(name, 0.0 if kind == "motor" else 0.8)
    estimator = KalmanEstimator(model, EstimatorSettings(kind=kind, attribute=Attribution.FRICTION), PERIOD)
    for sigma, omega, tau_m, tau_j, angle in samples:
        if kind == "motor":  # the motor moves the joint against its friction
            tau_m, tau_j = tau_m + R_M / R_J * FRICTION * omega / math.cosh(1.2 * X), math.nan
        estimator.update(Sample(sigma, omega, math.nan, tau_m, tau_j, True, angle))
    assert estimator.state is EstimateState.ESTIMATED
    assert estimator.friction_angle == pytest.approx(1.2 * X, rel=0.02)


def test_effects_that_cannot_be_parted_are_named() -> None:
    effects = {
        "stribeck_friction": {"static_excess": 0.4, "stribeck_velocity": 0.1},
        "viscous_friction": {"coefficient": 0.1},
    }
    assert "stribeck_friction changes the estimated quantity" in unsupported_reason(
        dataclasses.replace(MODEL, effects=effects)
    )
    assert unsupported_reason(dataclasses.replace(MODEL, effects={"viscous_friction": {"coefficient": 0.1}})) == ""
