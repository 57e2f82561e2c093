"""The oscillation monitor: backs off for a limit cycle, not for the motion that was asked for."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tsa_ctrl.control.oscillation import OscillationMonitor, OscillationSettings

PERIOD = 1e-3


def watch(omega: np.ndarray, tau: np.ndarray, settings: OscillationSettings | None = None) -> OscillationMonitor:
    monitor = OscillationMonitor(settings or OscillationSettings(), PERIOD)
    for velocity, set_point in zip(omega.tolist(), tau.tolist(), strict=True):
        monitor.update(velocity, set_point)
    return monitor


def times(seconds: float) -> np.ndarray:
    return np.arange(0.0, seconds, PERIOD)


@pytest.mark.parametrize("frequency", [2.5, 5.0, 8.0, 12.0])
def test_limit_cycle_at_a_constant_set_point_backs_off(frequency: float) -> None:
    """Oscillation of the joint that no set-point explains halves the compensation, again and again."""
    t = times(6.0)
    monitor = watch(2.0 * np.sin(2.0 * math.pi * frequency * t), np.full_like(t, 0.5))
    assert monitor.count >= 2
    assert monitor.back_off == 0.5**monitor.count


@pytest.mark.parametrize("frequency", [0.2, 0.5, 1.0, 2.0, 4.0])
def test_wanted_motion_is_left_alone(frequency: float) -> None:
    """A joint that moves as its set-point does is not oscillating, at any frequency."""
    t = times(10.0)
    phase = 2.0 * math.pi * frequency * t
    assert watch(3.0 * np.cos(phase), np.sin(phase)).back_off == 1.0


def test_slow_motion_imposed_from_outside_is_left_alone() -> None:
    """A limb swung at 0.7 Hz against a constant set-point is not oscillating."""
    t = times(10.0)
    assert watch(3.0 * np.sin(2.0 * math.pi * 0.7 * t), np.full_like(t, 0.5)).back_off == 1.0


def test_noise_is_left_alone() -> None:
    """White velocity noise has most of its power above the band."""
    noise = np.random.default_rng(4).normal(0.0, 1.0, 10_000)
    assert watch(noise, np.zeros_like(noise)).back_off == 1.0


def test_small_tremor_is_left_alone() -> None:
    """Slower than the threshold speed is no oscillation."""
    t = times(6.0)
    assert watch(0.5 * np.sin(2.0 * math.pi * 5.0 * t), np.zeros_like(t)).back_off == 1.0


def test_short_ringing_is_left_alone() -> None:
    """Oscillation that dies out within the duration is no limit cycle."""
    t = times(6.0)
    ringing = 4.0 * np.exp(-t / 0.2) * np.sin(2.0 * math.pi * 5.0 * t)
    assert watch(ringing, np.zeros_like(t)).back_off == 1.0


def test_never_recovers_by_itself_but_by_reset() -> None:
    """Quiet afterwards does not bring the compensation back; reset does."""
    t = times(3.0)
    monitor = watch(2.0 * np.sin(2.0 * math.pi * 6.0 * t), np.zeros_like(t))
    for _ in range(2_000):
        monitor.update(0.0, 0.0)
    left = monitor.back_off
    assert left < 1.0
    for _ in range(20_000):
        monitor.update(0.0, 0.0)
    assert monitor.back_off == left
    monitor.reset()
    assert monitor.back_off == 1.0


def test_missing_velocity_neither_trips_nor_sticks() -> None:
    """nan starts the watch again; oscillation afterwards is still seen."""
    t = times(4.0)
    omega = 2.0 * np.sin(2.0 * math.pi * 6.0 * t)
    omega[1000] = math.nan
    assert watch(omega, np.zeros_like(t)).count >= 1
