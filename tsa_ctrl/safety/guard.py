"""Takes the compensation back when it moves the joint by itself or the motor buzzes, and says why.

The first time for a moment: to 0 at once, and within `HOLD` + `RECOVERY` back to `RETURNED` of it, to all of it when
that is `FORGIVEN`. A term that drives the joint has wound up the tendons, and a motor that swings on them goes on
driving it while they unwind: so it pulls the other way for `UNWIND` before. On a weight that goes at 3 rad/s when nine
tenths of the pretension are lost at once, the joint gets 9.6 mJ with that and 13.4 without. What is still wrong
then adds energy again, and half as much shows it; the second time within `FORGIVEN` is latched until the axis is
disabled: at a share of the friction that the energy showed to be there, or at `LEFT` where it buzzed. A third time at
0.
"""

from __future__ import annotations

import math

from tsa_ctrl.safety.limiter import Reason
from tsa_ctrl.safety.passivity import SENSOR, STRETCH, Passivity, PassivitySettings

# A motor that buzzes on its tendons: torque that swings by itself, from `LOWEST` to a third of the rate.
#
# Such a swing hardly moves the joint and delivers no energy there, so `passivity` does not see it. It is what the law
# adds to the wanted torque, above `LOWEST` Hz, block by block: one turn of the friction at a reversal fills a block or
# two, a swing that feeds itself all of them. A set-point that has as much of that band explains it, and a turn that
# follows the joint does: a hand that trembles turns the friction 25 times a second, and is looked through.

LOWEST = 20.0  # Hz: above what a limb does; a turn of the friction term has more
BLOCK = 0.04  # s
BLOCKS = 10  # in a row: 0.4 s; the reversals of a motion of 5 Hz are 0.1 s apart, and leave one in between empty
EXPLAINED = 0.2  # of the band's amplitude that the set-point has, from which on the swing is wanted


class Buzz:
    """Looks for it in the motor torque of each cycle; `frequency` in Hz, of the last that was found."""

    def __init__(self, level: float, period: float) -> None:
        """`level`: RMS in N*m at the motor; `period` in s."""
        self._forget = 1.0 - math.exp(-2.0 * math.pi * LOWEST * period)
        self._length = max(2, round(BLOCK / period))
        self._level = level * level * self._length
        self._hertz = 0.5 / (self._length * period)  # of one change of sign in a block
        self.reset()

    def reset(self) -> None:
        """Silence so far."""
        self._added = self._wanted = math.nan  # slow parts
        self.frequency = 0.0
        self._last = 0.0
        self._blocks = self._swings = 0
        self._empty()

    def _empty(self) -> None:
        self._count = self._turns = 0
        self._power = self._explained = 0.0

    def update(self, added: float, wanted: float, turns: bool = False) -> bool:
        """Whether it buzzes, after this cycle; both N*m at the motor: what the law added, and the set-point's part.

        `turns`: the friction term turns as the joint did, and what it adds says nothing.
        """
        slow = self._added
        if not -1e6 < added + wanted < 1e6:
            return False
        if turns or slow != slow:
            self._added, self._wanted = added, wanted
            return False
        fast = added - slow
        self._added = slow + self._forget * fast
        other = wanted - self._wanted
        self._wanted += self._forget * other
        if fast * self._last < 0.0:
            self._turns += 1
        self._last = fast
        self._power += fast * fast
        self._explained += other * other
        self._count += 1
        if self._count < self._length:
            return False
        loud = self._power > self._level and self._explained < EXPLAINED * EXPLAINED * self._power
        self._blocks, self._swings = (self._blocks + 1, self._swings + self._turns) if loud else (0, 0)
        self._empty()
        if self._blocks < BLOCKS:
            return False
        self.frequency = self._hertz * self._swings / self._blocks
        self._blocks = self._swings = 0
        return True


FALL = 0.02  # s in which a buzzing motor loses the term: all of it at once would let the motor swing into over-speed
HOLD = 0.05  # s without compensation: in which the swing of motor and tendons has died out
UNWIND = 4e-3  # s against what drove the joint: a third of a ringing period; half a share for 6 ms left 10.8 mJ
RECOVERY = 0.3  # s back to all of it: so that a joint that still moves shows within a second that it was no chance
# What comes back, until that is forgiven: an estimate that finds half of the friction is up to 12 % above it in the
# first two seconds, and a limb at 3.4 rad/s gets 10 mJ by 20 mN*m too much, less than a sensor's gain is known by.
RETURNED = 0.9
FORGIVEN = 60.0  # s after which the next time is a first one again
UNSURE = 0.1  # of the model's half loop, taken off what showed to be there: a slack tendon shows another tenth
CAUTIOUS = 0.8  # of the rest, that is compensated once latched
LEFT = 0.5  # of the compensation, once latched for buzzing
CLEAR = 0.9  # of the model's half loop: with more than that, friction is not what is wrong


