"""One smoother for all commands: about as accurate as the best fixed filter, which requires knowledge of the motion."""

from __future__ import annotations

import numpy as np
import pytest

from tests.identify.smoothing.motions import RATE, fixed_errors, motion, record, squared_errors
from tsa_ctrl.identify.smoothing import smoothed

SECONDS = 12
FILTERS = 56
DRAWS = 2
WORST = 1.1  # times the error of the best fixed filter


def and_soak(values: list[float]) -> list[object]:
    """Return the values as test parameters. The first is always run, and every second one is marked as soak."""
    return [pytest.param(value, marks=[pytest.mark.soak] if place % 2 else []) for place, value in enumerate(values)]


@pytest.mark.slow
@pytest.mark.parametrize("bits", and_soak([8, 12, 16, 20, 24]))
@pytest.mark.parametrize("bandwidth", and_soak([1.0, 3.0, 10.0, 30.0, 100.0]))
@pytest.mark.parametrize("kind", ["tones", "noise"])
def test_it_errs_little_more_than_the_best_fixed_filter(kind: str, bandwidth: float, bits: int) -> None:
    """Position, velocity and acceleration are each compared with their own best of 56 filters.

    Samples close to the ends are excluded: two periods of the bandwidth, and at least 1 s.
    """
    edge = round(RATE * max(1.0, 2.0 / bandwidth))
    fixed, ours = np.zeros((FILTERS, 3)), np.zeros(3)
    for seed in range(DRAWS):
        rng = np.random.default_rng([seed, bits, round(bandwidth)])
        recorded = record(motion(kind, bandwidth, SECONDS if bandwidth < 10.0 else 6, rng), bits, rng)
        fixed += fixed_errors(recorded, edge)
        found = smoothed(recorded.q, 1.0 / RATE)
        ours += squared_errors(recorded, [found.value, found.rate, found.second], edge)
    assert (np.sqrt(ours / fixed.min(axis=0)) < WORST).all()


@pytest.mark.parametrize("bits", [10, 14, 18])
def test_the_error_expected_is_the_error(bits: int) -> None:
    rng = np.random.default_rng(bits)
    recorded = record(motion("noise", 5.0, SECONDS, rng), bits, rng)
    found = smoothed(recorded.q, 1.0 / RATE)
    actual = np.sqrt(squared_errors(recorded, [found.value, found.rate, found.second], 1000))
    assert (np.abs(np.log(np.array(found.errors) / actual)) < np.log(1.5)).all()


def test_noise_beyond_the_rounding_is_seen() -> None:
    """An encoder of 18 bit with noise of ten counts needs a lower cut-off than its resolution alone."""
    rng = np.random.default_rng(1)
    recorded = record(motion("noise", 5.0, SECONDS, rng), 18, rng)
    quiet = smoothed(recorded.q, 1.0 / RATE)
    noisy = np.round((recorded.q + 10.0 * recorded.step * rng.standard_normal(len(recorded.q))) / recorded.step)
    loud = smoothed(noisy * recorded.step, 1.0 / RATE)
    assert quiet.smooth is not None
    assert loud.smooth is not None
    assert loud.smooth.cutoff < 0.8 * quiet.smooth.cutoff
    actual = np.sqrt(squared_errors(recorded, [loud.value, loud.rate, loud.second], 1000))
    assert loud.errors[1] == pytest.approx(actual[1], rel=0.2)


def test_a_noisy_velocity_is_smoothed() -> None:
    rng = np.random.default_rng(2)
    _, velocity, _ = motion("noise", 3.0, SECONDS, rng)
    true = velocity[::20]
    noise = 0.05
    found = smoothed(true + noise * rng.standard_normal(len(true)), 1.0 / RATE, "velocity")
    error = float(np.std((found.value - true)[1000:-1000]))
    assert error < 0.3 * noise
    assert found.errors[0] == pytest.approx(error, rel=0.2)


def test_an_exact_velocity_stays_as_it_is() -> None:
    """The corners of a trapezoid contain frequencies up to half the sampling rate. Smoothing them gains nothing."""
    t = np.arange(8000) / RATE
    velocity = np.clip(3.0 * np.sin(2.0 * t), -1.0, 1.0)
    found = smoothed(velocity, 1.0 / RATE, "velocity")
    np.testing.assert_array_equal(found.value, velocity)


def test_a_log_may_begin_and_end_in_full_motion() -> None:
    t = np.arange(6000) / RATE
    w = 2.0 * np.pi * 1.3
    step = 2.0 * np.pi / 2**16
    q = np.round(np.sin(w * t) / step) * step
    found = smoothed(q, 1.0 / RATE)
    assert np.max(np.abs(found.rate - w * np.cos(w * t))) < 0.02 * w
    assert np.max(np.abs(found.second + w**2 * np.sin(w * t))) < 0.1 * w**2


@pytest.mark.parametrize("values", [np.zeros(500), np.arange(20.0)])
def test_what_never_changes_or_is_short_stays_as_it_is(values: np.ndarray) -> None:  # type: ignore[type-arg]
    found = smoothed(values, 1.0 / RATE)
    assert found.smooth is None
    np.testing.assert_array_equal(found.value, values)


@pytest.mark.parametrize("samples", [1, 3, 5])
def test_noise_that_a_drive_averaged_is_not_taken_for_motion(samples: int) -> None:
    """A mean over a few samples removes the highest frequencies of noise, but not the frequencies of the joint's
    motion.
    """
    rng = np.random.default_rng(samples)
    _, velocity, acceleration = motion("noise", 3.0, SECONDS, rng)
    true, steep = velocity[::20], acceleration[::20]
    noise = 0.05 * np.convolve(rng.standard_normal(len(true)), np.ones(samples) / np.sqrt(samples), mode="same")
    found = smoothed(true + noise, 1.0 / RATE, "velocity")
    assert found.steep is not None
    assert found.steep.cutoff < 30.0
    error = float(np.std((found.rate - steep)[1000:-1000]))
    assert error < 0.1 * float(np.std(steep))
    assert found.errors[1] == pytest.approx(error, rel=0.5)
