"""Joint torque from the tendon elongation and the friction of the model file, without the reported motor torque 0x6077.

The elongation s = r_M q_M - r_J q_J gives the mean of the tension differences at motor and joint, so that

    tau_J = 2 k_t r_J (s - s_0) - s_c z h_J,        -1 <= z <= 1

h_J is the friction torque at the joint (half the hysteresis width), s_c the centre of the bending. z is the direction
while both ends of the tendons move the same way for long enough, and unknown otherwise. The zero s_0 is a pair of
bounds: while the commanded motor torque is about 0, s - s_0 is the friction alone. The band is wide, but a wrong torque
constant and a wrong 0x6077 do not move it.
"""

from __future__ import annotations

import math

from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.sliding import sliding
from tsa_ctrl.model.stretch import compliance_centre

IDLE = 0.05  # N*m of commanded torque that counts as about 0
SMOOTH = 0.003  # s, low-pass of both ways
SETTLED = 0.03  # s, memory of the commanded torque
STRANGE = 2.0  # 1, most of the motor torque over the commanded one
NOISE = 0.02  # N*m of the motor, cogging and offset of its current
CREEP = 2e-6  # m/s, fastest drift of the zero
GEARING = 2e-3  # 1, of the path of the joint: radii at which the tendons lie


class ElongationTorque:
    """`low` and `high`: N*m at the joint, nan before the first measurement; plain floats, a microsecond a cycle."""

    def __init__(self, model: TendonSheath, period: float, counts: tuple[float, float]) -> None:
        """Prepare the estimate; `period`: s; `counts`: rad of one count at the motor's and the joint's pulley."""
        self._r_m, self._r_j = model.motor_pulley_radius, model.joint_pulley_radius
        friction = abs(sliding(model).half_loop)
        centre = compliance_centre(model)
        doubt = model.bending_centre_uncertainty
        self._most_friction = (1.0 + model.friction_angle_uncertainty) * (1.0 + model.pretension_uncertainty)
        self._per_stretch = 2.0 * model.tendon_stiffness * model.joint_pulley_radius
        self._at_joint = friction * min(1.0, centre + doubt)
        self._at_motor = friction * min(1.0, 1.0 - centre + doubt) / self._per_stretch
        self._per_torque = model.joint_pulley_radius / model.motor_pulley_radius / self._per_stretch
        self._doubt = max(0.1, model.axial_stiffness_uncertainty) + 0.25 * model.friction_angle**2
        self._count = self._r_m * counts[0] + self._r_j * counts[1]  # m
        self._way = 2.0 * self._most_friction * friction / self._per_stretch + 4.0 * self._count
        self._smooth = 1.0 - math.exp(-period / SMOOTH)
        self._fade = math.exp(-period / SETTLED)
        self._creep = CREEP * period
        self.reset()

    def reset(self) -> None:
        """Forget everything, the zero too."""
        self.low = self.high = self._motor = math.nan
        self._joint = 0.0
        self._zero_low, self._zero_high = -math.inf, math.inf  # m
        self._slid = 0.0  # m, signed, that both ends have moved the same way
        self._command = 0.0  # N*m, maximum of the last 30 ms

    def update(self, q_m: float, q_j: float, command: float) -> None:
        """Take one cycle: rad of motor and joint, N*m that the motor was commanded. Skip values that are not finite."""
        motor, joint = self._r_m * q_m, self._r_j * q_j
        if not math.isfinite(motor + joint + command):
            return
        if self._motor != self._motor:
            self._motor, self._joint = motor, joint
        smooth, count = self._smooth, self._count
        step, went = smooth * (motor - self._motor), smooth * (joint - self._joint)
        self._motor += step
        self._joint += went
        size, recent = abs(command), self._fade * self._command
        self._command = size if size > recent else recent
        slid, jitter = self._slid, 0.1 * count
        if slid >= 0.0 and step > -jitter and went > -jitter:
            if step > 0.0 and went > 0.0:
                slid += step if step < went else went
        elif slid <= 0.0 and step < jitter and went < jitter:
            if step < 0.0 and went < 0.0:
                slid += step if step > went else went
        else:
            slid = 0.0
        self._slid = slid
        # Bounds of z times the friction over the file's value.
        forward, backward = self._most_friction, -self._most_friction
        if slid > self._way:
            backward = 0.0  # friction may be lost at any time, so the file gives no lower bound of it
        elif slid < -self._way:
            forward = 0.0
        stretch = self._motor - self._joint
        drift = self._creep + GEARING * abs(went)
        self._zero_low -= drift
        self._zero_high += drift
        if self._command < IDLE:
            room = self._per_torque * (STRANGE * self._command + NOISE) + count
            low = stretch + self._at_motor * backward - room
            high = stretch + self._at_motor * forward + room
            self._zero_low, self._zero_high = max(self._zero_low, low), min(self._zero_high, high)
            if self._zero_low > self._zero_high:  # the zero has moved: the encoders or the tendons are others
                self._zero_low, self._zero_high = low, high
        least = self._per_stretch * (stretch - self._zero_high)
        most = self._per_stretch * (stretch - self._zero_low)
        self.low = least - self._doubt * abs(least) - self._at_joint * forward
        self.high = most + self._doubt * abs(most) - self._at_joint * backward
