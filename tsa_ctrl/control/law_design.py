"""Derive the times and gains of an axis's law from its model, its settings and the delay.

All values that [axis.law] leaves out are derived here once, before the loop starts:

* the delay from a measurement to the acting torque: the setting, or otherwise the sum of transport (a period with
  rpdo = "sync"), half a period of hold, and the torque loop of the drive;
* the duration of a friction reversal: `TURN` plus `HELD` periods with all bends before the middle of the sheath. It is
  shorter with bends nearer to the joint, because no front hides it there. Without a known motor inertia, no motor
  motion is planned. The reversal then takes `BLIND` s, which is slow enough for a light motor on stiff tendons. A limit
  of [axis.limits] or of the drive can lengthen it. The speed limits latch a fault, so they also lengthen a reversal of
  [axis.law];
* the damping that keeps a gain margin of 2 (`gain_margin`); 0 if no damping keeps it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.control.damping import FORGET
from tsa_ctrl.control.reversal import FrictionReversal, ReversalFront, front_of
from tsa_ctrl.errors import UsageError, rounded_down
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.steady_sliding import joint_side_compliance, motor_stiffness, sliding, wound_by_friction
from tsa_ctrl.safety.limiter import LimiterSettings

LAG = 0.5e-3  # s, torque loop of a drive; the known drives are faster
LEAST = 2.0  # required gain margin
STIFFNESS = (0.8, 1.0, 1.25)  # of the model's stiffness: the uncertainty before the tendons are measured
# Multiples of the model's stiffness at which a motor with a resting joint may oscillate. Friction locks the tendon from
# its first bend on. A first bend within a fifth of the length absorbs the oscillation itself.
LOCKED = (1.6, 2.5, 5.0)
# Growth of the amplitude in one oscillation that the hysteresis of locked tendons absorbs. On 21 random rigs at 400 and
# 1000 Hz, damping with up to 1.17 was useful or had no effect. With 1.29, a locked joint kept oscillating.
ABSORBED = 1.2
SHARE = 0.32  # of sqrt(K J_M), largest useful gain: a sixth of critical damping, which ends a swing in two periods
WORTH = 0.05  # of sqrt(K J_M); below it, damping is not worth its noise
_MOST = 64.0
_OUTSIDE = 1.0 + 1e-9


def gain_margin(gain: float, inertia: float, stiffness: float, delay: float, period: float) -> float:
    """Return the smallest gain margin of the damping over `STIFFNESS`; 0 if the loop is unstable with this gain.

    The margin is the factor by which the gain may grow before the loop of motor, drive and `damping` becomes unstable.
    The loop is linear while the tendons slide. Friction is neglected, because it only adds damping.

    Args:
        gain: N*m*s/rad.
        inertia: J_M, kg*m^2.
        stiffness: K, N*m/rad.
        delay: s from a measurement to the acting torque, with half a period of hold and the drive's torque loop.
        period: s.
    """
    return min(_margin(gain, inertia, share * stiffness, stiffness, delay, period) for share in STIFFNESS)


def is_stable_at_rest(gain: float, inertia: float, stiffness: float, delay: float, period: float) -> bool:
    """Return True if the swing grows by at most `ABSORBED` with each of `LOCKED`; arguments as for `gain_margin`."""
    for share in LOCKED:
        oscillation = 2.0 * math.pi * math.sqrt(inertia / (share * stiffness)) / period  # periods
        # a sampled oscillation has at least two periods
        growth = _radius(gain, inertia, share * stiffness, stiffness, delay, period) ** max(2.0, oscillation)
        if growth > ABSORBED:
            return False
    return True


def largest_gain(inertia: float, stiffness: float, delay: float, period: float) -> float:
    """Return the largest useful gain (N*m*s/rad) that keeps the margin; 0 if that gain is too small to be useful."""
    scale = math.sqrt(stiffness * inertia)
    gain = SHARE * scale
    margin = gain_margin(gain, inertia, stiffness, delay, period)
    while margin < LEAST:
        gain *= 0.9 if margin == 0.0 else margin / LEAST * 0.999
        if gain < WORTH * scale:
            return 0.0
        margin = gain_margin(gain, inertia, stiffness, delay, period)
    return gain


def _margin(gain: float, inertia: float, stiffness: float, believed: float, delay: float, period: float) -> float:
    def stable(factor: float) -> bool:
        return _is_stable(factor * gain, inertia, stiffness, believed, delay, period)

    if not stable(1.0):
        return 0.0
    low = high = 1.0
    while stable(high):
        if high > _MOST:
            return _MOST
        low, high = high, 1.3 * high
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def _is_stable(gain: float, inertia: float, stiffness: float, believed: float, delay: float, period: float) -> bool:
    return _radius(gain, inertia, stiffness, believed, delay, period) <= _OUTSIDE


def _radius(gain: float, inertia: float, stiffness: float, believed: float, delay: float, period: float) -> float:
    """Return the largest growth of a mode within one period, 1."""
    return float(np.abs(np.linalg.eigvals(loop_matrix(gain, inertia, stiffness, believed, delay, period))).max())


def loop_matrix(
    gain: float, inertia: float, stiffness: float, believed: float, delay: float, period: float
) -> NDArray[np.float64]:
    """Return the exact transition matrix of the closed loop over one period.

    Its states are angle, speed and torque of the motor, the commands in transit, and the slow mean of `damping`. The
    loop is stable if no eigenvalue lies outside the unit circle. `believed`: stiffness of the prediction, N*m/rad.
    """
    ringing = math.sqrt(believed / inertia)
    cosine, sine = math.cos(ringing * delay), ringing * math.sin(ringing * delay)
    late = max(0.0, (delay - LAG - 0.5 * period) / period)  # periods between measurement and start of the hold
    whole = math.ceil(late - 1e-9)
    part = whole - late  # of a period in which the newest of two commands acts
    motor = np.array([[0.0, 1.0, 0.0], [-stiffness / inertia, 0.0, 1.0 / inertia], [0.0, 0.0, -1.0 / LAG]])
    push = np.array([[0.0], [0.0], [1.0 / LAG]])
    first, first_push = _held(motor, push, period * (1.0 - part))
    second, second_push = _held(motor, push, period * part)
    size = 3 + whole + 1
    step = np.zeros((size, size))
    step[:3, :3] = second @ first
    command = np.zeros(size)
    forget = period / (FORGET + period)
    command[0] = gain * sine * (1.0 - forget)
    command[1] = -gain * cosine
    command[-1] = -gain * sine * (1.0 - forget)
    sent = [command, *(np.eye(size)[3 + i] for i in range(whole))]  # newest first
    step[:3, :] += second @ first_push * sent[whole] + second_push * sent[max(0, whole - 1)]
    for i in range(whole):
        step[3 + i] = sent[i]
    step[-1, 0], step[-1, -1] = forget, 1.0 - forget
    return step


def _exponential(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the exponential of a square matrix by scaling, a power series and squaring.

    scipy.linalg.expm would load 35 MB into the daemon.
    """
    halvings = max(0, math.ceil(math.log2(max(1e-300, float(np.abs(matrix).sum(axis=1).max())))) + 1)
    small = matrix / 2.0**halvings  # of norm 1/2 at most: 16 terms are exact to the last digit
    term = whole = np.eye(len(matrix))
    for order in range(1, 17):
        term = term @ small / order
        whole = whole + term
    return np.linalg.matrix_power(whole, 2**halvings)