class Guard:
    """Withdraw compensation and damping when they feed energy into the motion.

    `back_off` multiplies the compensation, `damping` the damping of the motor; both are 1 until a detection. `count` is
    the number of detections, `words` describes the last one, and `reason` is set while the compensation is reduced.

    A client can only lower `back_off`, and the guard latches it there. Only `release` restores it.
    """

    def __init__(
        self, settings: PassivitySettings, period: float, by_stretch: bool = False, compliance: float = 0.0
    ) -> None:
        """Prepare the guard.

        Args:
            settings: [axis.passivity].
            period: s.
            by_stretch: True if the delivered torque is estimated from the tendon elongation, which is less certain.
            compliance: of the joint with the motor locked, rad/(N*m).
        """
        self._passivity = Passivity(settings.energy, STRETCH if by_stretch else SENSOR, period, compliance)
        self._buzz = Buzz(settings.buzz, period)
        self._period = period
        self.count = 0
        self.words = ""
        self.reset()

    def reset(self) -> None:
        """Torque is not permitted: forget everything; `count` goes on."""
        self._passivity.reset()
        self._passivity.wary = False
        self._buzz.reset()
        self._back_off = self.damping = 1.0
        self.reason = Reason.NONE
        self.latched = False
        self._left = self._held = 0.0  # s, of what is forgiven and of the hold
        self._drove, self._unwinding = 0.0, 0  # 1, what drove the joint, and cycles against that
        self._falling = 0.0  # 1, of the share that a buzzing motor still has

    def pass_over(self, periods: int) -> None:
        """So many periods had no cycle."""
        self._passivity.pass_over(periods)

    @property
    def back_off(self) -> float:
        return self._back_off

    @back_off.setter
    def back_off(self, value: float) -> None:
        if value < self._back_off:
            self._back_off = value
            self.latched = True

    def release(self) -> None:
        """Release the latch: the compensation returns as after a first time, and the next time latches again.

        The energy of the present motion stays counted, so a release never hides it.
        """
        self.latched = False

    @property
    def share(self) -> float:
        """What the law multiplies the compensation by: `back_off`, but against what drove the joint for a moment, and 0
        until the motor has come to rest on the tendons."""
        if self._unwinding:
            return -self._drove
        return 0.0 if self._drove and self._held > 0.0 else self._back_off + self._falling

    @property
    def energy(self) -> float:
        """J, that the compensation has added lately."""
        return self._passivity.energy

    def update(
        self,
        tau_j: float,
        wanted: float,
        rate: float,
        omega_j: float,
        term: float,
        half_loop: float,
        added: float,
        ideal: float,
        swing: float = 0.0,
        turns: bool = False,
    ) -> None:
        """After a cycle with torque; N*m at the joint but for `added` and `ideal`, rad/s, J.

        `tau_j`: delivered, nan where it is not known; `wanted`: set-point, `rate`: its slope; `term`: the friction term
        as sent; `half_loop`: the model's; `added`, `ideal`: at the motor, what the law added to the set-point's part,
        and that; `swing`: what the motor has by its motion against the joint, 0 where its inertia is not known;
        `turns`: whether the term turns with the joint, which is no buzzing.
        """
        if self._unwinding:
            self._unwinding -= 1
        if self._falling > 0.0:
            self._falling = max(0.0, self._falling - self._period / FALL)
        if self._passivity.update(tau_j, wanted, rate, omega_j, term, half_loop, swing):
            self._energy()
        if self._buzz.update(added, ideal, turns):
            self._buzzes()
        if self._back_off < 1.0:
            self._recover()

    def _recover(self) -> None:
        self._left -= self._period
        self._passivity.wary = self._left > 0.0
        if self._held > 0.0:
            self._held -= self._period
        elif not self.latched:
            step = self._period / RECOVERY
            self._back_off = min(RETURNED if self._left > 0.0 else 1.0, self._back_off + step)
            self.damping = min(1.0, self.damping + step)
            if self._back_off == 1.0:
                self.reason = Reason.NONE

    def _energy(self) -> None:
        passivity = self._passivity
        ratio, energy, since = passivity.ratio, passivity.energy, passivity.cycles * self._period
        passivity.reset()
        if ratio < CLEAR:
            share = max(0.0, ratio)
            cause = (
                f"friction and pretension together are about {100.0 * share:.0f} % of what the model file says (a "
                "tensioner that gave way, a straighter or smoother sheath): mend that, or calibrate anew"
            )
        else:
            share = CLEAR
            cause = (
                "friction and pretension agree with the model file: lower the compensation, and check "
                "zero and gain of the joint torque measurement"
            )
        self._drove, self._unwinding = max(0.0, self.share), int(UNWIND / self._period)  # a slow loop has no time
        self._falling = 0.0
        self._take_back(
            Reason.PASSIVITY,
            CAUTIOUS * max(0.0, share - UNSURE),
            f"passivity: the compensation gave the joint {1e3 * energy:.1f} mJ more than desired within "
            f"{1e3 * since:.0f} ms",
            cause,
        )

    def _buzzes(self) -> None:
        self.damping = self._drove = 0.0
        before = self._back_off
        self._take_back(
            Reason.OSCILLATION,
            LEFT,
            f"oscillation: the motor buzzes at about {self._buzz.frequency:.0f} Hz",
            "the delay, the tendons' stiffness or the motor's inertia is not what the files say: tune anew",
        )
        self._falling = max(0.0, before - self._back_off)

    def _take_back(self, reason: Reason, left: float, found: str, cause: str) -> None:
        again, worse = self._left > 0.0, self.latched
        self.reason = reason
        self._left, self._held = FORGIVEN, HOLD
        self.count += 1
        if not again and not worse:
            self._back_off = 0.0
            done = (
                f"taken back, up again to {100.0 * RETURNED:.0f} % within {HOLD + RECOVERY:g} s, to all of it after "
                f"{FORGIVEN:g} s"
            )
        else:
            self.latched = True
            self._back_off = 0.0 if worse else left
            done = f"latched at {100.0 * self._back_off:.0f} % of it until the axis is disabled"
        self.words = f"{found}; {done}; {cause}"
