"""Slip fronts of a joint at rest: by how much a turn falls short of the whole loop, and until when.

Both tendons share the motor's motion, but the one with the higher tension needs more of it to turn its friction round:
s = 2 x T l/EA S(1). At a turn under load the front of the slacker tendon is through first; from there on the joint
feels the motor, while the other tendon's front has come to the share p of its bends,

    T_high e^(+-x (1 - p)) S(p) = T_low S(1) + what the slacker tendon has stretched since / (2 x l/EA),

and its motor-side tension has changed by the factor exp(-+2 x p) instead of exp(-+2 x). The inverse of the sliding
sheath knows the end of this alone, and would push through it: 70 mN*m too much at 0.5 N*m on the shipped actuator. It
ends when the other front is through, too, or the joint moves, which makes everything slide.

T2 and T4 while all slides: T4 - T2 = tau_J/r_J, and the mean tension of both tendons stays T_p0, so that

    (T2 + T4)/2 = (T_p0 - sigma x s_c (T4 - T2)/2) / (1 + x^2 m/2),     m = integral of (1 - b)^2

to second order in x. Mirrored for the other direction: the tendons change places.
"""

from __future__ import annotations

import math

from tsa_ctrl.control.front import Front

FADE = 0.004  # s in which the rest of the loop follows when the joint begins to move
_ROUNDS = 3  # of the fixed point for p


class Slip:
    """What is left of a turn of a joint at rest; `active` until both fronts are through."""

    def __init__(self, front: Front, motor_radius: float, joint_radius: float, period: float) -> None:
        """Radii in m, `period` in s."""
        self._front = front
        self._r_m = motor_radius
        self._per_r_j = 1.0 / joint_radius
        self._fade = period / FADE
        self.reset()

    @property
    def active(self) -> bool:
        return self._left > 0.0

    def reset(self) -> None:
        self._left = 0.0
        self.scale = 1.0  # of the turn's stretch, 1
        self._old = 0.0
        self._low = self._high = 0.0

    def begin(self, old: float, tau_j: float, x: float, pretension: float) -> None:
        """The direction turns from `old` (-1 or 1) to the other, at `tau_j` N*m; x in 1, T_p0 in N."""
        mean, half = self._tensions(old, tau_j, x, pretension)
        if old == 0.0 or not mean - abs(half) > 0.0 or x <= 0.0:
            self.reset()
            return
        self._old = old
        half *= old  # mirrored: as if sigma had been 1, tendon b the one that unloads
        self._high, self._low = mean + half, mean - half  # T4, T2
        self._left = 1.0
        self.scale = (mean - abs(half)) / mean

    def shortfall(self, tau_j: float, x: float, pretension: float, moving: bool) -> float:
        """N*m at the motor that the turned friction term lies beyond what the fronts have reached, at `tau_j` N*m."""
        old, front = self._old, self._front
        if moving:
            self._left -= self._fade
        if self._left <= 0.0 or not x > 0.0:
            self.reset()
            return 0.0
        t4, t2 = self._high, self._low
        difference = old * tau_j * self._per_r_j
        stretched = math.exp(x * front.centre)
        grown = math.exp(x)
        if t2 < t4:  # tendon a is through, b on the way; T4 stands still
            through = t4 - difference
            pull = through * stretched - t2 / stretched
            share = self._share(pull, t4, x)
            reached = t4 * math.exp(x * (1.0 - 2.0 * share)) - through * grown
        else:
            through = t2 + difference
            pull = t4 * stretched - through / stretched
            share = self._share(pull, t2, -x)
            reached = through / grown - t2 * math.exp(-x * (1.0 - 2.0 * share))
        if share >= 1.0 or not through > 0.0:
            self.reset()
            return 0.0
        mean, half = self._tensions(-old, tau_j, x, pretension)
        half *= old
        end = (mean + half) / grown - (mean - half) * grown
        return self._r_m * old * self._left * (end - reached)

    def _share(self, pull: float, tension: float, x: float) -> float:
        """p of the front on its way, by the stretch `pull` (in l/EA, N); x is negative in a tendon that is loaded."""
        share, depth = 1.0, self._front.depth
        for _ in range(_ROUNDS):
            share = depth(pull / (2.0 * abs(x) * tension * math.exp(x * (1.0 - share))))
        return share

    def _tensions(self, sigma: float, tau_j: float, x: float, pretension: float) -> tuple[float, float]:
        """Half the sum and half the difference of T4 and T2 while both slide, N."""
        half = 0.5 * tau_j * self._per_r_j
        front = self._front
        return (pretension - sigma * x * front.centre * half) / (1.0 + 0.5 * x * x * front.spread), half
