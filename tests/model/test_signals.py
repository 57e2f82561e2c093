"""Columns, direction at standstill, and zero-phase derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.signals import Signals, hold_direction, low_pass, zero_phase_derivative

T = np.arange(5000) / 1000.0


def test_columns_of_unequal_length_are_refused() -> None:
    """The error contains the name of the column."""
    with pytest.raises(UsageError, match="'q_j' has shape"):
        Signals(t=T, tau_m=T, omega_j=T, q_j=T[1:])


def test_empty_log_is_refused() -> None:
    """A log without samples cannot be predicted."""
    with pytest.raises(UsageError, match="no samples"):
        Signals(t=T[:0], tau_m=T[:0], omega_j=T[:0])


@pytest.mark.parametrize(
    ("omega", "sigma"),
    [
        ([1.0, -2.0], [1, -1]),
        ([1.0, 0.0, 0.0, -1.0, 0.0], [1, 1, 1, -1, -1]),
        ([0.0, 0.0, -1.0, 0.0], [-1, -1, -1, -1]),
        ([0.0, 0.0], [0, 0]),
        ([-0.0, 3.0], [1, 1]),
    ],
)
def test_direction_is_held_at_standstill(omega: list[float], sigma: list[int]) -> None:
    """The last non-zero sign is kept. Before the first motion, the first sign is used."""
    np.testing.assert_array_equal(hold_direction(np.array(omega)), sigma)


def test_derivative_of_a_sine_has_no_phase() -> None:
    """At 1 Hz and away from the ends, the error is at most 2e-4 rad/s, without a phase."""
    w = 2.0 * np.pi
    found = zero_phase_derivative(np.sin(w * T), 1e-3)
    np.testing.assert_allclose(found[200:-200], w * np.cos(w * T)[200:-200], atol=2e-4)


def test_derivative_of_a_line_is_exact_to_its_ends() -> None:
    """The signal is extended by a mirror image about its end values."""
    np.testing.assert_allclose(zero_phase_derivative(3.0 + 2.0 * T, 1e-3), 2.0, rtol=1e-9)


@pytest.mark.parametrize(("frequency", "gain"), [(5.0, 256 / 257), (20.0, 0.5), (40.0, 1 / 17), (80.0, 1 / 257)])
def test_low_pass_gain(frequency: float, gain: float) -> None:
    """The gain is 1/(1 + (f/20 Hz)^4)."""
    tone = np.sin(2.0 * np.pi * frequency * T)
    filtered = low_pass(tone, 1e-3)
    assert 2.0 * np.mean(filtered[1000:4000] * tone[1000:4000]) == pytest.approx(gain, rel=1e-3)


def test_slow_logs_are_filtered_at_a_fifth_of_their_rate() -> None:
    """A cut-off above the Nyquist frequency would have no effect."""
    slow = np.sin(np.arange(400) * 0.3)
    np.testing.assert_allclose(low_pass(slow, 0.1, 20.0), low_pass(slow, 0.1, 2.0))


def test_short_log_is_left_alone() -> None:
    """The log has fewer samples than the filter needs to settle."""
    few = np.random.default_rng(0).normal(size=20)
    np.testing.assert_array_equal(low_pass(few, 1e-3), few)


def test_single_sample_has_no_derivative() -> None:
    """The derivative is 0 instead of an error."""
    np.testing.assert_array_equal(zero_phase_derivative(np.array([3.0]), 1.0), [0.0])
