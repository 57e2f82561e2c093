"""Damp the motor's oscillation on its tendons, with the motion predicted for the time at which the torque acts.

With a locked joint the motor is an inertia on the spring of the tendons: J_M e'' + K e = tau. Here e is the motor angle
minus its planned value (the joint's angle, plus the elongation by the torques). A torque -k e' damps it. But a
measurement acts only after the total delay T_d, and w_n T_d is more than a radian, so plain feedback excites the
oscillation instead: on the shipped rig, k = 0.02 N*m*s/rad oscillates without end at one period of delay. An
oscillation of one frequency can be predicted:

    e'(t + T_d) = e'(t) cos(w_n T_d) - w_n e(t) sin(w_n T_d),     tau = -k e'(t + T_d),     w_n = sqrt(K / J_M)

The planned angle is compared with the measured one T_d later, when it acts. The slow part of e (zero of the encoders, a
wrong model) is removed. `law_design.gain_margin` returns the gain margin of k.

Friction locks the tendons of a resting joint from their first bend on. The motor then oscillates faster, and the
prediction may have the wrong phase. The hysteresis of the tendons ends an oscillation that grows slowly. The damping of
a resting joint is used unless the oscillation would grow faster (`law_design.is_stable_at_rest`).
"""

from __future__ import annotations

import math

FORGET = 0.05  # s, time constant of the mean of e: far slower than the oscillation, faster than a gait


class Damping:
    """Compute the damping torque; `torque` is its value at the last update, N*m at the motor."""

    def __init__(self, gain: float, ringing: float, delay: float, gearing: float, period: float) -> None:
        """Prepare the prediction.

        Args:
            gain: k, N*m*s/rad.
            ringing: w_n, rad/s.
            delay: T_d, s.
            gearing: r_J/r_M.
            period: s.
        """
        self.gain = gain
        self.share = 1.0  # of the gain, permitted by the guard
        self._cosine, self._sine = math.cos(ringing * delay), ringing * math.sin(ringing * delay)
        self._gearing = gearing
        self._period = period
        self._forget = period / (FORGET + period)
        whole, self._part = divmod(delay / period, 1.0)
        self._back = int(whole)
        self.reset()

    def reset(self) -> None:
        """Reset the torque and the plan."""
        self.torque = 0.0
        self._planned: list[float] = []
        self._mean = math.nan

    def replace_plan(self, planned: float) -> None:
        """Replace the last planned elongation (rad), because a limit cut its torque and the motor will not reach it."""
        if self._planned:
            self._planned[-1] = planned

    def skip_cycles(self) -> None:
        """Repeat the last planned value for a period without a cycle."""
        if self._planned:
            self._planned.append(self._planned[-1])
            if len(self._planned) > self._back + 2:
                del self._planned[0]

    def update(self, planned: float, q_m: float, omega_m: float, q_j: float, omega_j: float) -> float:
        """Return the damping torque, N*m at the motor.

        Args:
            planned: elongation planned for T_d from now, as an angle of the motor, rad.
            q_m, omega_m: present angle and speed of the motor, rad and rad/s.
            q_j, omega_j: present angle and speed of the joint, rad and rad/s.
        """
        plan, part = self._planned, self._part
        plan.append(planned)
        if len(plan) < self._back + 3:
            return 0.0
        first, second, third = plan[:3]  # the three oldest, one period apart
        stretch = third + part * (second - third)
        before = second + part * (first - second)
        del plan[0]
        angle = q_m - self._gearing * q_j - stretch
        speed = omega_m - self._gearing * omega_j - (stretch - before) / self._period
        if self._mean != self._mean:
            self._mean = angle
        self._mean += self._forget * (angle - self._mean)
        torque = -self.share * self.gain * (self._cosine * speed - self._sine * (angle - self._mean))
        self.torque = torque if torque == torque else 0.0
        return self.torque
