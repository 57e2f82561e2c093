"""The feedforward law: ideal torque plus a compensated share of the friction term.

    tau_M = tau_J* r_M / r_J  +  c f b (tau_ff - tau_J* r_M / r_J),     |d(second term)/dt| <= slew

tau_ff is the model's exact inverse (3.55) with its effects; c the compensation factor (below 1: over-compensation
oscillates), f the fade-in after every enable, b the oscillation monitor's back-off. The slew limit keeps a reversal
from being a step. The sum stays where both tendons pull, abs(tau_M) < 2 T_p r_M, unless the model knows slack.
"""

from __future__ import annotations

from typing import Annotated, Protocol

import msgspec
from msgspec import Meta


class LawSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[axis.law]."""

    compensation: Annotated[float, Meta(ge=0.0, le=1.2)] = 0.95  # 1, share of the friction term
    slew: Annotated[float, Meta(gt=0.0, le=10_000.0)] = 120.0  # N*m/s, of the friction term at the motor
    fade_in: Annotated[float, Meta(ge=0.0, le=60.0)] = 1.0  # s after every enable


class Inverse(Protocol):
    """The live inverse of a model (`tsa_ctrl.model.feedforward`, or `simplified` where there are no effects)."""

    def update(
        self,
        tau_j_des: float,
        sigma: float,
        omega_j: float,
        q_j: float = ...,
        q_m: float = ...,
        *,
        t: float = ...,
    ) -> float: ...

    def domain_limit(self) -> float: ...

    def reset(self) -> None: ...

    def set(self, friction_angle: float | None = None, pretension: float | None = None) -> None: ...


class Law:
    """One axis' law; `ideal` and `friction_term` are its output's two parts, N*m at the motor."""

    def __init__(self, inverse: Inverse, ratio: float, settings: LawSettings, period: float) -> None:
        """`ratio` is r_M / r_J; `period` in s."""
        self.compensation = settings.compensation
        self.slew = settings.slew
        self.ideal = 0.0
        self.friction_term = 0.0
        self._inverse = inverse
        self._ratio = ratio
        self._period = period
        self._fade = 0.0
        self._fade_step = period / settings.fade_in if settings.fade_in > 0.0 else 1.0

    def reset(self) -> None:
        """Forget everything; the next enable starts uncompensated and fades in."""
        self.ideal = self.friction_term = self._fade = 0.0
        self._inverse.reset()

    def set_parameters(self, friction_angle: float, pretension: float) -> None:
        """Use another friction angle (1) and pretension (N) from now on."""
        self._inverse.set(friction_angle, pretension)

    def update(
        self,
        tau_j_des: float,
        sigma: float,
        omega_j: float,
        q_j: float,
        q_m: float,
        t: float,
        back_off: float,
    ) -> float:
        """Motor torque wanted, N*m; `t` is the time since the enable in s, `back_off` in [0, 1]."""
        ideal = tau_j_des * self._ratio
        fade = self._fade
        if fade < 1.0:
            self._fade = fade = min(1.0, fade + self._fade_step)
        full = self._inverse.update(tau_j_des, sigma, omega_j, q_j, q_m, t=t)
        change = self.compensation * fade * back_off * (full - ideal) - self.friction_term
        step = self.slew * self._period
        if change > step:
            change = step
        elif change < -step:
            change = -step
        self.ideal = ideal
        self.friction_term += change
        wanted = ideal + self.friction_term
        limit = self._inverse.domain_limit()
        return limit if wanted > limit else -limit if wanted < -limit else wanted

    def applied(self, tau_m: float) -> None:
        """Tell the law what was sent; a term that was cut slews on from what was left of it."""
        left = tau_m - self.ideal
        term = self.friction_term
        if (term > 0.0 and left < term) or (term < 0.0 and left > term):
            self.friction_term = 0.0 if left * term < 0.0 else left
