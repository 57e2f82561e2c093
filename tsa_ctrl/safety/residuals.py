"""Compare each measured signal of an axis with its prediction from the other signals, without a law or a model.

`Elongation` compares the elongation a = q_m - (r_J/r_M) q_j with the motor torque. With the stiffness K at the motor
and the friction torque h of the tendons, the zero of the encoders is

    a_0 = a - tau/K + f,        f = (1 - s_c) z h/K,   -1 <= z <= 1

Two rules follow. Neither needs the load, a speed or a joint torque sensor:

    response   f changes only with the torque or with the motion of the joint, and in their direction. If the motor
               moves without a change of either, its torque differs from the reported one.
    friction   f is bounded, so all observed zeros must fit into one interval. The changes of torque and joint angle
               also determine how close f is to its bounds.

`Velocity` compares the reported velocity with the change of the position. `Standstill` detects a position that stops
more suddenly than a joint can. `SensorNoise` detects a sensor whose noise has ended.

All limits are widths in rad at the motor. The zero may drift, so old samples lose their weight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

SMOOTH = 0.005  # s, low-pass of torque and angles: a motor rings on its tendons at 40 Hz and more
SAMPLES = 5.0  # least number of periods of that low-pass and of a residual: a slow loop samples the ringing too rarely
DOUBT = 0.25  # 1, least uncertainty of the stiffness: covers a stiffness 20 % below the file's value
FRICTION = 0.6  # 1, least uncertainty of friction: the bound up to which an estimator may change it
LATE = 1e-3  # s, delay between the two encoders
GEARING = 0.02  # 1, of the joint's path: effective radii of the tendons, eccentric encoders
CREEP = 0.01  # rad/s, fastest drift of the zero
BACKLASH = 3e-3  # rad, at motor and joint each
# rad, limit of the first rule. Healthy rigs reach 2.6e-3: a wearer at a friction angle of 0.8, with a file 20 % off.
RESPONSE = 2.85e-3
BOUND = 9e-3  # rad, limit of the second rule; the same rigs reach 5.3e-3
HEAVY = 6e-4  # kg*m^2, motor inertia assumed if it is unknown
LIGHT = 0.2  # 1, uncertainty of a known motor inertia
NOISE = 6e-3  # N*m, fluctuation of a reported torque that moves no motor
LASTING = 1e-3  # s that a filtered residual must last: the ringing after a motor reversal exceeds the limit briefly


@dataclass(frozen=True)
class Give:
    """The compliance of tendons, pulleys and encoders of an axis, at the motor.

    Attributes:
        stiffness: stiffness at the motor, N*m/rad.
        wound: change of the elongation by friction between the two directions of motion, rad.
        domain: torque above which one tendon pulls alone and the compliance doubles, N*m.
        play: encoder counts and known backlash, rad.
        doubt: uncertainty of the stiffness, 1.
        free: largest 1 - s_c, the share of the friction that contributes to the elongation, 1.
        least_free: smallest 1 - s_c, 1.
        friction: uncertainty of the friction, 1.
        inertia: motor inertia, kg*m^2; 0 if unknown.
    """

    stiffness: float
    wound: float
    domain: float
    play: float
    doubt: float
    free: float
    least_free: float
    friction: float
    inertia: float


class Elongation:
    """Check the elongation of one axis. Call `update` for every fresh sample with torque, and `reset` without torque.

    Attributes:
        reversed: True if the motor moved against its reported torque.
    """

    def __init__(self, give: Give, period: float) -> None:
        """Prepare the check; `period` is in s."""
        self._compliance = compliance = 1.0 / give.stiffness
        self._late = LATE / period
        self._doubt = give.doubt
        self._domain = give.domain
        self._inertia = give.inertia / period
        self._unsure = compliance * (LIGHT * give.inertia if give.inertia > 0.0 else HEAVY) / period
        self._play = give.play  # rad of the joint: a smaller change may be encoder counts only
        self._response = RESPONSE + 2.0 * give.play  # once in the elongation, once in a joint motion that is not seen
        self._bound = BOUND + give.play
        half = 0.5 * give.free * give.wound
        self._most_friction = half * (1.0 + give.friction)
        self._turn = 1.0 / max(0.5 * give.least_free * give.wound * (1.0 - give.friction), 1e-9)
        self._slide = 2.0 / ((1.0 + give.friction) * (1.0 + give.doubt) * give.wound + BACKLASH + give.play)
        self._creep = CREEP * period
        self._smooth = 1.0 - math.exp(-period / max(SMOOTH, SAMPLES * period))
        self.reset()

    def reset(self) -> None:
        """Reset all state for the next enable."""
        self._torque = math.nan
        self._motor = self._joint = self._speed = self._change = 0.0
        self._rose = self._fell = 0.0  # rad, paths of the joint up and down that the low-pass has not passed yet
        self._torque_seen = self._joint_seen = 0.0  # N*m, rad, without their noise
        self._least, self._most = -1.0, 1.0  # bounds of z
        self._low, self._high = -math.inf, math.inf  # rad, bounds of a - tau/K by the first rule
        self._top, self._bottom = -math.inf, math.inf  # rad, lower and upper bound of the zero
        self._low_pull = self._high_pull = self._top_pull = self._bottom_pull = 0.0  # N*m, motor torque at each bound
        self.reversed = False

    def update(self, torque: float, angle: float, speed: float, joint: float) -> float | None:
        """Return how far the elongation exceeds its limits (rad at the motor), or None while it is within them.

        Args:
            torque: motor torque that the drive reports, N*m.
            angle: motor angle, rad.
            speed: motor speed, rad/s.
            joint: joint angle times r_J/r_M, rad.
        """
        if self._torque != self._torque:
            self._torque = self._torque_seen = torque
            self._motor, self._speed = angle, speed
            self._joint = self._joint_seen = joint
        smooth, doubt, compliance = self._smooth, self._doubt, self._compliance
        step = speed - self._speed
        self._change += smooth * (step - self._change)
        self._speed = speed
        self._torque += smooth * (torque - self._torque)
        moved = smooth * (angle - self._motor)
        self._motor += moved
        self._joint += smooth * (joint - self._joint)
        pull = self._torque - self._inertia * self._change
        seen = self._torque_seen
        turned = pull - NOISE - seen if pull > seen + NOISE else pull + NOISE - seen if pull < seen - NOISE else 0.0
        self._torque_seen += turned
        turned *= compliance
        # The paths up and down are filtered separately. At a reversal the filtered angle still moves in the old
        # direction while the filtered friction already follows the new one.
        seen, play, led = self._joint_seen, self._play, self._joint
        went = joint - play - seen if joint > seen + play else joint + play - seen if joint < seen - play else 0.0
        self._joint_seen += went
        if went > 0.0:
            self._rose += went
        else:
            self._fell -= went
        rose, fell = smooth * self._rose, smooth * self._fell
        self._rose -= rose
        self._fell -= fell
        went = rose - fell
        # The filtered speed scales the delay error, because the raw speed of a ringing motor exceeds 10 rad/s.
        unsure = self._late * abs(moved) + self._unsure * abs(self._change)
        if pull > self._domain or pull < -self._domain:
            unsure += compliance * (abs(pull) - self._domain)
        rest = self._motor - led - compliance * pull
        rise, fall = (turned, 0.0) if turned > 0.0 else (0.0, -turned)
        up, down, loss = rise + doubt * fall + rose, fall + doubt * rise + fell, doubt * (rise + fall)
        drift = self._creep + GEARING * (rose + fell)
        low, high = rest - unsure, rest + unsure
        # The first rule: f grows by at most `up` and falls by at most `down`. `rest` changes in the opposite direction.
        self._low -= up + drift
        self._high += down + drift
        falls, rises = self._low - high - self._response, low - self._high - self._response
        against = (falls > 0.0 and pull > min(0.0, self._low_pull) + NOISE) or (
            rises > 0.0 and pull < max(0.0, self._high_pull) - NOISE
        )
        if low > self._low:
            self._low, self._low_pull = low, pull
        if high < self._high:
            self._high, self._high_pull = high, pull
        # The second rule.
        most = self._most + self._turn * up
        least = self._least - self._turn * down
        way = self._slide * (moved + went)
        if way > 0.0:
            least += way
        else:
            most += way
        self._most = most = 1.0 if most > 1.0 else -1.0 if most < -1.0 else most
        self._least = least = -1.0 if least < -1.0 else most if least > most else least
        if least < 0.0:  # the bounds must also hold without friction
            low += least * self._most_friction
        if most > 0.0:
            high += most * self._most_friction
        self._top -= loss + drift
        self._bottom += loss + drift
        below, above = self._top - high - self._bound, low - self._bottom - self._bound
        beyond = falls > 0.0 or rises > 0.0 or below > 0.0 or above > 0.0
        if beyond:
            self.reversed = (
                against
                or (below > 0.0 and pull > self._top_pull + NOISE)
                or (above > 0.0 and pull < self._bottom_pull - NOISE)
            )
        if low > self._top:
            self._top, self._top_pull = low, pull
        if high < self._bottom:
            self._bottom, self._bottom_pull = high, pull
        return max(falls, rises, below, above) if beyond else None


class Velocity:
    """Compare the reported velocity of the motor with the change of its position.

    A motor may oscillate on its tendons in step with the samples of a slow loop. The velocity at a sample then differs
    from the mean between two samples, so such a loop cannot make this comparison. With gear friction, healthy motors of
    5e-6 to 5e-5 kg*m^2 at 400 to 1000 Hz contradicted their position from 0.43 of an oscillation per period on.

    Attributes:
        by_position: filtered velocity from the position, rad/s.
    """

    LONGEST: ClassVar[float] = 1.0 / 3.0  # of an oscillation, longest period
    OSCILLATION: ClassVar[float] = 133.0  # Hz, of a motor with an unknown inertia

    MEMORY = 0.1  # s, time constant of the comparison
    SHARE = 0.1  # 1, of the path: scale and rounding errors of a healthy drive
    FILTER = 0.01  # s, delay of a drive's velocity filter

    def __init__(self, count: float, period: float) -> None:
        """Prepare the check.

        Args:
            count: one count of the position at the motor, rad.
            period: control period, s.
        """
        self._keep = math.exp(-period / self.MEMORY)
        self._slow = 1.0 - math.exp(-period / self.FILTER)
        self._room = 4.0 * count + 0.02 * self.MEMORY  # 0.02 rad/s: rounding of a coarse velocity
        self._period = period
        self.reset()

    @classmethod
    def is_usable(cls, give: Give, period: float) -> bool:
        """Return True if the loop with this period (s) samples the motor's oscillation on its tendons often enough."""
        known = give.inertia > 0.0
        frequency = math.sqrt(give.stiffness / give.inertia) / (2.0 * math.pi) if known else cls.OSCILLATION
        return period * frequency <= cls.LONGEST

    def skip_cycles(self) -> None:
        """Exclude the motion during a period without a sample, because its mean velocity is unknown."""
        self._angle = math.nan

    def reset(self) -> None:
        """Reset all state."""
        self._angle = math.nan
        self._started = False
        self._difference = self._path = self.by_position = self._bend = 0.0

    def update(self, angle: float, speed: float) -> bool:
        """Return True while position (rad) and velocity (rad/s) contradict each other."""
        period, keep = self._period, self._keep
        if self._angle != self._angle:
            self._angle = angle
            if self._started:
                return False
            self._started, self.by_position = True, speed
        step = angle - self._angle
        self._angle = angle
        reported = speed * period
        self._difference = keep * self._difference + step - reported
        moved, told = abs(step), abs(reported)
        self._path = keep * self._path + (moved if moved > told else told)
        rate = step / period
        change = self._slow * (rate - self.by_position)
        self.by_position += change
        self._bend = keep * self._bend + abs(change)
        return abs(self._difference) > self._room + self.SHARE * self._path + self.FILTER * self._bend


