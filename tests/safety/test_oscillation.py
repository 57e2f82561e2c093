"""The oscillation monitor: backs off for a limit cycle, not for the motion that was asked for."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from scipy.signal import butter, lfilter

from tsa_ctrl.safety.oscillation import OscillationMonitor, OscillationSettings

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


class Reference:
    """The rule once more, from the text alone: scipy's filters, floating means, and the numbers written out."""

    def __init__(self, settings: OscillationSettings, period: float) -> None:
        self.settings = settings
        self.blocks = max(1, round(0.004 / period))
        self.step = self.blocks * period
        rate = 1.0 / self.step
        low, high = (min(corner, 0.45 * rate) for corner in (1.5, 15.0))
        self.high_pass = butter(2, low, "highpass", fs=rate)
        self.low_pass = butter(2, high, "lowpass", fs=rate)

    def back_offs(self, omega: np.ndarray, tau: np.ndarray) -> list[float]:
        """After each block, for as many whole blocks as there are."""
        count = len(omega) // self.blocks
        velocity = omega[: count * self.blocks].reshape(count, self.blocks).mean(axis=1)
        slope = np.diff(tau[self.blocks - 1 :: self.blocks][:count], prepend=0.0) / self.step
        inside, share = self._powers(velocity)
        _, wanted = self._powers(slope)
        self.inside, self.wanted = inside.tolist(), wanted.tolist()
        back_off, since, found = 1.0, 0.0, []
        for n in range(count):
            oscillating = inside[n] > self.settings.speed**2 and share[n] > 0.5 and share[n] - wanted[n] > 0.3
            since = since + self.step if oscillating else 0.0
            if since >= self.settings.duration:
                back_off, since = back_off * self.settings.share, 0.0
            found.append(back_off)
        return found

    def _powers(self, signal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        keep = np.exp(-self.step / 0.4)
        band = lfilter(*self.low_pass, lfilter(*self.high_pass, signal))
        inside, whole = (lfilter([1.0 - keep], [1.0, -keep], part**2) for part in (band, signal))
        return inside, np.divide(inside, whole, out=np.zeros_like(inside), where=whole > 0.0)


def rich_signal(seed: int, seconds: float, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Oscillation that comes and goes, sweeps through the band, beside slow motion, noise and a set-point like it."""
    draw = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, period)
    sweep = np.exp(np.interp(t, np.linspace(0.0, seconds, 7), np.log(draw.uniform(0.8, 18.0, 7))))
    phase = 2.0 * math.pi * np.cumsum(sweep) * period

    def size(most: float) -> np.ndarray:
        return np.interp(t, np.linspace(0.0, seconds, 9), draw.uniform(0.0, most, 9))

    slow = np.sin(2.0 * math.pi * draw.uniform(0.2, 1.4) * t)
    omega = size(5.0) * np.sin(phase) + size(1.5) * slow + draw.normal(0.0, 0.2, len(t))
    tau = size(0.02) * np.cos(phase) + size(0.5) * slow
    return omega, tau


@pytest.mark.parametrize("period", [1e-3, 2.0**-8, 5e-2])
@pytest.mark.parametrize("seed", range(4))
def test_agrees_with_the_rule_written_in_another_way(seed: int, period: float) -> None:
    """Block for block, over signals that cross every threshold many times."""
    settings = OscillationSettings(speed=(0.2, 0.5, 0.9)[seed % 3], duration=(0.125, 0.25)[seed % 2], share=0.9)
    omega, tau = rich_signal(seed, 15.0, period)
    monitor = OscillationMonitor(settings, period)
    reference = Reference(settings, period)
    found, inside, share = [], [], []
    for pair in zip(omega.tolist(), tau.tolist(), strict=True):
        found.append(monitor.update(*pair))
        inside.append(monitor._velocity.inside)
        share.append(monitor._slope.share)
    blocks = slice(reference.blocks - 1, None, reference.blocks)
    expected = reference.back_offs(omega, tau)
    assert inside[blocks] == pytest.approx(reference.inside, rel=1e-6, abs=1e-12)
    assert share[blocks] == pytest.approx(reference.wanted, rel=1e-6, abs=1e-12)
    assert found[blocks] == pytest.approx(expected, rel=1e-9)
    assert expected[-1] < 1.0


def test_reset_forgets_an_oscillation_that_was_being_watched() -> None:
    """The duration begins anew, and so do the filters."""
    t = times(3.0)
    omega = 2.0 * np.sin(2.0 * math.pi * 6.0 * t)
    fresh = OscillationMonitor(OscillationSettings(), PERIOD)
    used = OscillationMonitor(OscillationSettings(), PERIOD)
    for velocity in omega[:902].tolist():
        used.update(velocity, 0.3)
    used.reset()
    assert [used.update(v, 0.0) for v in omega.tolist()] == [fresh.update(v, 0.0) for v in omega.tolist()]


def test_reset_forgets_a_set_point_that_explained_an_oscillation() -> None:
    """What swings after it is judged by the set-point after it."""
    t = times(3.0)
    omega = 2.0 * np.sin(2.0 * math.pi * 6.0 * t)
    monitor = OscillationMonitor(OscillationSettings(), PERIOD)
    for velocity in omega.tolist():
        assert monitor.update(velocity, velocity) == 1.0  # explained
    monitor.reset()
    for velocity in omega.tolist():
        monitor.update(velocity, 0.0)
    assert monitor.back_off < 1.0


def test_what_is_not_finite_begins_the_watch_anew() -> None:
    """Neither filters nor duration go on over it."""
    omega = (2.0 * np.sin(2.0 * math.pi * 6.0 * times(3.0))).tolist()
    fresh = OscillationMonitor(OscillationSettings(), PERIOD)
    used = OscillationMonitor(OscillationSettings(), PERIOD)
    for velocity in [*omega[:900], *[math.nan] * 4]:  # whole blocks
        used.update(velocity, 0.0)
    assert used.back_off == 1.0
    assert [used.update(v, 0.0) for v in omega] == [fresh.update(v, 0.0) for v in omega]


def test_defaults() -> None:
    """What holds when the file says nothing."""
    settings = OscillationSettings()
    assert (settings.speed, settings.duration, settings.share) == (0.5, 1.0, 0.5)


@pytest.mark.parametrize(
    ("key", "good", "bad"),
    [
        ("speed", (1e-6, 100.0), (0.0, 100.001)),
        ("duration", (1e-6, 60.0), (0.0, 60.001)),
        ("share", (0.0, 0.999), (-1e-6, 1.0)),
    ],
)
def test_settings_are_bounded_from_both_sides(key: str, good: tuple[float, ...], bad: tuple[float, ...]) -> None:
    """A share of 1 would back off nothing."""
    for value in good:
        assert getattr(msgspec.convert({key: value}, OscillationSettings), key) == value
    for value in bad:
        with pytest.raises(msgspec.ValidationError):
            msgspec.convert({key: value}, OscillationSettings)
