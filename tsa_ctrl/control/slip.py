"""Slip fronts of a joint at rest: the exact inverse of two distributed capstans, with return-point memory.

The tension along a tendon changes from its motor side only, while the joint rests. A contact at which it slides keeps
the ratio exp(+-delta), delta = x/CONTACTS; a contact at which it sticks keeps its tensions. So a slip front runs from
the motor into the sheath, and the joint feels nothing before a front is through. The motor moves both tendons by the
same way s, one up and one down, and each one needs another way until its front is through:

    s_through = sum of w_i |T_N exp(+-(N - i) delta) - T_i|,     w_i: share of the length between two contacts

From the first of them on, the joint torque follows the tendon that slides, while the other one still sticks at the
joint. From the second on, all slides, as it does at once when the joint moves. The tensions at the last reversal are
the state. A smaller stroke begins within them, and a larger one wipes it out.

Limit: the joint is assumed to be locked. A hand that holds it yields, and then the second tendon slides with the first.
The less length lies between bends and joint, the smaller the motion that suffices; at a point bend no encoder shows it.
Measured with true parameters at x = 0.8 and bends in the last tenth: the first stroke costs the human-in-the-loop load
7 mN*m RMS (32 instead of 24), and saves the locked joint 25 (3 instead of 28).
Source: (3.24)-(3.30) at each contact, (3.31)-(3.41) for the way.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from operator import mul

from tsa_ctrl.control.front import Front
from tsa_ctrl.control.turn import Turn

CONTACTS = 16  # along one sheath, with equal shares of the wrap angle
_ROUNDS = 16  # of the bisection for the way at a reversal
FADE = 0.004  # s in which all tendons slide once the joint moves


class Slip:
    """The tensions along both tendons.

    `torque` (N*m): motor torque beyond the torque of sliding tendons; `stretch` (rad): planned angle of the motor
    beyond the joint's; `bend` (rad/s^2): its second derivative during a turn of the friction term.
    """

    def __init__(self, front: Front, motor_radius: float, joint_radius: float, stiffness: float, period: float) -> None:
        """Radii in m, `stiffness` of the tendons at the motor in N*m/rad, `period` in s."""
        self._lengths = front.lengths(CONTACTS)
        self._r_m = motor_radius
        self._per_r_j = 1.0 / joint_radius
        self._angle = 2.0 * motor_radius / stiffness  # rad of the motor per N of `_way`
        self._fade = period / FADE
        self.reset(0.0)

    def reset(self, sigma: float) -> None:
        """Assume level tensions, as no stroke without torque is known; `sigma` is the present direction."""
        self._use(0.0, 0.0)
        self.torque = self.stretch = self.bend = 0.0
        self._lack = 0.0  # of the stretch, rad
        self._turned = (sigma, sigma, 0.0, 0.0)
        self.slide(sigma)
        self._level = True

    def slide(self, sigma: float) -> None:
        """Let both tendons slide all along in the direction `sigma`."""
        self._sigma = sigma
        self._left = 0.0  # of the difference to sliding tendons, 1
        self._level = False

    def move(self) -> None:
        """The joint moves: all slides soon."""
        self.release(self._fade)

    def release(self, share: float) -> None:
        """Approach sliding tendons by `share` (1) of the difference at the reversal."""
        self._level = False
        if self._left > 0.0:
            self._left = max(0.0, self._left - share)

    def turn(self, turn: Turn) -> None:
        """Note where the turn of the friction term begins; call it before `slide` or `begin`."""
        self._turned = (turn.force, turn.stretch, self.torque, self._lack)

    def begin(self, sigma: float, tau_m: float, x: float, pretension: float) -> None:
        """Reverse the slip at the motor of a joint at rest.

        Args:
            sigma: new direction, -1 or 1.
            tau_m: motor torque on the tendons at the reversal, N*m.
            x: friction angle, 1.
            pretension: T_p0, N.
        """
        force = tau_m / self._r_m
        if self._left <= 0.0:
            self._use(x, pretension)
        if self._level:
            self._start([pretension] * (CONTACTS + 1), [pretension] * (CONTACTS + 1), self._sigma)
        a, b = self._tensions(force)
        self.slide(sigma)
        self._use(x, pretension)
        if x > 0.0 and min(a[0], a[-1], b[0], b[-1]) > 0.0:
            self._start(a, b, sigma)

    def update(self, tau_j: float, x: float, pretension: float, turn: Turn) -> None:
        """Find torque and stretch at the joint torque `tau_j` in N*m, by friction angle (1) and pretension (N)."""
        if x != self._x or pretension != self._pretension:
            self._use(x, pretension)
        difference = tau_j * self._per_r_j
        half = self._half + self._half_slope * difference
        middle = self._middle + self._middle_slope * difference
        if self._left <= 0.0 and not turn.turning:
            self.torque = self._lack = 0.0
            self.bend = half * turn.bend
            self.stretch = middle + half * turn.stretch
            return
        torque = lack = 0.0
        if self._left > 0.0:
            t1, t3 = self._ends(difference)
            if t1 == t1:
                forward = self._sigma > 0.0
                force, slid = self._sliding(1.0 if forward else -1.0, difference)
                other, _ = self._sliding(-1.0 if forward else 1.0, difference)
                pull, most = t3 - t1 - force, other - force
                # Less torque was sent than desired if the tensions differ by more than both ways of sliding do.
                pull = max(min(0.0, most), min(max(0.0, most), pull))
                torque = self._left * self._r_m * pull
                lack = self._left * self._angle * (self._start_b + self._sigma * self._gone - slid)
        self.bend = half * turn.bend
        if turn.turning:
            way = self._sigma - self._turned[1]
            rise = (lack - self._turned[3]) / way if way != 0.0 else 0.0
            lack += rise * (turn.stretch - self._sigma)
            self.bend += rise * turn.bend
            torque += self._between(torque, difference, turn.force)
        self.torque, self._lack = torque, lack
        self.stretch = middle + half * turn.stretch + lack

    def _between(self, torque: float, difference: float, now: float) -> float:
        """Return what leads a turn from the tensions before it to those after it, N*m at the motor."""
        then, _, before, _ = self._turned
        if (before == 0.0 and torque == 0.0) or self._sigma == then:
            return 0.0
        progress = (now - then) / (self._sigma - then)
        old, new, slid = (self._r_m * self._sliding(sigma, difference)[0] for sigma in (then, self._sigma, now))
        return old + before + progress * (new + torque - old - before) - slid - torque

    def _use(self, x: float, pretension: float) -> None:
        self._x, self._pretension = x, pretension
        self._ahead, self._back = self._line(1.0), self._line(-1.0)
        _, _, forward, forward_slope = self._ahead
        _, _, backward, backward_slope = self._back
        angle = 0.5 * self._angle
        self._half, self._half_slope = angle * (forward - backward), angle * (forward_slope - backward_slope)
        self._middle = angle * (forward + backward - 2.0 * pretension)
        self._middle_slope = angle * (forward_slope + backward_slope)

    def _start(self, a: list[float], b: list[float], sigma: float) -> None:
        """Begin a stroke in the direction `sigma` with these tensions of the segments, N, motor side first."""
        self._a, self._b = a, b
        self._grown = self._shares(sigma)
        self._fallen = [1.0 / share for share in self._grown]
        self._alpha, self._beta = self._way(self._grown), self._way(self._fallen)
        self._start_a, self._start_b = self._way(a), self._way(b)
        self._pull_a = _Pulled(a, self._lengths, self._grown, -sigma)
        self._pull_b = _Pulled(b, self._lengths, self._fallen, sigma)
        self._through_a = sigma * (self._start_a - a[-1] * self._fallen[-1] * self._alpha)
        self._through_b = sigma * (b[-1] * self._grown[-1] * self._beta - self._start_b)
        self._left = 1.0

    def _tensions(self, force: float) -> tuple[list[float], list[float]]:
        """Return the tensions of the segments of both tendons, N, where T3 - T1 has come to `force`, N."""
        sigma = self._sigma
        if self._left > 0.0:
            least, most = 0.0, max(self._through_a, self._through_b)
            lower, upper = (sigma * (self._force(gone) - force) for gone in (least, most))
            if sigma == 0.0 or lower >= 0.0:
                return self._a, self._b
            if upper > 0.0:
                for _ in range(_ROUNDS):
                    gone = 0.5 * (least + most)
                    least, most = (gone, most) if sigma * (self._force(gone) - force) < 0.0 else (least, gone)
                self._force(gone)
                pairs_a, pairs_b = zip(self._a, self._grown, strict=True), zip(self._b, self._fallen, strict=True)
                both = [(t, self._t1 * share) for t, share in pairs_a], [(t, self._t3 * share) for t, share in pairs_b]
                if sigma > 0.0:
                    return [min(each) for each in both[0]], [max(each) for each in both[1]]
                return [max(each) for each in both[0]], [min(each) for each in both[1]]
        grown = self._shares(sigma)
        fallen = [1.0 / share for share in grown]
        alpha, beta = self._way(grown), self._way(fallen)
        t3 = (2.0 * self._pretension + alpha * force) / (alpha + beta)
        return [(t3 - force) * share for share in grown], [t3 * share for share in fallen]

    def _force(self, gone: float) -> float:
        """Return T3 - T1, N, after the motor has moved both tendons by `gone` in the present direction."""
        sigma = self._sigma
        self._t1, self._t3 = self._pull_a.tension(-sigma * gone), self._pull_b.tension(sigma * gone)
        return self._t3 - self._t1

    def _ends(self, difference: float) -> tuple[float, float]:
        """Return T1 and T3, N, where T4 - T2 is `difference` (N); nan where both tendons slide."""
        a, b, sigma = self._a, self._b, self._sigma
        held = b[-1] - a[-1]
        if sigma * (difference - held) < 0.0:
            difference = held
        if self._through_b <= self._through_a:
            t3 = (a[-1] + difference) * self._grown[-1]
            self._gone = gone = sigma * (t3 * self._beta - self._start_b)
            return self._pull_a.tension(-sigma * gone) if gone < self._through_a else math.nan, t3
        t1 = (b[-1] - difference) * self._fallen[-1]
        self._gone = gone = sigma * (self._start_a - t1 * self._alpha)
        if gone >= self._through_b:
            return math.nan, math.nan
        return t1, self._pull_b.tension(sigma * gone)

    def _sliding(self, sigma: float, difference: float) -> tuple[float, float]:
        """Return T3 - T1 (N) and the elongation of tendon b (l/EA, N) while both tendons slide; their mean stays T_p0.

        `difference`: T4 - T2, N.
        """
        line = self._ahead if sigma == 1.0 else self._back if sigma == -1.0 else self._line(sigma)
        force, force_slope, way, way_slope = line
        return force + force_slope * difference, way + way_slope * difference

    def _line(self, sigma: float) -> tuple[float, float, float, float]:
        """Return both of `_sliding` at T4 = T2, each with its slope by T4 - T2."""
        shares = self._shares(sigma)
        alpha, beta, less = self._way(shares), self._way([1.0 / share for share in shares]), 1.0 / shares[-1]
        whole = beta + alpha * less * less
        level, slope = 2.0 * self._pretension / whole, alpha * less / whole  # of T3
        return level * (1.0 - less * less), slope * (1.0 - less * less) + less, level * beta, slope * beta

    def _shares(self, sigma: float) -> list[float]:
        """Return the tension of each segment of a sliding tendon a over T1, 1."""
        step = sigma * self._x / CONTACTS
        return [math.exp(step * i) for i in range(CONTACTS + 1)]

    def _way(self, tensions: list[float]) -> float:
        """Return the elongation of a tendon, in l/EA, N."""
        return math.fsum(map(mul, self._lengths, tensions))


class _Pulled:
    """The tension of a tendon at the motor while the motor pulls it, and a slip front runs from contact to contact."""

    def __init__(self, old: list[float], lengths: tuple[float, ...], shares: list[float], sign: float) -> None:
        """Find the way at which the front passes each contact.

        Args:
            old: tensions of the segments before, N, motor side first.
            lengths: of the segments, 1.
            shares: tensions of the segments over that at the motor once they slide, 1.
            sign: of the way.
        """
        self._sign = sign
        self._old: list[float] = []  # elongation before, up to and with each segment, l/EA in N
        self._per_tension: list[float] = []  # 1, likewise of segments that slide
        self._passed: list[float] = []  # l/EA in N, where the front passes the contact behind each segment
        elongation, per_tension, passed = 0.0, 0.0, -math.inf
        for i, length in enumerate(lengths):
            per_tension += length * shares[i]
            elongation += length * old[i]
            self._per_tension.append(per_tension)
            self._old.append(elongation)
            if i < CONTACTS:
                if per_tension > 0.0:
                    passed = max(passed, sign * (old[i + 1] / shares[i + 1] * per_tension - elongation))
                self._passed.append(passed)

    def tension(self, way: float) -> float:
        """Return the tension at the motor, N, after a way of the motor, l/EA in N."""
        i = bisect_left(self._passed, self._sign * way)
        return (way + self._old[i]) / self._per_tension[i]