def _held(
    motor: NDArray[np.float64], push: NDArray[np.float64], time: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the transition of the motor's state over `time` s, and the effect of a constant command of 1 N*m."""
    block = np.zeros((4, 4))
    block[:3, :3], block[:3, 3:] = motor, push
    whole = _exponential(block * time)
    return whole[:3, :3], whole[:3, 3:]


# s of a reversal, for bends up to the middle of the sheath and for all at the joint, and the periods that are added,
# because the torque is held for a period. At 250 Hz, a reversal of 8 periods has twice the error of 4 to 5 (34 instead
# of 17 mN*m with a prescribed gait). At 1 kHz, 5 periods let a heavy motor oscillate (24 instead of 6 mN*m).
TURN, TURN_AT_JOINT, HELD = 5e-3, 2e-3, 3
BLIND = 0.02  # s of a reversal without a motor inertia
LONGEST_TURN = 0.06  # s; a slower reversal does not follow a gait, so a limit of rate or torque then cuts it instead
MOST_TURN = 0.2  # s; a speed limit must not require more
SPEED_SHARE = 0.6  # of the speed limit: the joint moves as well, and an estimate may find 1.6 times the friction
# Share of the limiter's rate that a reversal may use: bends up to the middle of the sheath, and all bends at the joint.
# With bends at the joint, the friction reverses immediately, so a short reversal matters more. The limiter bounds only
# growing torques and cuts a step or two. With prescribed gait and a friction angle of 0.8, the error is 145 mN*m with
# 2.4 or 3.2, and 164 mN*m with 1.6.
RATE_SHARE, RATE_SHARE_AT_JOINT = 0.8, 2.4
# Slope of the inertia's torque in a reversal, over that rate. That torque has both signs, and only its growth is
# bounded. With bends at the joint, a motor of 3.2e-4 kg*m^2 that reverses in 5.5 ms at five times the rate keeps
# oscillating after the cut, with 43 mN*m instead of the 34 mN*m at three times the rate (7 ms). The slope of a lighter
# motor is far smaller.
RATE_OF_INERTIA = 3.0
TORQUE_SHARE = 0.35  # of the limiter's torque that the motor's inertia may require
MOST_LEAD = 0.03  # s; a prediction farther ahead would be a guess


class Limits(NamedTuple):
    """Hold the limits of one axis that a planned reversal must respect, at the motor."""

    rate: float  # N*m/s
    torque: float  # N*m
    distance: float = math.inf  # N*m, command beyond measured torque
    speed: float = math.inf  # rad/s
    speed_key: str = "limits.motor_over_speed"  # the key that sets `speed`
    gearing: float = 1.0  # r_J/r_M
    joint_speed: float = 0.0  # rad/s of the joint, at which the torque has faded to 0

    @classmethod
    def of(cls, limits: LimiterSettings, max_speed: float, model: TendonSheath, has_encoder: bool) -> Limits:
        """Return the limits of an axis; `max_speed`: the drive's own clamp, rad/s."""
        gearing = model.joint_pulley_radius / model.motor_pulley_radius
        speeds = {"limits.motor_over_speed": limits.motor_over_speed, "drive.max_speed": max_speed}
        if not has_encoder:  # the motor speed then replaces the joint speed
            speeds["limits.over_speed"] = gearing * limits.over_speed
            speeds["limits.joint_speed"] = gearing * limits.joint_speed
        key = min(speeds, key=lambda name: speeds[name])
        distance = limits.distance or limits.torque
        return cls(limits.rate, limits.torque, distance, speeds[key], key, gearing, limits.joint_speed)


@dataclass(frozen=True)
class Plan:
    """Hold the parameters of one axis's law in SI units; `notes` explain the limits of this rig."""

    front: ReversalFront
    delay: float  # s, from a measurement to the acting torque
    turn: float  # s, duration of a friction reversal
    lead: float  # s, by which the joint velocity is extrapolated
    inertia: float  # kg*m^2 of the motor; 0: unknown
    stiffness: float  # N*m/rad, K
    ringing: float  # rad/s, 0 without an inertia
    damping: float  # N*m*s/rad
    margin: float  # of the damping's gain; inf without damping
    damps_at_rest: bool  # False if the motor would swing on tendons that friction locks
    reach: float  # m of tendon per N*m of desired torque, at a joint at rest
    give: float  # m of tendon per N*m of desired torque, at a moving joint; 0 with all bends at the joint
    notes: tuple[str, ...] = ()


def design_law(
    model: TendonSheath,
    *,
    period: float,
    transport: float,
    late: float,
    has_encoder: bool,
    limits: Limits,
    delay: float | None = None,
    turn: float | None = None,
    lead: float | None = None,
    inertia: float | None = None,
    ringing: float | None = None,
    damping: float | None = None,
    filtered: float = 0.0,
    where: str = "",
) -> Plan:
    """Derive the values that [axis.law] leaves out (None).

    Args:
        transport: s until the drive applies a command.
        late: s, delay of the motor's velocity.
        filtered: s, delay of the joint velocity in a log by the loop's filter; a model's velocity_lag contains it.
        ringing: Hz, of the motor on its tendons.

    Raises:
        UsageError: a damping has no margin, or no reversal respects a speed limit.
    """
    front = front_of(model)
    total = transport + 0.5 * period + LAG if delay is None else delay
    stiffness, mass = motor_stiffness(model), inertia or 0.0
    omega = 2.0 * math.pi * ringing if ringing else math.sqrt(stiffness / mass) if mass else 0.0
    notes: list[str] = []
    if turn is None:
        rate = min(limits.rate, limits.distance / (total + period))  # the measured torque has this delay
        turn = _duration(model, front, stiffness, mass, period, limits._replace(rate=rate))
    half_loop = abs(sliding(model).motor_half_loop)
    turn = _slowed(turn, _way(front, half_loop, stiffness), limits, where, notes)
    reached = limits.speed / limits.gearing
    if reached < (1.0 - 1e-9) * limits.joint_speed:
        notes.append(
            f"{limits.speed_key} {limits.speed:.3g} rad/s is reached at a joint speed of {reached:.3g} rad/s, before "
            f"limits.joint_speed {limits.joint_speed:.3g} rad/s has faded the torque: lower joint_speed below "
            f"{reached:.3g} rad/s, or raise {limits.speed_key}"
        )
    if half_loop >= limits.torque:
        notes.append(
            f"limits.torque {limits.torque:g} N*m does not exceed the friction torque of {half_loop:.3g} N*m at the "
            "motor: not all of the friction is compensated; raise limits.torque or lower the pretension"
        )
    if not mass:
        notes.append(
            f"law.motor_inertia is not given: reversals are turned in {1e3 * turn:.0f} ms, and the motor's swing on "
            "its tendons is not damped; give it from the motor's data sheet"
        )
    if not has_encoder:
        notes.append(
            "without a joint encoder the motor angle replaces the joint angle: reversals are not predicted, the torque "
            "turns late, and the motor's swing on its tendons is not damped"
        )
        lead = 0.0
    gain, margin = _damping(damping, mass, omega, total + late, period, has_encoder, where, notes)
    lag = model.effects.get("velocity_lag")
    known = 0.5 * turn + total + (max(0.0, float(lag["time_constant"]) - filtered) if lag else 0.0)
    if known > MOST_LEAD and lead is None:
        notes.append(
            f"a reversal would have to be known {1e3 * known:.0f} ms ahead (half a turn and all delays); it is led by "
            f"{1e3 * MOST_LEAD:.0f} ms, and the torque turns late"
        )
    moving = joint_side_compliance(model)
    at_rest = max(moving, 0.5 * model.unstrained_length / model.axial_stiffness)
    return Plan(
        front=front,
        delay=total,
        turn=turn,
        lead=min(MOST_LEAD, known) if lead is None else lead,
        inertia=mass,
        stiffness=stiffness,
        ringing=omega,
        damping=gain,
        margin=margin,
        damps_at_rest=gain > 0.0 and is_stable_at_rest(gain, mass, mass * omega**2, total + late, period),
        reach=at_rest / (2.0 * model.joint_pulley_radius),
        give=moving / (2.0 * model.joint_pulley_radius),
        notes=tuple(notes),
    )


def reversal_speed(model: TendonSheath, turn: float | None, period: float) -> float:
    """Return the speed of the motor, rad/s, in a friction reversal at a joint at rest; `turn` and `period` in s."""
    return wound_by_friction(model) / (turn or TURN + HELD * period)


def _way(front: ReversalFront, half_loop: float, stiffness: float) -> float:
    """Return the motion of the motor in a whole friction reversal, rad."""
    return 2.0 * front.centre * half_loop / stiffness


def _slowed(turn: float, way: float, limits: Limits, where: str, notes: list[str]) -> float:
    """Return the reversal time (s), lengthened until the peak motor speed of a cycloid, 2 way/turn, is in the limit."""
    allowed = SPEED_SHARE * limits.speed
    if turn * allowed >= 2.0 * way:
        return turn
    least = 2.0 * way / allowed
    if least > MOST_TURN:
        raise UsageError(
            f"{where}: {limits.speed_key} allows a motor speed of {limits.speed:.3g} rad/s; a friction reversal within "
            f"{MOST_TURN:g} s needs {2.0 * way / MOST_TURN / SPEED_SHARE:.3g} rad/s; raise {limits.speed_key} or lower "
            "the pretension"
        )
    if least > LONGEST_TURN:
        notes.append(
            f"a friction reversal takes {1e3 * least:.0f} ms, because {limits.speed_key} allows a motor speed of "
            f"{limits.speed:.3g} rad/s: the torque follows a gait late; raise it if the rig allows that"
        )
    return least


def _duration(
    model: TendonSheath, front: ReversalFront, stiffness: float, inertia: float, period: float, limits: Limits
) -> float:
    """Return the duration of a friction reversal that the limits of rate and torque allow, s."""
    half_loop = abs(sliding(model).motor_half_loop)
    to_joint = max(0.0, 2.0 * front.centre - 1.0)
    shortest = TURN - (TURN - TURN_AT_JOINT) * to_joint + HELD * period
    share = RATE_SHARE + (RATE_SHARE_AT_JOINT - RATE_SHARE) * to_joint
    duration = shortest if inertia else max(BLIND, shortest)
    moved = _way(front, half_loop, stiffness)
    while duration < LONGEST_TURN:
        step = 2.0 * half_loop * FrictionReversal(front, duration, period).steepest()
        swing = 2.0 * math.pi * inertia * moved / duration**2
        slope = 2.0 * math.pi * swing / duration
        rate, torque = limits.rate, limits.torque
        if step <= share * rate * period and swing <= TORQUE_SHARE * torque and slope <= RATE_OF_INERTIA * rate:
            break
        duration += 0.5 * period
    return min(duration, LONGEST_TURN) if duration > shortest else duration


def _damping(
    wanted: float | None,
    inertia: float,
    ringing: float,
    delay: float,
    period: float,
    has_encoder: bool,
    where: str,
    notes: list[str],
) -> tuple[float, float]:
    """Return the damping gain (N*m*s/rad) and its gain margin."""
    if wanted == 0.0 or not inertia or not has_encoder:
        return 0.0, math.inf
    stiffness = inertia * ringing**2
    gain = largest_gain(inertia, stiffness, delay, period)
    if wanted is None:
        if gain == 0.0:
            notes.append(
                f"a delay of {1e3 * delay:.1f} ms leaves no gain margin of {LEAST:g} at a ringing of "
                f"{ringing / (2.0 * math.pi):.0f} Hz: the motor's swing is not damped"
            )
            return 0.0, math.inf
        return gain, gain_margin(gain, inertia, stiffness, delay, period)
    margin = gain_margin(wanted, inertia, stiffness, delay, period)
    if margin < LEAST:
        raise UsageError(
            f"{where}: law.damping {wanted:g} N*m*s/rad has a gain margin of {margin:.2g} at a delay of "
            f"{1e3 * delay:.1f} ms and a ringing of {ringing / (2.0 * math.pi):.0f} Hz; allowed is {LEAST:g}: give at "
            f"most {rounded_down(gain, 2)}, or leave it out"
        )
    return wanted, margin
