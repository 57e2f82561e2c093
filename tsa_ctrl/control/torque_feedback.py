"""Correct the friction term by the joint torque sensor: integral action for each direction of the tendons.

While the tendons slide, the sensor shows the error of the present direction for any cause: wrong friction, gear
friction, ripple, an eccentric pulley. One integrator per direction removes it,

    dC/dt = k (tau_J* - tau_J) r_M/r_J

A reversal therefore begins with the correction of the new direction. While the tendons stick, the joint torque does not
follow the motor, and an integrator would wind up. Four rules apply to a joint at rest:

* The error is used only while command and set-point are the largest since the last reversal. Below the largest command,
  no tendon slides. After a decrease of the set-point, more torque than desired remains, whatever the friction.
* The correction decreases at most as fast as the rest of the command grows, because a motor that reverses only releases
  friction. A fade-in with too large a friction term therefore ends at the actual friction: the correction absorbs the
  growth.
* The correction increases faster (`FAST`) on a joint that has rested since the last reversal, because tendons that
  stick close no loop that could oscillate. `CREEP` limits the excess when they begin to slide.
* A reversal that delivered too much torque reduces the next one directly. The integral of a stroke is kept in part
  (`KEPT`), because the inertia of the motor carries a reversal further than the same torque carries resting tendons.

The sum of friction term and correction stays within the proven friction (`compensation_limit`).
"""

from __future__ import annotations

import math

WAIT = 0.02  # s after a reversal, in which motor and sensor settle
# s, low-pass of the sensor. The motor oscillates on its tendons at 25 Hz and more. The integral of this oscillation
# lags by a quarter of a cycle, and therefore excites it. After this filter, a quarter of it remains at 27 Hz, and a
# tenth at 45 Hz.
MEAN = 0.01
JUMP = 0.7  # of a reversal's excess, subtracted from the next one; below 1, so that noise does not build up
KEPT = 0.3  # of the integral of a stroke at rest; on random rigs, 0 is worse for large signals, and 0.6 for small ones
LARGEST = 0.3  # of the friction torque; a larger error is a fault or a wrong direction, and is ignored
FARTHEST = 0.002  # of the friction torque; within this distance of the largest command, the tendons still slide
MORE = 0.1  # of the friction torque: largest increase by the sensor, about the error of a calibration
LESS = 0.25  # of the friction torque: largest reduction by the sensor, the usual error of a file
# Largest factor of the bandwidth (1), and the increase to which the factor is limited (1/s, of the friction torque).
# The mean RMS error of a sine of 20 mN*m over 29 random rigs is 8.4 mN*m, and 9.8 with FAST = 1. On 12 of them,
# FAST = 10 gains nothing.
FAST, CREEP = 5.0, 0.5
FORGET = 0.3  # s in which the correction fades without a sensor


