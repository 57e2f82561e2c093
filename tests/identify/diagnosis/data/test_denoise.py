"""Residual noise of a smoothed velocity.

It equals the reported noise for every averaging of the drive, and it is larger at the ends of a log.
"""

from __future__ import annotations

import numpy as np
import pytest

from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.diagnosis.data.denoise import denoised
from tsa_ctrl.model.functions import Array

NOISE = 0.012  # rad/s, of a tachometer


def _recorded(rng: np.random.Generator, rate: float, mean: int) -> tuple[Dataset, Array]:
    """Return a log of 20 s and its true velocity (rad/s).

    The motion is slow. The tachometer averages `mean` samples.
    """
    t = np.arange(round(20.0 * rate)) / rate
    true = 0.15 * np.sin(0.9 * t + rng.uniform(0.0, 6.0)) + 0.05 * np.sin(2.3 * t + rng.uniform(0.0, 6.0))
    eta = np.convolve(rng.standard_normal(len(t) + mean - 1), np.ones(mean) / np.sqrt(mean), mode="valid")
    columns = {"t": t, "tau_m": np.sin(t), "tau_j": np.sin(t), "omega_j": true + NOISE * eta}
    return Dataset.from_arrays(columns), true


@pytest.mark.parametrize("rate", [200.0, 250.0, 500.0])
@pytest.mark.parametrize("mean", [1, 3, 5])
def test_the_noise_that_is_left_is_as_large_as_it_is_told(rate: float, mean: int) -> None:
    """Regression test: a mean of five samples was once reported with 2.2 times too little noise.

    At 200 Hz this mean has a zero at 40 Hz, and most of its noise lies below 18 Hz.
    """
    rng = np.random.default_rng([int(rate), mean])
    ratios = []
    for _ in range(6):
        log, true = _recorded(rng, rate, mean)
        signals, told, _ = denoised(log)
        # where the sign of a velocity is certain, the velocity is the output of the low-pass
        moving = np.abs(true) > 5.0 * NOISE
        ratios.append(float(np.sqrt(np.mean((signals.omega_j - true)[moving] ** 2))) / told)
    assert 0.75 < np.mean(ratios) < 1.1


def test_the_ends_of_a_log_are_known_less() -> None:
    """A low-pass extrapolates a log at both ends, and the noise of the first and last samples remains."""
    rng = np.random.default_rng(5)
    off, told = [], []
    for _ in range(60):
        log, true = _recorded(rng, 500.0, 1)
        signals, _, error = denoised(log)
        off.append((signals.omega_j - true)[[0, 10, 500, -500, -1]])
        told.append(error[[0, 10, 500, -500, -1]])
    within = np.mean(np.abs(off) < 1.96 * np.asarray(told), axis=0)
    assert np.all(within > 0.85)
    assert np.mean(told, axis=0)[0] > 3.0 * np.mean(told, axis=0)[2]
