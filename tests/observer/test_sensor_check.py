"""The joint torque sensor is compared with the tendon elongation: wrong sensors fail, inaccurate ones pass."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tsa_ctrl.observer.joint_torque import SensorCheck

PERIOD, HALF_LOOP = 1e-3, 0.6  # s, N*m
Array = np.ndarray


def outcome(sensor: Array, elongation: Array, omega_j: Array, width: float = 0.1) -> Array:
    """Return for each cycle whether the sensor passes; `width`: half of the elongation's band, N*m."""
    check, passed = SensorCheck(HALF_LOOP, PERIOD, True), []
    for s, e, w in zip(sensor.tolist(), elongation.tolist(), omega_j.tolist(), strict=True):
        check.update(s, e, e - width, e + width, w)
        passed.append(check.passed)
    return np.array(passed)


def strokes(amplitude: float) -> tuple[Array, Array]:
    """Return the torque of a joint that is moved to and fro, and its velocity."""
    t = PERIOD * np.arange(6000)
    omega = np.cos(4.0 * t)
    return amplitude * np.sign(omega) * np.minimum(1.0, 5.0 * np.abs(omega)), omega


@pytest.mark.parametrize("amplitude", [0.1, 0.5])
@pytest.mark.parametrize("wrong", [lambda y: -y, lambda y: 0.0 * y + 0.05], ids=["reversed", "unplugged"])
def test_a_reversed_or_unplugged_sensor_fails_within_a_stroke(
    wrong: Callable[[Array], Array], amplitude: float
) -> None:
    torque, omega = strokes(amplitude)
    assert not outcome(wrong(torque), torque, omega)[2000:].any()


@pytest.mark.parametrize("seed", range(4))
def test_an_inaccurate_sensor_passes(seed: int) -> None:
    """It has an error of gain and zero, noise and a lag. The elongation has the noise of an encoder of 12 bit."""
    rng = np.random.default_rng(seed)
    torque, omega = strokes(0.4)
    lag = int(rng.integers(0, 30))
    sensor = rng.uniform(0.8, 1.2) * np.roll(torque, lag) + rng.uniform(-0.03, 0.03) + 0.01 * rng.standard_normal(6000)
    elongation = rng.uniform(0.8, 1.2) * torque + 0.028 * rng.standard_normal(6000)
    assert outcome(sensor, elongation, omega, 0.2)[lag:].all()


def test_a_sensor_that_shows_less_friction_than_the_elongation_is_used() -> None:
    """A joint is driven forward. More torque at the joint than by the elongation means less friction."""
    moving = np.ones(2000)
    assert outcome(0.3 * moving, 0.0 * moving, moving).all()
    assert not outcome(-0.3 * moving, 0.0 * moving, moving)[500:].any()
    assert outcome(-0.3 * moving, 0.0 * moving, -moving).all()


def test_a_sensor_that_is_plugged_in_again_passes() -> None:
    torque, omega = strokes(0.4)
    sensor = np.where(np.arange(6000) < 3000, 0.0, torque)
    passed = outcome(sensor, torque, omega)
    assert not passed[2000:3000].any()
    assert passed[5000:].all()