class Standstill:
    """Detect a joint position that repeats its last count although the joint still moves.

    No load stops a joint between two samples. Friction alone can stop a motor that quickly, so motors are not checked.
    """

    SUDDEN = 8.0  # counts per cycle: no load stops a joint between two samples from this speed
    FAST = 0.5  # rad/s, likewise: the friction of a joint stops an inertia of 0.02 kg*m^2 within 10 ms
    RESTED = 0.01  # s for which the count must then rest, because slow devices update the position every 4 ms

    def __init__(self, count: float, period: float) -> None:
        """Prepare the check.

        Args:
            count: one count of the position, rad.
            period: control period, s.
        """
        self._sudden = max(self.SUDDEN * count / period, self.FAST)
        self._rested = max(self.RESTED, 8.0 * period)
        self.reset()

    def reset(self) -> None:
        """Reset all state."""
        self._angle = math.nan
        self._at = self._rate = 0.0

    def update(self, now: float, angle: float) -> bool:
        """Return True while `angle` (rad) rests although the joint was moving; `now` is in s."""
        if angle != self._angle:
            elapsed = now - self._at
            if elapsed > 0.0 and self._angle == self._angle:
                self._rate += (1.0 - math.exp(-elapsed / SMOOTH)) * ((angle - self._angle) / elapsed - self._rate)
            self._angle, self._at = angle, now
            return False
        return now - self._at > self._rested and abs(self._rate) > self._sudden


