"""Energy that the compensation puts into the joint beyond what was wanted: a time-domain passivity observer.

Compensation feeds motion where it is more than the friction that is there, c h_model > h_true. Then the transmission is
no longer passive, and that shows at the joint, at any frequency and in a motion to one side alone:

    E = integral of |omega_J| min(e - m h, term),     e = (tau_J - tau_J*) sgn omega_J
    added beyond doubt:  E - g |integral of tau_J* omega_J| - L |integral of dtau_J*/dt omega_J| - z h |q_J - q_0|

tau_J is what arrives (joint torque sensor, or the tendons' stretch), tau_J* what was wanted, h the model's half loop at
the joint, `term` the friction term there in the direction of the motion, all N*m. A torque that is wrong by the share g
of what is wanted, comes late by L, or has its zero wrong by z h, adds no more than the last three, which grow with the
work, the way and the course and not with the path: a load that gives back what it took leaves little of them. m is as
near as a half loop is ever known. Nothing counts that the term itself did not give: a torque that a limit cut, a weight
that falls and a hand that pulls are no fault of the compensation. E forgets, and never falls below 0, where its window
begins anew, so it is the most that was added within any window. With the friction that is there it stays at 0 while the
joint moves, and a reversal leaves 0.3 mJ. What passes until a back-off arrives at the joint is foreseen by `REACTION`,
no more than was there already: half a swing of the motor on its tendons is no motion. Nor is what such a swing gives
the joint while it dies out, J_M/2 (omega_M - r_J/r_M omega_J)^2 at its fastest: a turn that is planned for another
shape of the sheath leaves a motor of 6e-4 kg*m^2 4 mJ of it. It is left out, but for what was not counted as more than
the term; one that feeds itself goes on beyond that. Energy that the tendons return is left out, too: an excess e in
the new direction at a reversal was there before the term turned, as after a limit, a fade-in or a small compensation,
and it gives e^2/(2 K_J) while it unwinds. Once it was seen, half of all this is enough for the next minute
(`wary`): a joint that is fast by then gets by that half of what else passes as a doubt.

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
SENSOR = (0.03, 0.03, 0.01)  # g, z, m with a joint torque sensor: what its data sheet leaves open
STRETCH = (0.2, 0.12, 0.1)  # with the stretch: 10 % of the tendons' stiffness are 20 % of the torque and 10 % of h
LATE = 3e-3  # s, L: drive, motor and the model's own delay
REACTION = 5e-3  # s from a back-off to its torque at the joint: command, torque loop, fronts through the sheath
SWUNG = 0.03  # s in which the fastest of a swing is forgotten: half a period of 16 Hz, before the joint gets it
SWING = 2.0  # of the allowed energy that a swing excuses at most: 6 mJ and those 3, at 1 rad/s the joint has 10
WARY = 0.5  # of energy and doubts, where it was seen lately: no healthy rig comes there
FEWEST = 2  # cycles that must agree: one wrong value of a sensor is no motion
_WILD = 1e6  # N*m: no torque; not finite ones are beyond it, too


class PassivitySettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[axis.passivity]: when the compensation counts as a motor of its own, and backs off."""

    energy: Annotated[float, Meta(gt=0.0, le=100.0)] = 3e-3  # J; at 1 rad/s 0.02 kg*m^2 have 10 mJ
    buzz: Annotated[float, Meta(gt=0.0, le=100.0)] = 0.03  # N*m RMS at the motor above 20 Hz, for 0.4 s


class OscillationSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[axis.oscillation] of earlier versions: read, and without effect."""

    speed: Annotated[float, Meta(gt=0.0, le=100.0)] = 0.5
    duration: Annotated[float, Meta(gt=0.0, le=60.0)] = 1.0
    share: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.5


class Passivity:
    """`energy` (J) that was added; `ratio`: true half loop over the model's, as this energy shows it (1)."""

    def __init__(
        self, threshold: float, doubts: tuple[float, float, float], period: float, compliance: float = 0.0
    ) -> None:
        """`threshold` in J, `doubts`: g, z and m above, `period` in s; `compliance`: 1/K_J, rad/(N*m) of the joint."""
        self._threshold = threshold
        self._half_compliance = 0.5 * compliance
        self._gain, self._zero, self._model = doubts
        self._period = period
        self._keep = math.exp(-period / MEMORY)
        self._calm = math.exp(-period / SWUNG)
        self._most_swing = SWING * threshold
        self._swing = 0.0  # J, fastest of late
        self._side = 0.0  # 1 or -1, of the joint's last motion
        self._returned = 0.0  # J, that tendons return since a reversal
        self._periods = 1  # since the last update
        self.wary = False  # of a rig on which it was seen lately
        self.reset()

    def reset(self) -> None:
        """Nothing was added yet."""
        self.energy = 0.0
        self.cycles = 0  # for which there was some
        self._work = self._late = self._way = 0.0  # J, J/s, rad since it began
        self._true = self._modelled = 0.0
        self._swung = self._cut = 0.0  # J, fastest since then, and beyond the term

    def pass_over(self, periods: int) -> None:
        """So many periods had no cycle: what is measured next stands for them, too."""
        self._periods += periods

    @property
    def ratio(self) -> float:
        return self._true / self._modelled if self._modelled > 0.0 else math.nan

    def update(
        self,
        tau_j: float,
        wanted: float,
        rate: float,
        omega_j: float,
        term: float,
        half_loop: float,
        swing: float = 0.0,
    ) -> bool:
        """Whether more was added than is allowed, after this cycle.

        `tau_j`: delivered, nan where it is not known; `wanted`: set-point, `rate`: its slope, `term`: the friction term
        as sent, at the joint, `half_loop`: the model's, at the joint; N*m, N*m/s, rad/s. `swing`: J that the motor has
        by its motion against the joint while the term turns, 0 or nan where that is not known.
        """
        periods, self._periods = self._periods, 1
        self._swing *= self._calm
        if swing > self._swing:
            self._swing = swing if swing < self._most_swing else self._most_swing
        side = 1.0
        if omega_j < 0.0:
            side = -1.0
            omega_j, tau_j, wanted, rate, term = -omega_j, -tau_j, -wanted, -rate, -term
        excess = tau_j - wanted
        keep = self._keep
        self._returned *= keep
        if side != self._side:
            self._side = side
            if 0.0 < excess < _WILD:
                self._returned = max(self._returned, self._half_compliance * excess * excess)
        if not -_WILD < excess < _WILD:  # nan, too: nothing is known of this cycle
            return False
        over = excess - self._model * half_loop
        beyond = 0.0
        if over > term:
            given = term if term > 0.0 else 0.0
            over, beyond = given, over - given
        way = omega_j * self._period * periods
        energy = self.energy * keep + over * way
        if not energy > 0.0:
            if self.cycles:
                self.reset()
            return False
        self.energy = energy
        self.cycles += 1
        self._true += (term - excess) * way
        self._modelled += half_loop * way
        self._work = work = self._work * keep + wanted * way
        self._late = late = self._late * keep + rate * way
        self._way = moved = self._way * keep + side * way
        self._cut = cut = self._cut * keep + beyond * way
        self._swung *= keep
        if self._swing > self._swung:
            self._swung = self._swing
        coming = REACTION * over * omega_j
        foreseen = energy + (coming if coming < energy else energy)
        share = WARY if self.wary else 1.0
        threshold = share * self._threshold
        if foreseen < threshold or self.cycles < FEWEST:
            return False
        swung = self._swung - cut
        doubt = self._gain * abs(work) + LATE * abs(late) + self._zero * half_loop * abs(moved)
        return foreseen - share * doubt - (swung if swung > 0.0 else 0.0) - self._returned > threshold
