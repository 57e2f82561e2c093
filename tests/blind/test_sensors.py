"""Test that the instrument models add the specified errors and no lag."""

from __future__ import annotations

import numpy as np
import pytest

from . import memory, sensors


@pytest.mark.parametrize("seed", range(5))
def test_noise_has_unit_rms_and_colour(seed: int) -> None:
    """The RMS is 1, and neighbouring samples are correlated, so the noise is not white."""
    noise = sensors.coloured_noise(np.random.default_rng(seed), 20000, 500.0)
    assert np.std(noise) == pytest.approx(1.0, abs=1e-9)
    assert np.corrcoef(noise[1:], noise[:-1])[0, 1] > 0.02


def test_encoder_is_off_by_half_a_count() -> None:
    angle = np.linspace(-1.0, 1.0, 10001)
    count = 2.0 * np.pi / 4096
    assert np.max(np.abs(sensors.encoder(np.random.default_rng(0), angle, 4096, 0.0) - angle)) <= 0.5 * count + 1e-12


def test_differenced_velocity_is_centred() -> None:
    """The velocity from encoder counts has no lag: its sign changes within one sample of the true reversal."""
    step = 2.5e-4
    t = np.arange(0.0, 2.0, step)
    omega = sensors.differenced(np.sin(2.0 * np.pi * t), step, 0.01)
    turns = t[np.flatnonzero(np.diff(memory.direction(omega)))]
    np.testing.assert_allclose(turns, [0.25, 0.75, 1.25, 1.75], atol=step)


@pytest.mark.parametrize("smooth", [1, 3, 5])
def test_tachometer_noise_is_as_large_as_asked(smooth: int) -> None:
    omega = sensors.tachometer(np.random.default_rng(1), np.zeros(50000), 0.01, smooth)
    assert np.std(omega) == pytest.approx(0.01, rel=0.05)
