"""Limit the compensated share of the friction to the proven friction and a limited energy beyond it.

Compensation drives a joint if it exceeds the actual friction (`law`). The friction term therefore never exceeds the
friction torque that the sensors prove at present (`observer.friction_proof`), except for an energy credit:

    limit h = low + k (most - low),    most = c min(h, (low + high)/2)      low <= friction torque <= high
    dE/dt = (low - term) |omega_J|                  E <= capacity,  k = min(1, E / (KNEE capacity))

h is the friction torque of the model in use, c the desired share. The credit covers the work of the term while the
friction is not proven. It is at most its capacity, for any friction, load and set-point. A file that no tuning of this
joint wrote may belong to any other joint. The capacity of class "worn" therefore applies to it, until the proven
friction reaches the least friction that the file's own uncertainty allows. Only motion spends the credit, so a locked
joint keeps its full compensation. A joint torque sensor measures this work: the joint receives at most the sensor's
excess over the set-point. If friction is proven, low is close to high, and the credit has no effect.

An empty credit reduces the term to 0. If the term returned while the joint rests, it would start the motion again. The
credit is therefore filled again only if the joint is moved without the term. The motion must follow a rest, or last
longer than the joint can move on its momentum. Motion in the direction of the set-point's torque does not count,
because that torque may have caused it. A changed set-point also fills an empty or partly spent credit once the joint
rests, because each request has one credit.

Without a sensor at the joint, friction is never proven. A changing set-point then suspends the account, because a
person requests motion, if it moves by a share of the friction within a second. A smaller change does not: noise and the
ripple of an outer loop would suspend it for ever. The change also fills a partly spent credit, even on a moving joint:
a sine whose peaks look constant never empties it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from tsa_ctrl.control.bending import routing_of
from tsa_ctrl.control.settings import BendingSettings
from tsa_ctrl.control.torque_feedback import MORE
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.steady_sliding import sliding
from tsa_ctrl.observer.friction_proof import FrictionProof
from tsa_ctrl.safety.limiter import Reason

# The share of the friction that may be compensated, so that c h_model <= h_true holds for every possible h_true.
#
# Two quantities are uncertain: the friction torque h at the calibration, and the present bending of the sheath.
#
# bound = (lower end of the interval of h / its value) * min over the range of Theta of h(Theta)/h(Theta_0)
#
# The interval comes from the calibration, `[provenance] intervals` of the model file. A file that was never calibrated
# has only [uncertainty]. If the delivered torque is measured, the guard uses the measurement and a note reports this.
# Otherwise the lower end of [uncertainty] is used. The range of the bending is `[axis.bending] range`. It is not needed
# if the bending is measured, commanded or estimated.

_STEPS = 16  # over the range of the bending, in which h has a single maximum


@dataclass(frozen=True)
class Bound:
    """Hold the largest share of the friction term, 1: `seen` while the delivered torque is known, else `unseen`."""

    seen: float
    unseen: float
    notes: tuple[str, ...] = ()


def bound_of(
    model: TendonSheath, *, bending_range: float, bending_known: bool, sees: bool, compensation: float
) -> Bound:
    """Return the bound for a model and the settings of the axis.

    Args:
        model: the tendons and their sheaths.
        bending_range: largest deviation from the model's bending in either direction, 1.
        bending_known: True if the bending is followed in the loop.
        sees: True if the axis can measure the delivered torque.
        compensation: desired share of [axis.law].
    """
    calibrated = interval_share(model)
    uncertain = 1.0 / model.most_friction
    bent = 1.0 if bending_known else bending_share(model, bending_range)
    seen = bent * (1.0 if calibrated is None else calibrated)
    unseen = bent * (uncertain if calibrated is None else calibrated)
    notes = []
    if compensation > 1.0:
        notes.append(f"law.compensation {compensation:g} asks for more than the friction that the model has: 1 is used")
    if calibrated is not None and calibrated * bent < compensation and calibrated < 1.0:
        notes.append(
            f"the half loop's interval of the calibration begins at {100.0 * calibrated:.0f} % of its value: no more "
            "is compensated; longer logs narrow it"
        )
    if bent < 1.0:
        notes.append(
            f"the sheath may bend {100.0 * bending_range:.0f} % more or less (bending.range), and nothing measures it: "
            f"that costs {100.0 * (1.0 - bent):.0f} % of the compensation; an estimator in use, or a sensor of "
            "the bending, gives it back"
        )
    if calibrated is None and sees and compensation > 0.0:
        notes.append(
            f"the model file was never calibrated: by its [uncertainty] the friction may be {100.0 * uncertain:.0f} % "
            "of the file's value. Until a motion proves more, an energy credit limits the compensation; tsa tune "
            "measures the friction"
        )
    if not sees and compensation > 0.0:
        notes.append(
            "no sensor proves the friction of this axis (no joint torque sensor, no usable elongation). At most "
            f"{100.0 * unseen:.0f} % of it is compensated. At a constant set-point the compensation is withdrawn once "
            "the joint has moved on it. While the set-point changes by a fifth of the friction within a second, "
            "nothing bounds the motion of a joint whose friction is less"
        )
    return Bound(seen, unseen, tuple(notes))


def unmeasured_notes(settings: BendingSettings, model: TendonSheath) -> tuple[str, ...]:
    """Return a note on the friction that stays uncompensated because the angles of some joints are never measured."""
    routing, unmeasured = routing_of(settings, model.routing), settings.unmeasured
    if routing is None or not unmeasured:
        return ()
    ends = []
    for end in (0, 1):
        added = [
            route.extremes_by(name, span)[end] for route in (routing.a, routing.b) for name, span in unmeasured.items()
        ]
        theta = max(0.0, model.bending_angle + 0.5 * sum(added))
        pretension = max(0.0, model.pretension + model.pretension_slope * (theta - model.bending_angle))
        ends.append(abs(sliding(model, 1.0, model.friction_coefficient * theta, pretension).half_loop))
    least, most = ends
    spans = ", ".join(f"'{name}' ({low:g} to {high:g} rad)" for name, (low, high) in unmeasured.items())
    return (
        f"the angle of joint {spans} is not measured: the friction torque of this axis may be {1e3 * least:.0f} to "
        f"{1e3 * most:.0f} mN*m at the joint. The least is compensated, {100.0 * least / max(most, 1e-12):.0f} % of "
        f"the most; expect an error of up to {1e3 * (most - least):.0f} mN*m. An encoder at that joint removes it",
    )


def interval_share(model: TendonSheath) -> float | None:
    """Return the lower end of the friction torque's interval over its value, at most 1; None without a calibration."""
    low = model.half_loop_low
    if low is None:
        return None
    value = abs(sliding(model).half_loop)
    return min(1.0, max(0.0, low / value)) if value > 0.0 else 1.0


