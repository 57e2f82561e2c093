"""Detect faulty sensors and loose parts by contradictions between the measurements and the command.

    torque        the reported motor torque differs from every torque commanded within the drive's response time
    frozen        no bit of the drive's feedback changes although the command does
    slip          motor and joint moved apart: a torn or loose tendon, a slipped or stuck encoder, a wrong count or
                  sign, or a motor whose torque differs from the reported one (`residuals.Elongation`, or a given angle)
    velocity      the drive's velocity is not the derivative of its position (loops of 400 Hz and more)
    standstill    the position of the joint repeats its last count although the joint still moves
    noise         the joint torque sensor repeats one value, although it has shown noise without torque
    joint_torque  the joint torque sensor, if there is one, contradicts the model: a reversed sign, or a motor that
                  delivers more torque than it reports

A contradiction must last before it becomes a finding. A single sample that agrees does not clear it
(`safety.debounce`). Like the limiter, this module imports nothing from the control law.
"""

from __future__ import annotations

import math

from tsa_ctrl.safety.causes import Cause, Finding
from tsa_ctrl.safety.debounce import Debounce
from tsa_ctrl.safety.residuals import LASTING, SAMPLES, Elongation, Give, SensorNoise, Standstill, Velocity
from tsa_ctrl.safety.settings import PlausibilitySettings

DEFAULT_TORQUE = 0.25  # of the limiter's absolute limit
DEFAULT_JOINT_TORQUE = 0.15  # of that limit, at the joint: too little to throw a person
PREDICTION_SHARE = 0.4  # of the model's torque without friction: the largest error of a calibration
FROZEN_SHARE = 0.05  # of rated torque: change of the command while the feedback does not change
BEGUN = 0.5  # of that change, above which the drive must respond: the noise of a constant command is smaller
RESPONSE = 0.03  # s within which the drive must respond to a command: bus, torque loop and report of a slow drive
SLIP_TIME = 0.01  # s beyond a given angle
VELOCITY_TIME = 0.02  # s for which velocity and position must contradict each other


