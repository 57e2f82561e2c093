"""Test that the states with memory agree with their closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from . import memory


def test_bristle_relaxes_exponentially_over_distance() -> None:
    """The Dahl state that starts at -1 is z = 1 - 2 exp(-s / q_p), for any step sizes."""
    s = np.sort(np.random.default_rng(0).uniform(0.0, 0.5, 400))
    s[0] = 0.0
    np.testing.assert_allclose(memory.bristle(s, 0.07, -1.0), 1.0 - 2.0 * np.exp(-s / 0.07), atol=1e-12)


def test_bristle_turns_with_the_motion() -> None:
    """For a motion forward by a and back by b, the state agrees with the closed forms joined at the reversal."""
    a, b, q_p = 0.1, 0.04, 0.05
    s = np.concatenate([np.linspace(0.0, a, 50), np.linspace(a, a - b, 50)])
    top = 1.0 - np.exp(-a / q_p)
    assert memory.bristle(s, q_p, 0.0)[-1] == pytest.approx(-1.0 + (1.0 + top) * np.exp(-b / q_p), rel=1e-12)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_slip_elements_saturate_one_after_the_other(count: int) -> None:
    """From rest, element i saturates after q_p i / N, so the mean state is the mean of clipped ramps."""
    s = np.linspace(0.0, 0.12, 1000)
    expected = np.mean([np.minimum(s / (0.1 * (i + 1) / count), 1.0) for i in range(count)], axis=0)
    np.testing.assert_allclose(memory.slip_elements(s, 0.1, count, 0.0), expected, atol=1e-12)


def test_presliding_does_not_depend_on_time() -> None:
    """The same path at a tenth of the speed results in the same states."""
    path = 0.3 * np.sin(np.linspace(0.0, 20.0, 501))
    slow = np.repeat(path, 10)
    np.testing.assert_allclose(memory.bristle(slow, 0.05, 0.0)[::10], memory.bristle(path, 0.05, 0.0), atol=1e-12)


def test_direction_holds_at_standstill() -> None:
    """At zero velocity the last sign is kept. Before the first motion, the first sign is used."""
    omega = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 2.0, 0.0, -0.1])
    np.testing.assert_array_equal(memory.direction(omega), [-1, -1, -1, -1, -1, 1, 1, -1])


def test_play_opens_after_each_reversal() -> None:
    """After a reversal, `engaged` is 0 until the joint has moved by the gap."""
    q = np.concatenate([np.linspace(0.0, 1.0, 1001), np.linspace(1.0, 0.0, 1001)[1:]])
    sigma = memory.direction(np.gradient(q))
    open_ = memory.engaged(q, sigma, 0.1005, 0) == 0.0
    assert not open_[:1000].any()
    moved = 1.0 - q[1001:]
    np.testing.assert_array_equal(open_[1001:], moved < 0.1005)


def test_lag_of_a_ramp_is_the_time_constant() -> None:
    """The output of 1/(1 + T s) lags a ramp by T, and adding T times its slope removes the lag."""
    step, lag = 1e-3, 0.05
    t = np.arange(0.0, 1.0, step)
    out = memory.first_order_lag(3.0 * t, step, lag)
    expected = 3.0 * (t - lag * (1.0 - np.exp(-t / lag)))
    np.testing.assert_allclose(out, expected, atol=1e-12)
    np.testing.assert_allclose((out + lag * np.gradient(out, step))[5:-5], 3.0 * t[5:-5], atol=1e-4)


def test_rest_is_timed_until_the_next_rest() -> None:
    omega = np.array([1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 1.0])
    np.testing.assert_allclose(memory.rest_time(omega, 0.5, 0.1), [0, 0, 0, 0, 1.5, 1.5, 1.5, 0.5])