def bending_share(model: TendonSheath, span: float) -> float:
    """Return the least friction torque at the motor with Theta within 1 -+ `span` of the file's, over the file's, 1."""
    nominal = abs(sliding(model).motor_half_loop)
    if span == 0.0 or nominal == 0.0:
        return 1.0
    least = 1.0
    for k in range(-_STEPS, _STEPS + 1):
        factor = 1.0 + span * k / _STEPS
        tension = model.pretension + model.pretension_slope * model.bending_angle * (factor - 1.0)
        h = abs(sliding(model, 1.0, factor * model.friction_angle, max(0.0, tension)).motor_half_loop)
        least = min(least, h / nominal)
    return least


KNEE = 0.4  # of the capacity, below which the share falls with the remaining energy, so that a person feels no step
EMPTY = 0.02  # of the capacity, below which the term is withdrawn
STANDS = 0.02  # N*m/s; a set-point that changes more slowly counts as constant
RISE = 10.0  # 1/s at which the limit rises; it falls without delay
RESTED = 0.5  # s of rest after which motion is a new motion: a swinging leg reverses within 0.2 s
MOVED = 0.1  # rad of joint motion without the term, after a rest, that fill the credit
REQUEST = 0.2  # of the friction torque: change of the set-point that requests motion of a resting joint again
REQUESTED = 1.0  # s after such a change, for which motion counts as requested: a slow stroke takes longer than a second
LASTING = 2.0  # s of motion without the term that fill the credit: friction stops a person's joint in less time
MOST_FILLS = 16.0  # capacities at most, doubled at each such motion, because a person who continues to walk needs them
# s without a reading, while the set-point requests motion, after which the last upper bound is outdated. More friction
# than the last reading may hold the joint, and a smaller term would never reveal it. A slow reversal takes less time.
OUTDATED = 0.3
# 1/s, of the model's friction torque, at which that bound then rises, and the term by half of it. If the bound is
# dropped at once, a joint with 0.75 of the file's friction is driven after each rest, and the guard latches. On random
# rigs, the error is then up to four times as large.
AGING = 0.2
MORE_THAN_FILE = 1.02  # of the file's friction torque: beyond rounding
LEFT = 0.5  # of the desired term; a larger proven friction is not reported as a withdrawal
LESS = 0.9  # of the model's friction torque; a proven upper bound below this is reported
SURELY_LESS = 0.1  # rad of joint motion that must confirm it, because the start of one stroke is not enough


