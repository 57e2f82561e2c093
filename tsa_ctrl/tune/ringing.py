"""Ringing of the motor on its tendons after reversals, and the slew of the friction term that does not excite it.

Where friction turns at once with the joint, the motor has to follow by twice the friction term. It is an inertia on a
spring, so a ramp that lasts one period of its ringing leaves it at rest (input shaping, Singer and Seering 1990):
slew = 2 c friction / period. The period is measured: damped sines of one frequency and decay, one amplitude and
phase for each reversal, fitted to what the model leaves of the joint torque once the friction term has turned.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.simplified import SimplifiedFeedforward

FloatArray = NDArray[np.float64]

SETTLE = 0.004  # s after the friction term has turned: the velocity's lag
WINDOW = 0.08  # s of ringing after each reversal
FEWEST = 4  # reversals
LOWEST = 20.0  # Hz; slower is no ringing but the motion's own
HIGHEST = 0.25  # of the sample rate
STEP = 0.5  # Hz between the frequencies that are tried
DECAYS = (0.0, 10.0, 20.0, 40.0, 80.0)  # 1/s, tried with each
LEAST_SHARE = 0.5  # of the variance in the windows that the ringing must explain


@dataclass(frozen=True)
class Turn:
    """How fast the friction term turns: `before` and `slew` in N*m/s at the motor, the ringing in Hz.

    `rms_before` and `rms_after` are the RMS joint torque errors (N*m) of one motion with either slew.
    """

    before: float
    slew: float
    ringing: Quantity
    rms_before: float
    rms_after: float

    @property
    def better(self) -> bool:
        return self.rms_after < self.rms_before

    @property
    def note(self) -> str:
        """In words, for people."""
        return (
            f"after reversals the motor rings on its tendons at {self.ringing.value:.4g} Hz; a friction term that "
            f"turns within one period of it (slew {self.slew:g} instead of {self.before:g} N*m/s) leaves "
            f"{1e3 * self.rms_after:.1f} instead of {1e3 * self.rms_before:.1f} mN*m of the same motion: "
            f"{'taken' if self.better else 'not taken'}"
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return {
            "slew": {"before": self.before, **self.interval().to_dict()},
            "ringing": self.ringing.to_dict(),
            "rms": {"before": self.rms_before, "after": self.rms_after, "unit": "N*m"},
        }

    def interval(self) -> Quantity:
        """The slew with the interval that the ringing's gives it."""
        scale = self.slew / self.ringing.value
        return Quantity(self.slew, scale * self.ringing.low, scale * self.ringing.high, "N*m/s")


def turn_of(model: TendonSheath, compensation: float) -> float:
    """By how much the friction term at the motor turns at a reversal, N*m."""
    return 2.0 * compensation * SimplifiedFeedforward(model).update(0.0, 1.0, 0.0)


def slew_without_ringing(turn: float, ringing: float, most: float) -> float:
    """Slew (N*m/s, three digits) that turns by `turn` N*m within one period of `ringing` Hz, at most `most`."""
    return float(f"{min(turn * ringing, most):.3g}")


def ringing(logs: Sequence[Dataset], model: TendonSheath, ramp: float) -> Quantity | None:
    """Frequency (Hz) of the ringing after reversals, or None when there is none; `ramp`: s in which friction turns.

    The interval comes from leaving out reversals; it is never narrower than the steps of the search.
    """
    windows = [window for log in logs for window in _windows(log, model, 0.5 * ramp + SETTLE)]
    if len(windows) < FEWEST:
        return None
    period = logs[0].period
    frequencies = np.arange(LOWEST, HIGHEST / period, STEP)
    left = np.array([[_left(windows, f, d, period) for f in frequencies] for d in DECAYS])  # (decays, f, windows)
    total = left.sum(axis=2)
    decay, best = np.unravel_index(int(np.argmin(total)), total.shape)
    whole = sum(float(np.sum(np.square(window))) for window in windows)
    if best in (0, frequencies.size - 1) or total[decay, best] > (1.0 - LEAST_SHARE) * whole:
        return None
    without = frequencies[np.argmin(total[decay][:, None] - left[decay], axis=0)]
    count = without.size
    deviation = math.sqrt((count - 1) / count * float(np.sum(np.square(without - without.mean()))))
    half = max(STEP, float(stats.t.ppf(0.975, count - 1)) * deviation)
    value = float(frequencies[best])
    return Quantity(value, value - half, value + half, "Hz")


def _windows(log: Dataset, model: TendonSheath, settle: float) -> list[FloatArray]:
    """What the model leaves of the joint torque (N*m) after each reversal, without its straight line."""
    error = log["tau_j"] - predict(model, log.signals())
    forward = log["omega_j"] > 0.0
    reversals = np.flatnonzero(forward[1:] != forward[:-1]) + 1
    first, count = round(settle / log.period), round(WINDOW / log.period)
    line = _line(count)
    found = []
    for place, after in zip(reversals, [*reversals[1:], error.size], strict=True):
        if place + first + count <= after:
            part = error[place + first : place + first + count]
            found.append(part - line @ (line.T @ part))
    return found


def _left(windows: Sequence[FloatArray], frequency: float, decay: float, period: float) -> FloatArray:
    """Sum of squares (m) that a damped sine leaves of each window."""
    count = windows[0].size
    t = period * np.arange(count)
    wave = np.exp(-decay * t)[:, None] * np.column_stack([np.cos(w := 2.0 * np.pi * frequency * t), np.sin(w)])
    line = _line(count)
    basis, _ = np.linalg.qr(wave - line @ (line.T @ wave))
    many = np.array(windows)
    squares: FloatArray = np.sum(np.square(many), axis=1) - np.sum(np.square(many @ basis), axis=1)
    return squares


def _line(count: int) -> FloatArray:
    """Orthonormal basis (count, 2) of the straight lines."""
    basis: FloatArray = np.linalg.qr(np.column_stack([np.ones(count), np.arange(count)]))[0]
    return basis