class SensorNoise:
    """Detect a sensor whose noise has ended, so that its values repeat.

    Friction may hold the torque of a joint constant, but a sensor with noise at rest never repeats a value for long.
    The noise is learned without torque. Two kinds of sensors are not checked. A sensor that then repeats at least two
    of three values is slower than the loop. A sensor with at most two different values has less noise than one digit.
    """

    LEARNED = 20  # values without torque: the least number of cycles of a startup
    REPEATED: ClassVar[int] = 100  # in a row: probability 1e-7 if 85 % repeat, the upper bound for a third of 20 values
    DISTINCT = 3  # least number of different values of a noise that exceeds one digit

    def __init__(self) -> None:
        self._last = math.nan
        self._distinct: set[float] = set()
        self._values = self._changes = self._repeated = 0

    def reset(self) -> None:
        """Discard the last values, but keep the learned noise."""
        self._last = math.nan
        self._repeated = 0

    def learn(self, value: float) -> None:
        """Add a value (N*m) that was measured without torque. Ignore nan."""
        if value == value and self._last == self._last:
            self._values += 1
            self._changes += value != self._last
            if len(self._distinct) < self.DISTINCT:
                self._distinct.add(value)
        self._last = value

    def update(self, value: float) -> bool:
        """Return True while the sensor's value (N*m) repeats although the sensor has shown noise."""
        if value != self._last:  # also true for nan
            self._last = value
            self._repeated = 0
            return False
        self._repeated += 1
        if self._repeated < self.REPEATED or self._values < self.LEARNED:
            return False
        return 3 * self._changes > self._values and len(self._distinct) >= self.DISTINCT
