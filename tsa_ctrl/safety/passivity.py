"""Energy that the compensation puts into the joint beyond what was wanted: a time-domain passivity observer.

Compensation feeds motion where it is more than the friction that is there, c h_model > h_true. Then the transmission is
no longer passive, and that shows at the joint, at any frequency and in a motion to one side alone:

    E = integral of |omega_J| min(e - g |tau_J*| - L |dtau_J*/dt| - z h, term),     e = (tau_J - tau_J*) sgn omega_J

tau_J is what arrives (joint torque sensor, or the tendons' stretch), tau_J* what was wanted, h the model's half loop at
the joint, `term` the friction term there in the direction of the motion, all N*m. A gain error of either torque is
proportional to the wanted one, a zero error stands still, and what comes late by L is no friction: g, L and z of them
are left out. Nothing counts that the term itself did not give: a torque that a limit cut, a weight that falls and a
hand that pulls are no fault of the compensation. E forgets, and never falls below 0, so it is the most that was added
within any window. With the friction that is there it stays at 0 while the joint moves, and a reversal leaves 0.3 mJ.
What the drive and the slip fronts let pass until a back-off arrives at the joint is foreseen by `REACTION`.

Source: B. Hannaford, J.-H. Ryu, Time-domain passivity control of haptic interfaces, IEEE Trans. Robotics and Automation
18 (2002). The controller that belongs to it takes the compensation back at once (`back_off`), which damps by all of the
friction that is there.
"""

from __future__ import annotations

import math
from typing import Annotated

import msgspec
from msgspec import Meta

MEMORY = 2.0  # s in which energy is forgotten: longer than a gait cycle
SENSOR_GAIN, SENSOR_ZERO = 0.03, 0.03  # g, z of a joint torque sensor: what its data sheet leaves open
STRETCH_GAIN, STRETCH_ZERO = 0.2, 0.12  # of the stretch: 10 % of the tendons' stiffness are 20 and 10 % there
LATE = 3e-3  # s, L: drive, motor and the model's own delay
REACTION = 5e-3  # s from a back-off to its torque at the joint: command, torque loop, fronts through the sheath
FEWEST = 2  # cycles that must agree: one wrong value of a sensor is no motion
_WILD = 1e6  # N*m: no torque; not finite ones are beyond it, too


class PassivitySettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[axis.passivity]: when the compensation counts as a motor of its own, and backs off."""

    energy: Annotated[float, Meta(gt=0.0, le=100.0)] = (
        3e-3  # J beyond what was wanted: 0.02 kg*m^2 have 10 mJ at 1 rad/s
    )
    buzz: Annotated[float, Meta(gt=0.0, le=100.0)] = 0.03  # N*m RMS at the motor above 20 Hz, for 0.4 s


class OscillationSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[axis.oscillation] of earlier versions: read, and without effect."""

    speed: Annotated[float, Meta(gt=0.0, le=100.0)] = 0.5
    duration: Annotated[float, Meta(gt=0.0, le=60.0)] = 1.0
    share: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.5


class Passivity:
    """`energy` (J) that was added; `ratio`: true half loop over the model's, as this energy shows it (1)."""

    def __init__(self, threshold: float, gain: float, zero: float, period: float) -> None:
        """`threshold` in J, `gain` and `zero` as g and z above, `period` in s."""
        self._threshold = threshold
        self._gain = gain
        self._zero = zero
        self._period = period
        self._keep = math.exp(-period / MEMORY)
        self.reset()

    def reset(self) -> None:
        """Nothing was added yet."""
        self.energy = 0.0
        self.cycles = 0  # for which there was some
        self._true = self._modelled = 0.0

    @property
    def ratio(self) -> float:
        return self._true / self._modelled if self._modelled > 0.0 else math.nan

    def update(self, tau_j: float, wanted: float, rate: float, omega_j: float, term: float, half_loop: float) -> bool:
        """Whether more was added than is allowed, after this cycle.

        `tau_j`: delivered, nan where it is not known; `wanted`: set-point, `rate`: its slope, `term`: the friction term
        as sent, at the joint, `half_loop`: the model's, at the joint; N*m, N*m/s, rad/s.
        """
        if omega_j < 0.0:
            omega_j, tau_j, wanted, term = -omega_j, -tau_j, -wanted, -term
        excess = tau_j - wanted
        if not -_WILD < excess < _WILD:  # nan, too: nothing is known of this cycle
            return False
        over = excess - self._zero * half_loop - self._gain * (wanted if wanted > 0.0 else -wanted)
        over -= LATE * (rate if rate > 0.0 else -rate)
        if over > term:
            over = term if term > 0.0 else 0.0
        way = omega_j * self._period
        energy = self.energy * self._keep + over * way
        if not energy > 0.0:
            if self.cycles:
                self.reset()
            return False
        self.energy = energy
        self.cycles += 1
        self._true += (term - excess) * way
        self._modelled += half_loop * way
        return energy + REACTION * over * omega_j > self._threshold and self.cycles >= FEWEST