class TorqueFeedback:
    """Compute the corrections of the friction term, N*m at the motor, one for each direction."""

    def __init__(self, bandwidth: float, ratio: float, period: float) -> None:
        """Prepare the integrators; `bandwidth`: Hz, 0 for none; `ratio`: r_M/r_J; `period`: s."""
        self.used = bandwidth > 0.0
        self._step = 2.0 * math.pi * bandwidth * period
        self._ratio = ratio
        self._period = period
        self._smooth = period / (MEAN + period)
        self._fade = math.exp(-period / FORGET)
        self.reset()

    def reset(self) -> None:
        """Reset all corrections at a new enable."""
        self._corrections, self._begun = [0.0, 0.0], [0.0, 0.0]
        self._forget()

    def _forget(self) -> None:
        """Reset the state of the present stroke."""
        self._since = 0.0  # s since the last reversal
        self._mean = self._before = math.nan  # N*m, smoothed excess, and its value before the last reversal
        self._farthest = -math.inf  # N*m, largest command in this direction since the reversal
        self._peak = -math.inf  # N*m, largest set-point in this direction since the reversal
        self._last = math.inf  # N*m, command without the correction in this direction, a cycle ago
        self._side = -1  # direction of this stroke: 0 or 1, -1 unknown
        self._rested = True  # the joint was at rest during this whole stroke

    def torque(self, force: float, half_loop: float, most: float) -> float:
        """Return the correction, N*m at the motor.

        Args:
            force: present direction of the friction term, -1 to 1.
            half_loop: friction torque, N*m at the motor.
            most: largest increase of the friction term by the correction, N*m.
        """
        least = -LESS * half_loop
        backward, forward = self._corrections
        correction = 0.5 * (forward + backward + force * (forward - backward))
        if force < 0.0:
            return -min(most, max(least, -correction))
        return min(most, max(least, correction))

    def update(
        self,
        excess: float,
        force: float,
        turning: bool,
        moving: bool,
        fading: bool,
        limited: bool,
        ideal: float,
        term: float,
        correction: float,
        half_loop: float,
    ) -> None:
        """Process one cycle.

        Args:
            excess: delivered minus desired joint torque, N*m; nan without a measurement.
            force: direction of the friction term, -1 to 1.
            turning: True while the friction term reverses.
            moving: True if the joint moves.
            fading: True while the friction term is faded in. Then the correction is 0 or less, and a joint must have
                rested since the last reversal.
            limited: True if a limit reduces the friction term. Until `WAIT` later, the correction then only decreases:
                it would grow by the error that the limit causes.
            ideal: motor torque for the set-point without friction, N*m.
            term, correction: friction term of this cycle, and its part that `torque` returned, N*m.
            half_loop: friction torque, N*m at the motor.
        """
        if excess != excess or force == 0.0:
            self._forget()
            self._corrections = [self._fade * each for each in self._corrections]
            self._begun = self._corrections.copy()
            return
        if turning:
            if self._since > 0.0:
                self._end_stroke()
            return
        self._since += self._period
        if self._since < WAIT:
            return
        self._mean = excess if self._mean != self._mean else self._mean + self._smooth * (excess - self._mean)
        sigma = 1.0 if force > 0.0 else -1.0
        side = self._side = 1 if force > 0.0 else 0
        if self._before == self._before:
            if self._since < WAIT + 2.0 * MEAN:
                return
            slid = (self._mean - self._before) * sigma > 0.0
            if slid and self._mean * sigma > 0.0 and not moving:
                self._correct(side, -JUMP * self._mean * self._ratio, half_loop)
            self._begun[side] = self._corrections[side]
            self._before = math.nan
        self._rested = self._rested and not moving
        along, wanted = (ideal + term) * sigma, ideal * sigma
        if moving or along > self._farthest:
            self._farthest = along
        if moving or wanted > self._peak:
            self._peak = wanted
        rest = along - correction * sigma
        growth, self._last = max(0.0, rest - self._last), rest
        error = -self._mean * self._ratio
        if not -LARGEST * half_loop < error < LARGEST * half_loop:
            return
        step = self._step * error
        if limited and step * sigma > 0.0:
            self._mean, self._since = math.nan, 0.0
            return
        if not moving:
            near = FARTHEST * half_loop
            if along < self._farthest - near or wanted < self._peak - near:
                return
            if step * sigma < -growth or (fading and error * sigma < 0.0):
                step = -growth * sigma
        if self._rested and not fading and step * sigma > 0.0:
            step *= max(1.0, min(FAST, CREEP * half_loop * self._period / abs(step)))
        if fading and (not self._rested or (step + self._corrections[side]) * sigma > 0.0):
            return
        self._correct(side, step, half_loop)

    def _correct(self, side: int, by: float, half_loop: float) -> None:
        sigma = 1.0 if side else -1.0
        along = sigma * (self._corrections[side] + by)
        self._corrections[side] = sigma * min(MORE * half_loop, max(-LESS * half_loop, along))

    def _end_stroke(self) -> None:
        side = self._side
        if side >= 0 and self._rested:
            begun = self._begun[side]
            self._corrections[side] = self._begun[side] = begun + KEPT * (self._corrections[side] - begun)
        before = self._mean if self._mean == self._mean else self._before
        self._forget()
        self._before = before