class Requests:
    """Detect that the set-point asks for motion: it has moved by a least change within the last `REQUESTED` s.

    Both ends of its recent range approach the present value at the rate that forgets the least change in this time.
    """

    def __init__(self, period: float) -> None:
        """Prepare the range; `period` in s."""
        self._forget = period / REQUESTED
        self.reset()

    def reset(self) -> None:
        self._low, self._high = math.inf, -math.inf  # N*m, recent range of the set-point

    def update(self, tau_j_des: float, least: float) -> bool:
        """Return True if motion is requested; `least`: N*m of change that requests it."""
        step = self._forget * least
        self._low = min(tau_j_des, max(self._low + step, tau_j_des - 2.0 * least))
        self._high = max(tau_j_des, min(self._high - step, tau_j_des + 2.0 * least))
        return self._high - self._low > least


class EnergyCredit:
    """Limit the energy (J) of a friction term on the joint without proof; `share` (1) is the permitted part."""

    def __init__(self, capacity: float, period: float) -> None:
        """Start with a full credit; `capacity` in J, `period` in s."""
        self._capacity = capacity
        self._size = self._left = capacity
        self._period = period
        self.reset()

    @property
    def capacity(self) -> float:
        return self._capacity

    @capacity.setter
    def capacity(self, value: float) -> None:
        """Change the capacity (J); spent credit stays spent."""
        more = value - self._capacity
        self._capacity = value
        self._size = max(value, self._size + more)
        self._left = min(self._size, max(0.0, self._left + more))

    @property
    def left(self) -> float:
        """Return the credit that is left, J."""
        return self._left

    def reset(self) -> None:
        """Fill the credit at a new enable."""
        self._size = self._left = self._capacity
        self.withdrawn = False
        self._forget()

    def _forget(self) -> None:
        self._rest = self._moved = self._moving = 0.0
        self._rested = False
        self._asked = 0.0  # N*m, set-point at which the credit was last spent

    @property
    def share(self) -> float:
        if self.withdrawn:
            return 0.0
        return min(1.0, self._left / (KNEE * self._size))

    def update(self, unproven: float, velocity: float, tau_j_des: float, request: float, suspended: bool) -> None:
        """Account for one cycle.

        Args:
            unproven: part of the term beyond the proven friction, in the direction of motion, N*m at the joint.
            velocity: joint velocity, rad/s, 0 within its noise.
            tau_j_des: set-point, N*m.
            request: change of the set-point that requests motion again, N*m.
            suspended: True if no credit is spent in this cycle.
        """
        if velocity == 0.0:
            self._moving = 0.0
            self._rest += self._period
            if self._rest > RESTED:
                self._rested = True
                if self.share < 1.0 and abs(tau_j_des - self._asked) > request:
                    self._fill(max(1.0, self._left / self._capacity))
            return
        self._rest = 0.0
        way = abs(velocity) * self._period
        spent = unproven * way
        if spent < 0.0:
            self._left = min(self._size, self._left - spent)
            if self.withdrawn and self._left > KNEE * self._size:
                self._fill(1.0)
        elif self.withdrawn:
            if tau_j_des * velocity <= 0.0:
                self._moved_without(way)
        elif suspended:
            if abs(tau_j_des - self._asked) > request:
                self._left = self._size
        else:
            self._left -= spent
            if self._left <= EMPTY * self._size:
                self.withdrawn = True
                self._forget()
            self._asked = tau_j_des

    def _moved_without(self, way: float) -> None:
        self._moving += self._period
        if self._rested:
            self._moved += way
            if self._moved > MOVED:
                self._fill(1.0)
        elif self._moving > LASTING:
            self._fill(min(MOST_FILLS, 2.0 * self._size / self._capacity))

    def _fill(self, capacities: float) -> None:
        self._size = self._left = capacities * self._capacity
        self.withdrawn = False
        self._forget()


