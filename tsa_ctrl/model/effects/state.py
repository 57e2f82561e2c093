"""What an effect may look at: one instant (floats) or a whole log (arrays)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Generic

from tsa_ctrl.model.functions import F


@dataclass(slots=True)
class State(Generic[F]):
    """Measured values at one instant or over a log; nan where there is no such measurement. SI units.

    For a plain drive without a transmission q_j, omega and acceleration are those of the motor.
    """

    t: F  # s
    omega: F  # rad/s, the joint's true velocity
    acceleration: F  # rad/s^2
    q_j: F  # rad
    q_m: F  # rad
    temperature: F  # °C
    theta: F  # rad, bending angle before any effect
    sigma: F  # 1, direction: sign of omega, or the friction state z in [-1, 1]
    start: float  # s, the log's first sample


def unmoved(theta: float) -> State[float]:
    """At `theta`, rad, when nothing is measured yet."""
    nan = math.nan
    return State(
        t=0.0, omega=0.0, acceleration=0.0, q_j=nan, q_m=nan, temperature=nan, theta=theta, sigma=0.0, start=0.0
    )
