"""Direction of sliding, sigma in [-1, 1], from a measured joint velocity.

    sigma = play(omega / (omega_z - omega_h)),  half width omega_h / (omega_z - omega_h),  limited to [-1, 1]

The play operator (mechanical backlash) makes the hysteresis: sigma follows the velocity only when it leaves a band of
+-omega_h around where it was last followed, so noise within the band moves nothing. It is +-1 from +-omega_z
on. Inside the band a slow leak takes sigma to 0, because at standstill friction may act either way.

With a lead L (the model knows the velocity's lag) omega is first taken ahead, omega + L f domega/dt, so that the
friction term turns with the friction and not after it. f is 1 while sliding fast and leaks to 0 after it: nothing is
led at standstill, where noise has a derivative and no direction, nor where the joint trembles by the torque itself.
"""

from __future__ import annotations

import math
from typing import Annotated

import msgspec
from msgspec import Meta

Speed = Annotated[float, Meta(gt=0.0, le=100.0)]  # rad/s; larger is in deg/s
Seconds = Annotated[float, Meta(gt=0.0, le=60.0)]


MOST_LEAD = 0.03  # s; a velocity that is later than that is not predicted but guessed
SURELY = 4.0  # times the zone: only motion faster than this is led through its reversal; a joint that trembles is not
ACCELERATION_TIME = 0.010  # s, low-pass on the derivative of omega_j


class DirectionSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[axis.direction]."""

    zone: Speed = 0.05  # omega_z, rad/s: at this joint speed sigma is +-1
    hysteresis: Speed = 0.01  # omega_h, rad/s: changes of velocity smaller than this move nothing
    release: Seconds = 0.2  # s: time constant with which sigma leaves for 0 at standstill

    def __post_init__(self) -> None:
        check_zone(self.zone, self.hysteresis)


def check_zone(zone: float, hysteresis: float) -> None:
    """Raise ValueError unless the band is narrow enough for the zone to have an inside."""
    if not 0.0 < hysteresis <= zone / 2.0:
        raise ValueError(
            f"hysteresis {hysteresis:g} rad/s does not fit zone {zone:g} rad/s; "
            f"give more than 0 and at most half of the zone"
        )


class Direction:
    """sigma with a linear zone and hysteresis; continuous, and still at standstill."""

    def __init__(self, settings: DirectionSettings, period: float, lead: float = 0.0) -> None:
        """`period` and `lead` in s; the lead is 0 unless the model file says how late the velocity is."""
        self.sigma = 0.0
        self._lead = lead
        self._period = period
        self._gain_of_change = period / (ACCELERATION_TIME + period)
        self._acceleration = self._slid = 0.0
        self._last = math.nan
        self._zone = settings.zone
        self._hysteresis = settings.hysteresis
        self._gain = 1.0 / (self._zone - self._hysteresis)
        self._keep = math.exp(-period / settings.release)

    @property
    def zone(self) -> float:
        """omega_z, rad/s."""
        return self._zone

    @zone.setter
    def zone(self, value: float) -> None:
        """Change the zone; the hysteresis keeps its proportion, so the shape stays."""
        self._hysteresis *= value / self._zone
        self._zone = value
        self._gain = 1.0 / (value - self._hysteresis)

    def reset(self) -> None:
        self.sigma = self._acceleration = self._slid = 0.0
        self._last = math.nan

    def update(self, omega_j: float) -> float:
        """sigma for this cycle; `omega_j` in rad/s (nan: as at standstill)."""
        if self._lead > 0.0:
            omega_j = self._ahead(omega_j)
        if omega_j != omega_j:
            omega_j = 0.0
        low = (omega_j - self._hysteresis) * self._gain
        high = (omega_j + self._hysteresis) * self._gain
        sigma = self.sigma
        if sigma < low:
            sigma = low if low < 1.0 else 1.0
        elif sigma > high:
            sigma = high if high > -1.0 else -1.0
        if low < 0.0 < high:
            sigma = sigma * self._keep if sigma > 1e-6 or sigma < -1e-6 else 0.0
        self.sigma = sigma
        return sigma

    def _ahead(self, omega_j: float) -> float:
        """The velocity that will be a lead later; at standstill the one that is."""
        if self._last == self._last and omega_j == omega_j:
            change = (omega_j - self._last) / self._period
            self._acceleration += self._gain_of_change * (change - self._acceleration)
        else:
            self._acceleration = 0.0
        self._last = omega_j
        fast = SURELY * self._zone
        self._slid = 1.0 if omega_j > fast or omega_j < -fast else self._slid * self._keep
        return omega_j + self._lead * self._slid * self._acceleration
