"""Watches for the limit cycle that over-compensated friction makes, and backs the compensation off.

The joint velocity is split by Butterworth filters of second order. Oscillating means: the part between 1.5 and 15 Hz is
faster than `speed` (RMS), carries most of the motion, and the set-point's slope has no such share of that band to
explain it; all that for `duration`. Each time the back-off halves (or what `share` says); it never recovers by itself.
"""

from __future__ import annotations

import math
from typing import Annotated

import msgspec
from msgspec import Meta

LOWEST, HIGHEST = 1.5, 15.0  # Hz, the band of limit cycles of a limb on a compensated sheath
MEMORY = 0.4  # s, time constant of the powers
MOSTLY = 0.5  # share of the motion's power in the band from which it counts as oscillation
EXPLAINED = 0.3  # the velocity's share must exceed the set-point's by this
STEP = 0.004  # s, the filters run on means over blocks of about this length


class OscillationSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[axis.oscillation]: from what joint speed on, and for how long, a swing counts; what then remains."""

    speed: Annotated[float, Meta(gt=0.0, le=100.0)] = 0.5  # rad/s RMS of the joint in 1.5-15 Hz
    duration: Annotated[float, Meta(gt=0.0, le=60.0)] = 1.0  # s
    share: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.5  # 1, what is left of the compensation each time


class OscillationMonitor:
    """`back_off` multiplies the compensation factor; 1 until the first oscillation, `reset` makes it 1 again."""

    def __init__(self, settings: OscillationSettings, period: float) -> None:
        self.back_off = 1.0
        self.count = 0
        self._blocks = max(1, round(STEP / period))
        step = self._blocks * period
        self._threshold = settings.speed * settings.speed
        self._share = settings.share
        self._duration = settings.duration
        self._step = step
        self._forget = 1.0 - math.exp(-step / MEMORY)
        self._velocity = _Band(step)
        self._slope = _Band(step)
        self._restart()

    def _restart(self) -> None:
        self._velocity.reset()
        self._slope.reset()
        self._sum = 0.0
        self._in_block = 0
        self._set_point = self._since = 0.0

    def reset(self) -> None:
        self.back_off = 1.0
        self._restart()

    def update(self, omega_j: float, tau_j_des: float) -> float:
        """`back_off` after this cycle's joint velocity (rad/s) and set-point (N*m)."""
        self._sum += omega_j
        self._in_block += 1
        if self._in_block == self._blocks:
            self._judge(self._sum / self._blocks, (tau_j_des - self._set_point) / self._step)
            self._set_point = tau_j_des
            self._sum = 0.0
            self._in_block = 0
        return self.back_off

    def _judge(self, omega: float, slope: float) -> None:
        if not math.isfinite(omega + slope):
            self._restart()
            return
        velocity, wanted = self._velocity, self._slope
        velocity.update(omega, self._forget)
        wanted.update(slope, self._forget)
        share = velocity.share
        if velocity.inside > self._threshold and share > MOSTLY and share - wanted.share > EXPLAINED:
            self._since += self._step
            if self._since >= self._duration:
                self.back_off *= self._share
                self.count += 1
                self._since = 0.0
        else:
            self._since = 0.0


class _Band:
    """Power of a signal in the band and in all, exponentially forgotten."""

    def __init__(self, step: float) -> None:
        self._high = _butterworth(LOWEST, step, high_pass=True)
        self._low = _butterworth(HIGHEST, step, high_pass=False)
        self.reset()

    def reset(self) -> None:
        self.inside = self.all = 0.0
        self._h1 = self._h2 = self._l1 = self._l2 = 0.0

    @property
    def share(self) -> float:
        return self.inside / self.all if self.all > 0.0 else 0.0

    def update(self, value: float, forget: float) -> None:
        b0, b1, b2, a1, a2 = self._high
        y = b0 * value + self._h1
        self._h1 = b1 * value - a1 * y + self._h2
        self._h2 = b2 * value - a2 * y
        b0, b1, b2, a1, a2 = self._low
        z = b0 * y + self._l1
        self._l1 = b1 * y - a1 * z + self._l2
        self._l2 = b2 * y - a2 * z
        self.inside += forget * (z * z - self.inside)
        self.all += forget * (value * value - self.all)


def _butterworth(corner: float, step: float, high_pass: bool) -> tuple[float, float, float, float, float]:
    """b0, b1, b2, a1, a2 of a bilinear Butterworth filter of second order, corner in Hz pre-warped."""
    k = math.tan(math.pi * min(corner, 0.45 / step) * step)
    norm = 1.0 / (1.0 + math.sqrt(2.0) * k + k * k)
    b0, b1 = (norm, -2.0 * norm) if high_pass else (k * k * norm, 2.0 * k * k * norm)
    return b0, b1, b0, 2.0 * (k * k - 1.0) * norm, (1.0 - math.sqrt(2.0) * k + k * k) * norm
