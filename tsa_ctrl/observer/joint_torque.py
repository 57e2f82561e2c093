"""What is known of one axis' joint torque without its sensor, and whether that sensor agrees."""

from __future__ import annotations

import math
from typing import Protocol

from tsa_ctrl.observer.by_model import ModelTorque
from tsa_ctrl.observer.stretch import StretchObserver, StretchState

MEMORY = 2.0  # s over which sensor and stretch are compared: a turn or two, so that no reversal alone speaks
SENSOR = 0.03  # 1, of its torque, that a sound joint torque sensor may be off itself, beside the band
OFTEN, SELDOM = 0.5, 0.2  # of the samples outside the band: told above, told again only after it was below


class Measured(Protocol):
    """The image of an axis, as far as it is needed here; SI, nan where there is nothing."""

    @property
    def tau_m(self) -> float: ...

    @property
    def omega_m(self) -> float: ...

    @property
    def q_m(self) -> float: ...

    @property
    def q_j(self) -> float: ...

    @property
    def fresh(self) -> bool: ...


class JointTorque:
    """`stretch` (None on a rig that cannot have it; `why_not` says it) and `model`, N*m at the joint."""

    def __init__(self, model: ModelTorque, stretch: StretchObserver | None, why_not: str, period: float) -> None:
        """`period` in s."""
        self.model = model
        self.stretch = stretch
        self.why_not = why_not
        self.contradicted = False  # the joint torque sensor lies outside the stretch's band most of the time
        self.difference = 0.0  # N*m, of sensor less stretch, over the last seconds
        self._forget = period / MEMORY
        self._outside = 0.0

    @property
    def torque(self) -> tuple[float, float, float]:
        """By stretch: torque and the ends of its 95 % band, N*m; nan where there is none."""
        stretch = self.stretch
        return (math.nan, math.nan, math.nan) if stretch is None else (stretch.torque, stretch.low, stretch.high)

    def reset(self) -> None:
        """The encoders begin anew: nothing that was learned of them holds."""
        self.model.reset()
        if self.stretch is not None:
            self.stretch.reset()
        self._outside = self.difference = 0.0

    def set_parameters(self, friction_angle: float, pretension: float) -> None:
        """Use another friction angle (1) and pretension (N); the stretch takes the pretension, and finds its own x."""
        self.model.set_parameters(friction_angle, pretension)
        if self.stretch is not None:
            self.stretch.set_pretension(pretension)

    def pass_over(self, periods: int) -> None:
        """So many periods had no cycle."""
        if self.stretch is not None:
            self.stretch.pass_over(periods)

    def update(self, image: Measured, omega_j: float, tau_j: float) -> None:
        """One cycle: what drive and encoder say, the joint's velocity (rad/s), the sensor's torque (N*m or nan)."""
        tau_m, omega_m, fresh = image.tau_m, image.omega_m, image.fresh
        self.model.update(tau_m, omega_m, omega_j, fresh)
        stretch = self.stretch
        if stretch is None:
            return
        stretch.update(tau_m, omega_m, image.q_m, image.q_j, fresh)
        if tau_j == tau_j and stretch.state is StretchState.TOLD and fresh:
            forget = self._forget
            self.difference += forget * (tau_j - stretch.torque - self.difference)
            room = SENSOR * abs(tau_j)
            agrees = stretch.low - room <= tau_j <= stretch.high + room
            self._outside += forget * ((0.0 if agrees else 1.0) - self._outside)
            if self._outside > OFTEN:
                self.contradicted = True
            elif self._outside < SELDOM:
                self.contradicted = False
