"""Withdraw the compensation when it drives the joint or the motor oscillates on its tendons, and report the reason.

If the joint gained energy, the guard reduces the share in proportion to the error, to a share that the measured
friction permits (`CAUTIOUS`, `UNSURE`). Full withdrawal after an excess of 2 % would suddenly expose a person who moves
the joint to all of its friction. This is 2.4 N*m on a rig with x = 0.9. If the motor oscillated, the guard withdraws
the whole compensation.

The first reduction is temporary. The share returns to `RETURNED` within `HOLD` + `RECOVERY`, and to its full value
after `FORGIVEN`. Half of the energy threshold applies until then. A second detection within `FORGIVEN` is latched
until the axis is disabled or the latch is released, and a third one latches 0. The tendons still relax within `HOLD`,
so a detection of energy in this time is the same one and only lowers the share.

An excessive term has stretched the tendons, and the motor keeps driving the joint while they relax. For `UNWIND`, the
guard therefore first applies the excess in the opposite direction. Consider a weight that moves at 3 rad/s when 90 %
of the pretension is suddenly lost. Its joint receives 9.6 mJ with this reversal, and 13.4 mJ without it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from tsa_ctrl.safety.limiter import Reason
from tsa_ctrl.safety.passivity import SENSOR, STRETCH, Passivity
from tsa_ctrl.safety.settings import PassivitySettings

LOWEST = 20.0  # Hz: faster than a limb moves; a reversal of the friction term contains higher frequencies
BLOCK = 0.04  # s
BLOCKS = 10  # in a row: 0.4 s; a motion of 5 Hz reverses every 0.1 s, which leaves a quiet block in between
EXPLAINED = 0.2  # ratio of the amplitudes of set-point and law in the band above which the oscillation is desired


class ChatterDetector:
    """Detect a sustained oscillation of the motor on its tendons.

    The oscillation hardly moves the joint, so `passivity` does not detect it. The torque that the law adds to the
    set-point must exceed the level in `BLOCKS` consecutive blocks. No single friction reversal lasts that long.
    Set-points in the same band are excluded, and so are reversals that follow the joint, for example a hand tremor.

    Attributes:
        frequency: frequency of the last detected oscillation, Hz.
    """

    def __init__(self, level: float, period: float) -> None:
        """Prepare the detector.

        Args:
            level: RMS threshold at the motor, N*m.
            period: control period, s.
        """
        self._forget = 1.0 - math.exp(-2.0 * math.pi * LOWEST * period)
        self._length = max(2, round(BLOCK / period))
        self._level = level * level * self._length
        self._hertz = 0.5 / (self._length * period)  # Hz for each change of sign in a block
        self.reset()

    def reset(self) -> None:
        """Forget all blocks."""
        self._added = self._wanted = math.nan  # slow parts
        self.frequency = 0.0
        self._last = 0.0
        self._blocks = self._swings = 0
        self._empty()

    def _empty(self) -> None:
        self._count = self._turns = 0
        self._power = self._explained = 0.0

    def update(self, added: float, wanted: float, turns: bool = False) -> bool:
        """Return True if an oscillation is detected in this cycle.

        Args:
            added: torque that the law adds to the set-point's part, N*m at the motor.
            wanted: the set-point's part, N*m at the motor.
            turns: True while the friction term reverses with the joint's motion. Such a cycle is not counted.
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


FALL = 0.02  # s to fade out the term of an oscillating motor: a step would make the motor swing into over-speed
HOLD = 0.05  # s with the reduced share, while the oscillation of motor and tendons decays
UNWIND = 4e-3  # s of reversed excess: a third of an oscillation period; half a share for 6 ms left 10.8 mJ
RECOVERY = 0.3  # s in which the compensation returns, so that a lasting cause is detected again within a second
# Share that returns before `FORGIVEN`. An estimator that finds half of the friction is up to 12 % too high for two
# seconds. A limb at 3.4 rad/s receives 10 mJ from an excess of 20 mN*m, less than the gain error of a sensor.
RETURNED = 0.9
FORGIVEN = 60.0  # s after which the next detection counts as the first
UNSURE = 0.1  # of the model's friction torque, subtracted from the measured one: a slack tendon shows 10 % too much
CAUTIOUS = 0.8  # share of the remaining friction that is compensated after a latched detection of energy
LEFT = 0.5  # share of the compensation after a latched detection of an oscillation
CLEAR = 0.9  # of the model's friction torque: friction is not the cause if the measured torque is larger


@dataclass(slots=True)
class Observed:
    """The measurements and torques of one cycle that the guard checks. An axis reuses the same object.

    Attributes:
        tau_j: delivered torque at the joint, N*m; nan if unknown.
        wanted: set-point, N*m at the joint.
        rate: slope of the set-point, N*m/s.
        omega_j: joint velocity, rad/s.
        term: friction term as sent, N*m at the joint.
        half_loop: friction torque of the model, N*m at the joint.
        added: torque that the law added to the set-point's part, N*m at the motor.
        ideal: the set-point's part, N*m at the motor.
        swing: kinetic energy of the motor relative to the joint while the term reverses, J; 0 if unknown.
        turns: True while the term reverses with the joint's motion.
    """

    tau_j: float = math.nan
    wanted: float = 0.0
    rate: float = 0.0
    omega_j: float = 0.0
    term: float = 0.0
    half_loop: float = 0.0
    added: float = 0.0
    ideal: float = 0.0
    swing: float = 0.0
    turns: bool = False