class CompensationLimit:
    """Limit the law's share of the model's friction term.

    Attributes:
        room: 1, of the model's friction torque, by which a torque sensor may raise the term.
        count, words: number of reports, and the last one.
    """

    def __init__(
        self,
        bound: Bound,
        proven: FrictionProof,
        capacity: float,
        gearing: float,
        period: float,
        untrusted_capacity: float | None = None,
    ) -> None:
        """Start at the bound of the files, with a model file that is not trusted.

        Args:
            bound: bound by the model file and the range of the wrap angle.
            proven: friction torque that the sensors prove.
            capacity: capacity of the credit, J.
            gearing: r_J/r_M.
            period: s.
            untrusted_capacity: capacity for a file that is neither trusted nor confirmed, J; default `capacity`.
        """
        self.bound = bound
        self.proven = proven
        self._capacity = capacity
        self._untrusted_capacity = capacity if untrusted_capacity is None else untrusted_capacity
        self._trusted = self._confirmed = False
        self.credit = EnergyCredit(self._untrusted_capacity, period)
        self._requests = Requests(period)
        self.ceiling = bound.seen if proven.usable else bound.unseen
        self._gearing = gearing
        self._period = period
        self._step = RISE * period
        self.count = 0
        self.words = ""
        self.reset()

    def reset(self) -> None:
        """Restart at an enable; the proven friction is kept."""
        self.credit.reset()
        self._requests.reset()
        self._noted = False
        self._less = self._unread = 0.0  # rad, s
        self._driven, self._driven_for = math.inf, 0.0  # N*m at the motor by the energy guard, its age in s
        self.room = 0.0
        self.share = self._desired = self.ceiling

    @property
    def trusted(self) -> bool:
        """Return True if a tuning of this joint wrote the model file."""
        return self._trusted

    @trusted.setter
    def trusted(self, value: bool) -> None:
        """Set whether the file belongs to the nodes of a bring-up; their friction is not confirmed yet."""
        self._trusted, self._confirmed = value, False
        self.proven.trusted = value
        self.credit.capacity = self._capacity if value else self._untrusted_capacity

    def observe(self, friction: float) -> None:
        """Store the friction torque (N*m at the motor) by the energy guard, which is valid until the next reading."""
        self._driven, self._driven_for = friction, 0.0

    def update(
        self,
        half_loop: float,
        term: float,
        omega_j: float,
        tau_j_des: float,
        rate: float,
        compensation: float,
        tau_j: float = math.nan,
    ) -> float:
        """Return the share for the next cycle.

        Args:
            half_loop: friction torque of the model in use, N*m at the motor.
            term: friction term as sent, N*m at the motor.
            omega_j: joint velocity, rad/s, 0 within its noise.
            tau_j_des, rate: set-point and its slope, N*m and N*m/s.
            compensation: desired share of the friction.
            tau_j: torque of a joint torque sensor that the elongation confirms, N*m, nan without one.
        """
        proven, credit = self.proven, self.credit
        low, middle, high = proven.low, proven.middle, proven.high
        enough = low >= self.bound.unseen * proven.modelled
        if proven.reads and not self._confirmed and enough and proven.confirms_file:
            self._confirmed = True
            self.credit.capacity = self._capacity
        along = term if omega_j >= 0.0 else -term
        asked = not -STANDS < rate < STANDS
        if proven.reads:
            self._unread, self._driven = 0.0, math.inf
        elif asked or self._unread > OUTDATED:  # an outdated bound stays outdated until the next reading
            self._unread += self._period
        if self._unread > OUTDATED:
            grown = half_loop > MORE_THAN_FILE * proven.modelled  # an estimator has found that the friction has grown
            rise = math.inf if grown else AGING * (self._unread - OUTDATED) * half_loop
            middle, high = middle + 0.5 * rise, high + rise
        before = credit.withdrawn
        request = REQUEST * self._gearing * half_loop
        suspended = self._requests.update(tau_j_des, request) and asked and not proven.usable
        unproven = self._gearing * (along - low)
        excess = tau_j - tau_j_des if omega_j >= 0.0 else tau_j_des - tau_j
        if unproven > 0.0 and excess < unproven:  # nan without a sensor
            unproven = excess if excess > 0.0 else 0.0
        credit.update(unproven, omega_j, tau_j_des, request, suspended)
        self._desired = desired = compensation if compensation < self.ceiling else self.ceiling
        friction = half_loop if half_loop < middle else middle
        if self._driven < math.inf:
            self._driven_for += self._period
            friction = min(friction, self._driven + AGING * self._driven_for * half_loop)
        most = desired * friction
        allowed = low if low < most else most
        if allowed < most:
            allowed += credit.share * (most - allowed)
        if half_loop > 0.0:  # the friction may exceed the file's value: the sensor then adds to the term
            more = most + MORE * half_loop
            lowest = low if low < more else more
            self.room = (lowest + credit.share * (more - lowest) - allowed) / half_loop
        share = allowed / half_loop if half_loop > 0.0 else desired
        rise = self.share + self._step
        self.share = share if share < rise else rise
        if credit.withdrawn and not before and low < LEFT * most:
            self._report(
                "the friction term is withdrawn: the joint moved on it, and no sensor confirms that the friction is "
                "that large; move the joint by hand, or calibrate the model"
            )
        elif high < LESS * desired * half_loop and not self._noted:
            self._less += abs(omega_j) * self._period
            self._noted = self._less > SURELY_LESS
            if not self._noted:
                return self.share
            self._report(
                f"the measured friction torque is at most {100.0 * high / half_loop:.0f} % of the model's: the "
                "compensation follows it; check pretension and sheath, or run tsa tune"
            )
        return self.share

    @property
    def reason(self) -> Reason:
        """Return the reason for less compensation than the files allow, for the log."""
        return Reason.UNPROVEN if self.share < LESS * self._desired else Reason.NONE

    def _report(self, words: str) -> None:
        self.count += 1
        self.words = words
