"""Plan the reversal of the friction term: the slip front in the sheath, the motor motion, and the tensions at rest.

**ReversalFront.** Until the motor reverses, each tendon slides in one direction, and its tension changes along the
bends by exp(-+x). After the reversal it slides in the other direction from the motor up to a front. Beyond the front,
nothing has changed. A front at the share p of the bending (p x of the friction angle) has changed the motor-side
tension by 2 p x T, to first order in x. The motor has moved by

    s(p) = 2 x T l/EA S(p),     S(p) = integral over u from 0 to 1 of max(0, p - b(u)),     S(1) = s_c

where b(u) is the share of the bending up to the share u of the length (`tsa_ctrl.model.curvature`) and s_c its centre.
The joint torque does not change before the front has passed the sheath, p = 1. In an evenly bent sheath, S = p^2/2, so
the first half of the hysteresis takes a quarter of the motor's travel. With all bends at the joint, S = p, like a
spring. With all bends at the motor, S = 0, and the travel is 0. A series spring is a part of the length without bends.
A spring at the motor is before all bends, and a spring at the joint is behind them.

**FrictionReversal.** When the tendon reverses, the motor-side tension passes through the whole hysteresis, and the
motor moves by the corresponding elongation. The motor's inertia prevents a step. The elongation therefore follows a
cycloid in time,

    s/s_end = y - sin(2 pi y) / 2 pi,     y = time / duration in [0, 1],     s'' = 0 at both ends

and ends without an oscillation. The torque follows from the elongation by the front, p = S^-1(s). The law adds the
torque of the inertia, J_M s'' / r_M. A reversal that begins before another one has ended is added to it. A reversal has
no feedback: a delay of the command shifts it in time, and the lead compensates for this shift. A reversal at rest takes
at least two cycles of the motor's oscillation (`law`), because the joint torque changes only at its end. Input shaping
by one period of the oscillation would take 10 ms at 100 Hz, and more for a heavier motor.

**Slip.** While the joint rests, the tension along a tendon changes from its motor side only. A contact at which the
tendon slides keeps the tension ratio exp(+-delta), delta = x/CONTACTS. A contact at which it sticks keeps its tensions.
The motor moves both tendons by the same travel s, one up and one down, and each tendon needs a different travel until
its front has passed the sheath:

    s_through = sum of w_i |T_N exp(+-(N - i) delta) - T_i|,     w_i: share of the length between two contacts

After the shorter travel, the joint torque follows the sliding tendon, while the other one still sticks at the joint.
After the longer travel, both slide, as they do immediately when the joint moves. The tensions at the last reversal are
the state, with return-point memory: a smaller stroke begins within them, and a larger one replaces them.

Limit of `ReversalSlip`: the joint is assumed to be locked. A hand that holds it yields, and then the second tendon
slides with the first. The shorter the length between bends and joint, the less motion is sufficient. At a point bend,
no encoder detects this motion. With true parameters, x = 0.8 and bends in the last tenth, `ReversalSlip` costs a
human-in-the-loop load 7 mN*m RMS in the first stroke (32 instead of 24), and saves a locked joint 25 (3 instead of 28).
On 14 random rigs, it reduces the error of a locked joint from 61 to 15 mN*m (geometric mean).

Source: (3.24)-(3.30) at each contact, (3.31)-(3.41) for the travel.
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_left
from operator import mul

from tsa_ctrl.model.curvature import Points
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.stretch import profile_of

_STEPS = 64  # of the tables over p and over y


class ReversalFront:
    """Hold S(p) of a sheath as a table, with its inverse and the centre of the bending."""

    def __init__(self, points: Points, before: float = 0.0, after: float = 0.0) -> None:
        """Tabulate S(p).

        Args:
            points: (share of the length, share of the bending).
            before, after: series springs at motor and joint as lengths of tendon, over the tendon's length.
        """
        whole = 1.0 + before + after
        start = [(0.0, 0.0), (before / whole, 0.0)] if before > 0.0 else []
        middle = [((before + u) / whole, b) for u, b in points]
        end = [(1.0, 1.0)] if after > 0.0 else []
        course = start + middle + end
        self.table = tuple(_mean_above(course, i / _STEPS) for i in range(_STEPS + 1))
        self.centre = self.table[-1]  # s_c, 1

    def lengths(self, contacts: int) -> tuple[float, ...]:
        """Return the shares of the length before, between and after `contacts` contacts of equal wrap angle, 1."""
        each = _STEPS // contacts
        before = [contacts * (self.table[each * (i + 1)] - self.table[each * i]) for i in range(contacts)]
        return tuple(after - now for now, after in itertools.pairwise([0.0, *before, 1.0]))


def front_of(model: TendonSheath) -> ReversalFront:
    """Return the front of a model; without a curvature profile the sheath is bent evenly."""
    points = profile_of(model).points
    spring = model.series_length / model.unstrained_length
    return ReversalFront(points, 0.0, spring) if model.series_at_joint else ReversalFront(points, spring, 0.0)


def _mean_above(course: list[tuple[float, float]], p: float) -> float:
    """Return the integral of max(0, p - b) along a piecewise linear profile."""
    total = 0.0
    for (u, b), (v, c) in itertools.pairwise(course):
        if v > u and b < p:
            if c <= p:
                total += (v - u) * (p - 0.5 * (b + c))
            else:
                total += 0.5 * (v - u) * (p - b) ** 2 / (c - b)
    return total


_SOFT = 0.02  # of s_c: elongation added over the whole torque, which would otherwise step with all bends at the motor


class FrictionReversal:
    """Plan a reversal of the friction term.

    Attributes: `force` and `stretch`: progress of torque and elongation, in [-1, 1]. `bend`: d^2 stretch / dt^2, 1/s^2.
    `turning`: True during the reversal.
    """

    def __init__(self, front: ReversalFront, duration: float, period: float) -> None:
        """Prepare the course; `duration` of a whole reversal and `period` in s."""
        self.duration = duration
        self._step = period / duration
        self._force = _course(front)
        self._ramps: list[list[float]] = []
        self._pace = 1.0  # 1, of the ramps that have not ended
        self.reset()

    def reset(self, sigma: float = 0.0) -> None:
        """Set the direction `sigma` without a transition."""
        self.force = self.stretch = self._end = self._base = sigma
        self.bend = 0.0
        self.turning = False
        self._ramps.clear()

    def update(self, sigma: float, age: float = 0.0, slower: float = 1.0) -> None:
        """Advance by one period.

        Args:
            sigma: direction; a new one starts a transition to it.
            age: age of a new transition, periods.
            slower: its duration over the duration of a whole reversal, 1. A faster transition accelerates those that
                have not ended.
        """
        ramps = self._ramps
        if sigma != self._end:
            pace = self._pace = max(1.0 / slower, self._pace) if ramps else 1.0 / slower
            ramps.append([sigma - self._end, age * self._step * pace])
            self._end = sigma
        elif not ramps:
            self.force = self.stretch = self._end
            self.bend = 0.0
            return
        force = stretch = self._base
        bend, pace = 0.0, self._pace
        two_pi = 2.0 * math.pi
        for ramp in ramps:
            size, y = ramp
            sine = math.sin(two_pi * y)
            place = y * _STEPS
            i = int(place)
            force += size * (self._force[i] + (place - i) * (self._force[min(i + 1, _STEPS)] - self._force[i]))
            stretch += size * (y - sine / two_pi)
            bend += size * sine * pace * pace
            ramp[1] = min(1.0, y + self._step * pace)
        self.force, self.stretch = force, stretch
        self.bend = two_pi * bend / (self.duration * self.duration)
        while ramps and ramps[0][1] >= 1.0:
            self._base += ramps.pop(0)[0]
        self.turning = bool(ramps)

    def steepest(self) -> float:
        """Return the largest change of `force` within a period, for a transition from 0 to 1."""
        count = max(1, math.ceil(1.0 / self._step))
        values = [self.at(i * self._step) for i in range(count + 1)]
        return max(after - before for before, after in itertools.pairwise(values))

    def at(self, y: float) -> float:
        """Return the fraction of the torque that has reversed at y."""
        place = min(1.0, max(0.0, y)) * _STEPS
        i = min(int(place), _STEPS - 1)
        return self._force[i] + (place - i) * (self._force[i + 1] - self._force[i])


def _course(front: ReversalFront) -> tuple[float, ...]:
    """Return the fraction of the torque at equal steps of y."""
    table, soft = front.table, _SOFT * max(front.centre, 1e-6)
    last = len(table) - 1
    softened = [s + soft * i / last for i, s in enumerate(table)]
    shares = []
    for k in range(_STEPS + 1):
        y = k / _STEPS
        wanted = softened[-1] * (y - math.sin(2.0 * math.pi * y) / (2.0 * math.pi))
        i = 0
        while i < last - 1 and softened[i + 1] <= wanted:
            i += 1
        shares.append(min(1.0, (i + (wanted - softened[i]) / (softened[i + 1] - softened[i])) / last))
    return tuple(shares)


CONTACTS = 16  # along one sheath, with equal shares of the wrap angle
_ROUNDS = 16  # of the bisection for the travel at a reversal
FADE = 0.004  # s in which all tendons slide once the joint moves


class ReversalSlip:
    """Track the tensions along both tendons.

    Attributes: `torque`: motor torque in addition to the torque of sliding tendons, N*m. `stretch`: planned angle of
    the motor beyond the joint angle, rad. `bend`: its second derivative in a reversal of the friction term, rad/s^2.
    """

    def __init__(
        self, front: ReversalFront, motor_radius: float, joint_radius: float, stiffness: float, period: float
    ) -> None:
        """Prepare the tendons; radii in m, `stiffness` of the tendons at the motor in N*m/rad, `period` in s."""
        self._lengths = front.lengths(CONTACTS)
        self._r_m = motor_radius
        self._per_r_j = 1.0 / joint_radius
        self._angle = 2.0 * motor_radius / stiffness  # rad of the motor per N of `_way`
        self._fade = period / FADE
        self.reset(0.0)

    def reset(self, sigma: float) -> None:
        """Assume level tensions, because no stroke without torque is known; `sigma` is the present direction."""
        self._use(0.0, 0.0)
        self.torque = self.stretch = self.bend = 0.0
        self._lack = 0.0  # rad, missing elongation
        self._turned = (sigma, sigma, 0.0, 0.0)
        self.slide(sigma)
        self._level = True

    def slide(self, sigma: float) -> None:
        """Let both tendons slide along their whole length in the direction `sigma`."""
        self._sigma = sigma
        self._left = 0.0  # 1, remaining share of the difference to sliding tendons
        self._level = False

    def move(self) -> None:
        """Let all contacts slide within a short time, because the joint moves."""
        self.release(self._fade)

    def release(self, share: float) -> None:
        """Approach the state of sliding tendons by `share` (1) of the difference at the reversal."""
        self._level = False
        if self._left > 0.0:
            self._left = max(0.0, self._left - share)

    def turn(self, reversal: FrictionReversal) -> None:
        """Store the start of a reversal of the friction term; call this before `slide` or `begin`."""
        self._turned = (reversal.force, reversal.stretch, self.torque, self._lack)

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

    def update(self, tau_j: float, x: float, pretension: float, reversal: FrictionReversal) -> None:
        """Update torque and elongation for the joint torque `tau_j` (N*m), friction angle (1) and pretension (N)."""
        if x != self._x or pretension != self._pretension:
            self._use(x, pretension)
        difference = tau_j * self._per_r_j
        half = self._half + self._half_slope * difference
        middle = self._middle + self._middle_slope * difference
        if self._left <= 0.0 and not reversal.turning:
            self.torque = self._lack = 0.0
            self.bend = half * reversal.bend
            self.stretch = middle + half * reversal.stretch
            return
        torque = lack = 0.0
        if self._left > 0.0:
            t1, t3 = self._ends(difference)
            if t1 == t1:
                forward = self._sigma > 0.0
                force, slid = self._sliding(1.0 if forward else -1.0, difference)
                other, _ = self._sliding(-1.0 if forward else 1.0, difference)
                pull, most = t3 - t1 - force, other - force
                # A larger difference than between both directions of sliding means that less torque was sent.
                pull = max(min(0.0, most), min(max(0.0, most), pull))
                torque = self._left * self._r_m * pull
                lack = self._left * self._angle * (self._start_b + self._sigma * self._gone - slid)
        self.bend = half * reversal.bend
        if reversal.turning:
            way = self._sigma - self._turned[1]
            rise = (lack - self._turned[3]) / way if way != 0.0 else 0.0
            lack += rise * (reversal.stretch - self._sigma)
            self.bend += rise * reversal.bend
            torque += self._between(torque, difference, reversal.force)
        self.torque, self._lack = torque, lack
        self.stretch = middle + half * reversal.stretch + lack

    def _between(self, torque: float, difference: float, now: float) -> float:
        """Return the torque that leads a reversal from the tensions before it to those after it, N*m at the motor."""
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
        """Return the tensions of the segments of both tendons, N, when T3 - T1 has reached `force` (N)."""
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
        """Return T1 and T3, N, for T4 - T2 = `difference` (N); nan for a tendon that slides along its whole length."""
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
        """Return both results of `_sliding` at T4 = T2, each with its slope by T4 - T2."""
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
    """Compute the motor-side tension of a tendon that the motor pulls, while a slip front passes its contacts."""

    def __init__(self, old: list[float], lengths: tuple[float, ...], shares: list[float], sign: float) -> None:
        """Tabulate the motor travel at which the front passes each contact.

        Args:
            old: previous tensions of the segments, N, motor side first.
            lengths: lengths of the segments, 1.
            shares: tensions of the segments over the motor-side tension once they slide, 1.
            sign: sign of the travel.
        """
        self._sign = sign
        self._old: list[float] = []  # previous elongation up to and including each segment, l/EA in N
        self._per_tension: list[float] = []  # 1, the same for sliding segments, over the motor-side tension
        self._passed: list[float] = []  # travel at which the front passes the contact behind each segment, l/EA in N
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
        """Return the tension at the motor, N, after the travel `way` of the motor, l/EA in N."""
        i = bisect_left(self._passed, self._sign * way)
        return (way + self._old[i]) / self._per_tension[i]