class Plausibility:
    """Check the plausibility of one axis. Call `update` while torque is permitted, and `reset` while it is not."""

    def __init__(
        self,
        settings: PlausibilitySettings,
        limit: float,
        rated: float,
        radii: tuple[float, float],
        has_encoder: bool,
        give: Give,
        period: float,
        counts: tuple[float, float],
        reports_velocity: bool,
    ) -> None:
        """Prepare the checks of one axis.

        Args:
            settings: [axis.plausibility].
            limit: torque limit of the limiter, N*m.
            rated: rated torque at the motor pulley, N*m.
            radii: r_M and r_J, m.
            has_encoder: True if the axis has a joint encoder.
            give: compliance between motor and joint.
            period: control period, s.
            counts: one count of the motor's and of the joint's encoder, rad at the motor.
            reports_velocity: True if the drive sends a measured velocity.
        """
        r_m, r_j = radii
        self._torque = DEFAULT_TORQUE * limit if settings.torque is None else settings.torque
        self._joint_torque = (
            DEFAULT_JOINT_TORQUE * limit * r_j / r_m if settings.joint_torque is None else settings.joint_torque
        )
        self._duration = settings.duration
        self._acting = max(1, math.ceil(RESPONSE / period))  # commands that may act at one time
        self._slip = settings.slip
        self._frozen = FROZEN_SHARE * rated
        self._geared = r_j / r_m
        self._has_encoder = has_encoder
        self._elongation = Elongation(give, period)
        compares_velocity = reports_velocity and Velocity.is_usable(give, period)
        self._velocity = Velocity(counts[0], period) if compares_velocity else None
        self._joint_rests = Standstill(counts[1], period) if has_encoder else None
        self._noise = SensorNoise()
        self._velocity_wrong = Debounce(VELOCITY_TIME)
        self._torque_wrong = Debounce(settings.duration)
        self._joint_wrong = Debounce(settings.duration)
        self._slipped = Debounce(max(LASTING, SAMPLES * (period - LASTING)) if settings.slip is None else SLIP_TIME)
        self.reset()

    def reset(self) -> None:
        """Reset all checks while torque is not permitted."""
        self._offset = math.nan
        self._sent = [0.0] * self._acting  # N*m, ring
        self._place = 0
        for clock in (self._torque_wrong, self._joint_wrong, self._slipped, self._velocity_wrong):
            clock.reset()
        for check in (self._elongation, self._velocity, self._joint_rests):
            if check is not None:
                check.reset()
        self._noise.reset()
        self._last: tuple[float, float, float] | None = None
        self._frozen_since = 0.0
        self._moved_at = math.inf  # s, time at which the command first differed from its earlier value
        self._low = self._high = 0.0

    def learn(self, tau_j: float) -> None:
        """Learn the noise of the joint torque sensor (N*m, nan without one) while torque is not permitted."""
        self._noise.learn(tau_j)

    def skip_cycles(self) -> None:
        """Count a period without measurements."""
        if self._velocity is not None:
            self._velocity.skip_cycles()

    def update(
        self,
        now: float,
        command: float,
        feedback: tuple[float, float, float],
        q_j: float,
        tau_j: float,
        expected: tuple[float, float],
        routed: float = 0.0,
    ) -> Finding | None:
        """Return the contradiction, or None while all signals agree.

        Args:
            now: time, s.
            command: motor torque as sent, N*m.
            feedback: motor torque (N*m), angle (rad) and speed (rad/s) that the drive reports.
            q_j: joint angle, rad.
            tau_j: torque of the joint torque sensor, N*m; nan without a sensor or a fresh value.
            expected: bounds of the joint torque from the model for the reported motor torque, N*m.
            routed: offset between motor and joint by tendon paths of different lengths, rad at the motor.
        """
        tau_m, q_m, omega_m = feedback
        if feedback != self._last:
            self._last = feedback
            self._frozen_since = now
            self._moved_at = math.inf
            self._low = self._high = command
        else:
            if command < self._low:
                self._low = command
            elif command > self._high:
                self._high = command
            moved = self._high - self._low
            if moved <= BEGUN * self._frozen:
                self._moved_at = math.inf
            elif self._moved_at == math.inf:  # no response was due before
                self._moved_at = now
            if moved > self._frozen and now - self._moved_at > RESPONSE:
                return Finding(
                    Cause.FROZEN,
                    f"no bit of it changed for {1e3 * (now - self._frozen_since):.0f} ms, while the command moved by "
                    f"{moved:.2f} N*m",
                )
        clock, wrong = self._torque_wrong, not abs(command - tau_m) <= self._torque
        sent = self._sent
        if wrong:
            wrong = not min(sent) - self._torque <= tau_m <= max(sent) + self._torque
        self._place = place = (self._place or self._acting) - 1
        sent[place] = command
        if (wrong or not clock.idle) and clock.update(now, wrong):
            return Finding(
                Cause.TORQUE_ERROR,
                f"the drive reports {tau_m:.2f} N*m, commanded are {command:.2f} N*m, for {self._duration:g} s",
            )
        joint = self._geared * q_j
        if self._has_encoder:
            way = joint + routed  # both make the tendons slide
            apart = q_m - way
            if self._offset != self._offset:
                self._offset = apart
            if self._slip is None:
                wrong = self._elongation.update(tau_m, q_m, omega_m, way) is not None
            else:
                wrong = abs(apart - self._offset) > self._slip
            clock = self._slipped
            if (wrong or not clock.idle) and clock.update(now, wrong):
                return self._apart(apart)
        velocity, joint_rests, clock = self._velocity, self._joint_rests, self._velocity_wrong
        if velocity is not None:
            wrong = velocity.update(q_m, omega_m)
            if (wrong or not clock.idle) and clock.update(now, wrong):
                return Finding(
                    Cause.VELOCITY,
                    f"the drive reports a velocity of {omega_m:.2f} rad/s, its position changes by "
                    f"{velocity.by_position:.2f} rad/s: a signal is stuck, or its scale or sign is wrong",
                )
        if joint_rests is not None and joint_rests.update(now, joint):
            return Finding(Cause.ENCODER_STUCK, "the joint position stopped between two samples, as no joint can")
        if self._noise.update(tau_j):
            return Finding(
                Cause.TORQUE_SENSOR_STUCK,
                f"it repeated {tau_j:.3f} N*m {SensorNoise.REPEATED} times; without torque it showed noise",
            )
        return self._joint(now, tau_j, *expected) if tau_j == tau_j or not self._joint_wrong.idle else None

    def _apart(self, apart: float) -> Finding:
        """Return the finding for an elongation beyond its limits; `apart` is in rad at the motor."""
        if self._slip is None and self._elongation.reversed:
            return Finding(
                Cause.POLARITY,
                "the motor turns the wrong way, the sign of a torque or of an encoder is reversed, an encoder is "
                "stuck, a tendon is torn, or the motor gives less than it reports",
            )
        return Finding(
            Cause.MOVED_APART,
            f"by {apart - self._offset:.2f} rad at the motor since the enable, beyond what "
            f"{'the torque explains' if self._slip is None else 'slip allows'}: a tendon is torn or loose, an encoder "
            "slipped or stuck, its counts or sign are wrong, or the motor gives more than it reports",
        )

    def _joint(self, now: float, tau_j: float, one: float, other: float) -> Finding | None:
        if tau_j != tau_j:  # no sensor, or no fresh value
            self._joint_wrong.update(now, False)
            return None
        low, high = (one, other) if one < other else (other, one)
        most = max(self._joint_torque, PREDICTION_SHARE * 0.5 * abs(low + high))
        if not self._joint_wrong.update(now, not low - most <= tau_j <= high + most):
            return None
        return Finding(
            Cause.JOINT_TORQUE,
            f"the joint torque sensor reports {tau_j:.2f} N*m, the model {low:.2f} to {high:.2f} N*m, for "
            f"{self._duration:g} s: a sign is reversed, or one of the two torques is wrong",
        )