class CompensationBackoff:
    """Withdraw compensation and damping when they feed energy into the motion.

    A client can only lower `back_off`, and the guard latches the lower value. `release` and `reset` restore it.

    Attributes:
        back_off: factor of the compensation, 1 until a detection.
        damping: factor of the motor's damping, 1 until a detection.
        count: number of detections.
        words: description of the last detection.
        reason: reason of the present reduction, `Reason.NONE` without one.
        latched: True while the reduction is latched.
        ratio: measured friction torque over the model's if this cycle found less friction, else nan.
    """

    def __init__(self, settings: PassivitySettings, period: float, by_stretch: bool, compliance: float) -> None:
        """Prepare the guard.

        Args:
            settings: [axis.passivity].
            period: control period, s.
            by_stretch: True if the delivered torque is estimated from the tendon elongation, which is less certain.
            compliance: compliance of the joint with the motor locked, rad/(N*m).
        """
        self._passivity = Passivity(settings.energy, STRETCH if by_stretch else SENSOR, period, compliance)
        self._chatter = ChatterDetector(settings.buzz, period)
        self._period = period
        self.count = 0
        self.words = ""
        self.reset()

    def reset(self) -> None:
        """Reset everything except `count` and `words`. The axis calls this while torque is not permitted."""
        self.ratio = math.nan
        self._passivity.reset()
        self._passivity.wary = False
        self._chatter.reset()
        self._back_off = self.damping = 1.0
        self.reason = Reason.NONE
        self.latched = False
        self._left = self._held = 0.0  # s that remain of `FORGIVEN` and of `HOLD`
        self._drove, self._unwinding = 0.0, 0  # excess share that drove the joint; remaining cycles of its reversal
        self._falling = 0.0  # withdrawn share that still fades out while the motor oscillates

    def skip_cycles(self, periods: int) -> None:
        """Count periods without a cycle."""
        self._passivity.skip_cycles(periods)

    @property
    def back_off(self) -> float:
        return self._back_off

    @back_off.setter
    def back_off(self, value: float) -> None:
        if value < self._back_off:
            self._back_off = value
            self.latched = True

    def release(self) -> None:
        """Release the latch, so that the compensation returns as after a first detection.

        A detection within `FORGIVEN` of the last one latches again. A release keeps the energy that the present motion
        has accumulated.
        """
        self.latched = False

    @property
    def share(self) -> float:
        """Return the factor of the compensation in the law.

        It equals `back_off` except shortly after a detection. After a detection of energy, the excess is subtracted
        for `UNWIND`. After a detection of an oscillation, the withdrawn share fades to 0 within `FALL`.
        """
        return self._back_off - self._drove if self._unwinding else self._back_off + self._falling

    @property
    def energy(self) -> float:
        """Return the energy that the compensation has added recently, J."""
        return self._passivity.energy

    def update(self, seen: Observed) -> None:
        """Check a cycle with torque."""
        if self._unwinding:
            self._unwinding -= 1
        if self._falling > 0.0:
            self._falling = max(0.0, self._falling - self._period / FALL)
        if self._passivity.update(
            seen.tau_j, seen.wanted, seen.rate, seen.omega_j, seen.term, seen.half_loop, seen.swing
        ):
            self._energy()
        else:
            self.ratio = math.nan
        if self._chatter.update(seen.added, seen.ideal, seen.turns):
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
            self.ratio = max(0.0, ratio)
            share = max(0.0, ratio)
            cause = (
                f"friction and pretension together are about {100.0 * share:.0f} % of the model file's values (a "
                "tensioner that gave way, a straighter or smoother sheath): correct that, or calibrate again"
            )
        else:
            share = CLEAR
            cause = (
                "friction and pretension agree with the model file: lower the compensation, and check "
                "zero and gain of the joint torque measurement"
            )
        excess = max(0.0, self.share - max(0.0, ratio))
        left = min(self._back_off, CAUTIOUS * max(0.0, share - UNSURE))
        self._falling = 0.0
        if self._held > 0.0 and not self.latched:
            self._back_off = left
        else:
            self._take_back(
                Reason.PASSIVITY,
                left,
                left,
                f"passivity: the compensation gave the joint {1e3 * energy:.1f} mJ more than desired within "
                f"{1e3 * since:.0f} ms",
                cause,
            )
        self._drove, self._unwinding = excess, int(UNWIND / self._period)  # 0 in a loop with a longer period

    def _buzzes(self) -> None:
        self.damping = 0.0
        self._unwinding = 0
        before = self._back_off
        self._take_back(
            Reason.OSCILLATION,
            0.0,
            LEFT,
            f"oscillation: the motor buzzes at about {self._chatter.frequency:.0f} Hz",
            "the delay, the tendons' stiffness or the motor's inertia differs from the files: tune again",
        )
        self._falling = max(0.0, before - self._back_off)

    def _take_back(self, reason: Reason, first: float, left: float, found: str, cause: str) -> None:
        again, worse = self._left > 0.0, self.latched
        self.reason = reason
        self._left, self._held = FORGIVEN, HOLD
        self.count += 1
        if not again and not worse:
            self._back_off = first
            done = (
                f"reduced to {100.0 * self._back_off:.0f} % of it, up again to {100.0 * RETURNED:.0f} % within "
                f"{HOLD + RECOVERY:g} s, to all of it after {FORGIVEN:g} s"
            )
        else:
            self.latched = True
            self._back_off = 0.0 if worse else left
            done = f"latched at {100.0 * self._back_off:.0f} % of it until the axis is disabled"
        self.words = f"{found}; {done}; {cause}"
