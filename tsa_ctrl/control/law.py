"""Compute the feedforward law: ideal torque, compensated share of the friction term, motor inertia torque, damping.

    tau_M = tau_J* r_M/r_J  +  c f b (1 - e) (tau_ff(sigma) - tau_J* r_M/r_J)  +  C  +  J_M theta''  +  damping

tau_ff is the model's exact inverse, (3.55) or (3.53) with its effects. Its inputs are the set-point tau_J* at the time
when the command acts, and the direction sigma of the tendon (`direction`). sigma reverses as fast as the motor can
follow (`reversal.FrictionReversal`). At a joint at rest, the reversal stops where the slip fronts do
(`reversal.ReversalSlip`). c is the compensation factor, f the fade-in after every enable, b the back-off of the guards
against excessive compensation.

The term must not exceed the actual friction. Term and friction together give the joint the power

    P = (r_J/r_M) (c b h_model sigma_term - h_true sigma) omega_J,     h = 2 T_p0 r_M f(x) at the motor

where f is tanh, x or sinh depending on where the sheath bends. The condition of passivity for any load and speed is
P <= 0:

    c b h_model <= h_true

whether the term reverses early, in time or late. If it is violated, a joint of damping d accelerates to
(r_J/r_M) (c b h_model - h_true)/d. `compensation_limit` limits c by the proven h. The guard sets b, and observes the
integral of P (`safety.passivity`). With the true parameters and c = 1, only the joint's damping ends an oscillation.
The share e (`settle`) is therefore removed while the set-point is constant and the joint hardly moves. C is the torque
sensor's correction (`torque_feedback`), which counts as a part of the friction term.

theta = r_M/K (tau_J*/r_J + s_c (friction term)/r_M) is the elongation between motor and joint as an angle of the motor.
It determines the planned torque J_M theta'' of a reversal. J_M r_J/r_M alpha_J moves the motor with the joint. Both
tendons pull between two bounds of tau_M in the present direction, with T_p by (3.54). The sum of ideal and friction
term stays between these bounds, unless the model has slack. `beyond` is True while the sum or its exact inverse is
clipped there.
"""

from __future__ import annotations

import math
from typing import Protocol

from tsa_ctrl.control.damping import Damping
from tsa_ctrl.control.direction import STANDING, Direction
from tsa_ctrl.control.law_design import Plan
from tsa_ctrl.control.motion_filter import MOST_EXPECTED, JointAngle, Motion
from tsa_ctrl.control.reversal import FrictionReversal, ReversalSlip
from tsa_ctrl.control.settings import LawSettings
from tsa_ctrl.control.torque_feedback import TorqueFeedback

CLOSING = 5.0  # Hz, rate at which the missing torque by the sensor is added at rest; a step throws a hand-held joint
# cycles of the motor's oscillation on its tendons that a reversal at rest takes at least. The joint torque changes only
# at its end, so this costs little time. The inertia of the motor carried shorter reversals on random rigs up to 25 % of
# the friction torque too far. With 3, a locked joint had three times the error on one rig.
CYCLES = 2.0
STOOD = 0.1  # s at rest, after which the fronts of a joint count as at rest
SLOW = 0.5  # rad/s of the joint, below which an oscillation may be settled
STANDS = 0.02  # N*m/s; a set-point that changes more slowly counts as constant
SETTLING = 0.3  # s in which the share e is applied; it is removed five times as fast
BLIND = 2.0  # memories of the motion after a reversal, in which the motor angle alone shows no joint motion
NEAR_SLACK = 0.3  # of the model file's pretension; below it, the friction hardly changes any more, but the domain does
_REFRESH = 64  # cycles between two updates of the friction torque, because parameters change slowly


class Inverse(Protocol):
    """Define the live inverse of a model (`tsa_ctrl.model.feedforward`)."""

    @property
    def friction_angle(self) -> float: ...

    @property
    def pretension(self) -> float: ...

    @property
    def notes(self) -> tuple[str, ...]: ...

    @property
    def clipped(self) -> bool: ...

    def update(
        self,
        tau_j_des: float,
        sigma: float,
        omega_j: float,
        q_j: float = math.nan,
        q_m: float = math.nan,
        temperature: float = math.nan,
        *,
        t: float = math.nan,
    ) -> float: ...

    def half_loop(self) -> float: ...

    def domain(self) -> tuple[float, float]: ...

    def reset(self) -> None: ...

    def set(
        self, friction_angle: float | None = None, pretension: float | None = None, imbalance: float = 0.0
    ) -> None: ...


class Law:
    """Compute the motor torque of one axis; call `observe` in every cycle, and `update` in cycles with torque.

    Attributes:
        ideal, friction_term, planned: parts of the output, N*m at the motor.
        half_loop: friction torque of the model, N*m at the motor; refreshed every `_REFRESH` cycles.
    """

    def __init__(
        self,
        inverse: Inverse,
        radii: tuple[float, float],
        settings: LawSettings,
        plan: Plan,
        motion: Motion,
        direction: Direction,
        period: float,
        has_encoder: bool,
        joint_angle: JointAngle | None = None,
    ) -> None:
        """Prepare the law; `radii`: r_M, r_J in m; `period` in s; `joint_angle` refines a coarse joint encoder."""
        r_m, r_j = radii
        self.compensation = settings.compensation
        self.late = 0.0  # s, from the planned time of the cycle to its measurements
        self.temperature = math.nan  # degC; nan while it is not measured
        self.bound = math.inf  # 1, limit of the compensation by the proven friction (`compensation_limit`)
        self.confirmed = 1.0  # 1, of the friction torque in use, covered by the file; a client's excess is not proven
        self.slew = settings.slew
        self.plan = plan
        self.ideal = self.friction_term = self.planned = 0.0
        self.beyond = False
        self.cut = 0  # cycles with `beyond`
        self.near_slack = False
        self.notes = (*plan.notes, *inverse.notes)
        self.reversal = FrictionReversal(plan.front, plan.turn, period)
        self.damping = Damping(plan.damping, plan.ringing, plan.delay, r_j / r_m, period)
        self._inverse = inverse
        self._motion = motion
        self.direction = direction
        self._has_encoder = has_encoder
        self._joint_angle = joint_angle
        self._nominal = inverse.pretension
        cycle = 2.0 * math.pi / plan.ringing if plan.ringing > 0.0 else 0.0  # s
        self._at_rest = max(1.0, CYCLES * cycle / plan.turn)
        self._slip = ReversalSlip(plan.front, r_m, r_j, plan.stiffness, period)
        self.feedback = TorqueFeedback(settings.feedback, r_m / r_j, period)
        self.room = 0.0  # 1, of the friction torque, that the sensor may add to the term (`compensation_limit`)
        self._settle = settings.settle
        # A complete release changes the torque by up to 2 h. Each cycle releases the share
        # 2 pi f dt |excess| (r_M/r_J) / (2 h) of it.
        self._closing = math.pi * CLOSING * period * r_m / r_j
        self._ratio = r_m / r_j
        self._period = period
        self._give = 1.0 / plan.stiffness  # rad per N*m at the motor, joint locked
        self._delay, self._inertia, self._damps = plan.delay, plan.inertia, plan.damping > 0.0
        self._damps_at_rest = plan.damps_at_rest
        self._fade_step = period / settings.fade_in if settings.fade_in > 0.0 else 1.0
        self._stretch = self._blind = 0.0
        self.reset()

    @property
    def sigma(self) -> float:
        """Return the present direction of the friction term, -1 to 1."""
        return self.reversal.force

    @property
    def velocity(self) -> float:
        """Return the joint velocity, rad/s."""
        return self._motion.velocity

    @property
    def domain(self) -> tuple[float, float]:
        """Return the present lower and upper bound of the motor torque, N*m, between which both tendons pull."""
        return self._inverse.domain()

    @property
    def faded(self) -> bool:
        """Return True once the fade-in after the last enable is complete."""
        return self._fade >= 1.0

    @property
    def pretension(self) -> float:
        """Return T_p0 at the present wrap angle, N."""
        return self._inverse.pretension

    def reset(self) -> None:
        """Reset everything except the joint motion; the next enable starts without compensation and fades in."""
        self.ideal = self.friction_term = self.planned = self._fade = self._settled = 0.0
        self._correction = 0.0  # N*m, of the friction term, by the torque sensor
        self._wanted = 1.0  # 0 after the client of the socket has gone
        self.beyond = False
        self.direction.forget()
        self._slip.reset(self.direction.sigma)
        self._peak = 0.0  # N*m, largest set-point in the present direction
        self.damping.reset()
        self.feedback.reset()
        self._inverse.reset()
        self._stretch = 0.0
        self.half_loop = self._inverse.half_loop()
        self._until_refresh = _REFRESH

    def set_parameters(self, friction_angle: float, pretension: float, imbalance: float = 0.0) -> None:
        """Use another friction angle (1), pretension (N) and imbalance (1) of the two tendons from now on."""
        self._inverse.set(friction_angle, pretension, imbalance)
        self.half_loop = self._inverse.half_loop()

    def observe(self, q_j: float, q_m: float, fresh: bool, ahead: float, rate: float) -> None:
        """Process the measurements of one cycle.

        Args:
            q_j, q_m: angles of joint and motor, rad.
            fresh: True if the joint angle is new.
            ahead: set-point at the end of a reversal that starts now, N*m; nan without torque.
            rate: slope of that set-point, N*m/s; 0 without torque.
        """
        direction, reversal, motion = self.direction, self.reversal, self._motion
        since = self.late * motion.velocity  # rad, joint motion since the planned time
        if self._has_encoder:
            if fresh and self._joint_angle is not None:
                of_motor = self._ratio * (q_m - self._stretch)
                q_j = self._joint_angle.update(q_j, of_motor, motion.velocity, reversal.turning)
            motion.update(q_j - since, fresh)
        else:
            motion.update(self._ratio * (q_m - self._stretch) - since, fresh)
            self._blind = BLIND * self._motion.memory if reversal.turning else self._blind - self._period
            if self._blind > 0.0:  # the reversal itself moves the motor, but not the joint
                reversal.update(direction.sigma)
                return
        old = direction.sigma
        rested = direction.rest
        sigma = direction.update(ahead, rate)
        if sigma != old:
            slip, inverse = self._slip, self._inverse
            slip.turn(reversal)
            if rested > STOOD and ahead == ahead:
                pull = self.friction_term - self._correction + self._ratio * self._peak
                slip.begin(sigma, pull, inverse.friction_angle, inverse.pretension)
            else:
                slip.slide(sigma)
            self._peak = ahead if ahead == ahead else 0.0
        elif ahead * sigma > self._peak * sigma:
            self._peak = ahead
        if direction.rest == 0.0:
            self._slip.move()
        elif direction.missing > 0.0 and self.half_loop > 0.0:
            self._slip.release(self._closing * direction.missing / self.half_loop)
        slower = self._at_rest if sigma != old and direction.rest > STOOD else 1.0
        reversal.update(sigma, direction.age, slower)

    def skip_cycles(self, periods: int) -> None:
        """Account for periods without a cycle: extrapolate the joint motion and continue a planned reversal."""
        for _ in range(min(periods, MOST_EXPECTED)):
            self._motion.update(math.nan, False)
            self.reversal.update(self.direction.sigma)
            self.damping.skip_cycles()

    def update(self, tau_j: float, q_m: float, omega_m: float, t: float, back_off: float) -> float:
        """Return the desired motor torque, N*m.

        Args:
            tau_j: set-point at the time when the command acts, N*m.
            q_m, omega_m: angle and speed of the motor, rad and rad/s.
            t: time since the enable, s.
            back_off: factor of the compensation in [-1, 1]; a negative factor adds to the friction.
        """
        inverse, motion, reversal, slip = self._inverse, self._motion, self.reversal, self._slip
        ideal = tau_j * self._ratio
        fade = self._fade
        if fade < 1.0:
            self._fade = fade = min(1.0, fade + self._fade_step)
        compensation, bound = self.compensation, self.bound * self.confirmed
        if compensation > bound:
            compensation = bound
        share = compensation * fade * back_off * (1.0 - self._settle * self._settled) * self._wanted
        acceleration = motion.acceleration
        velocity, delay = motion.velocity, self._delay
        omega = velocity + delay * acceleration
        angle, motor = motion.angle + delay * velocity, q_m + delay * omega_m  # when the torque acts
        full = inverse.update(tau_j, reversal.force, omega, angle, motor, self.temperature, t=t)
        slip.update(tau_j, inverse.friction_angle, inverse.pretension, reversal)
        term = self.friction_term
        change = share * (full + slip.torque - ideal) - term
        self._correction = 0.0
        if self.feedback.used and share > 0.0:
            room = (back_off == 1.0) * self.room * (1.0 - self._settled) * self._wanted * self.half_loop
            self._correction = fade * self.feedback.torque(reversal.force, self.half_loop, room)
            change += self._correction
        if back_off == 1.0:  # the guard's action is never delayed
            step = self.slew * self._period
            change = step if change > step else -step if change < -step else change
        self.ideal = ideal
        self.friction_term = term = term + change
        wanted = ideal + term
        low, high = inverse.domain()
        self.beyond = (share > 0.0 and inverse.clipped) or wanted < low or wanted > high
        if self.beyond:
            wanted = low if wanted < low else high if wanted > high else wanted
            self.cut += 1
        still = ideal * self._give
        self._stretch = stretch = still + share * (slip.stretch - still)
        planned = 0.0
        if self._inertia > 0.0:  # torque that moves the motor as planned, and damps deviations from the plan
            planned = self._inertia * (share * slip.bend + acceleration / self._ratio)
            if self._damps:
                damping = self.damping.update(stretch, q_m, omega_m, motion.angle, motion.velocity)
                if self._damps_at_rest or self.direction.rest < STANDING:
                    planned += damping
        self.planned = planned
        return wanted + planned

    def update_backoff(self, rate: float, silent: bool = False) -> None:
        """Update the removed share of the friction term for the next command.

        Args:
            rate: slope of the set-point, N*m/s.
            silent: True if the set-points of the socket have ended; the whole term then fades out.
        """
        velocity = self._motion.velocity
        step = self._period / SETTLING
        if -STANDS < rate < STANDS and -SLOW < velocity < SLOW:
            self._settled += step * (1.0 - self._settled)
        else:
            self._settled -= min(1.0, 5.0 * step) * self._settled
        if silent:
            self._wanted = max(0.0, self._wanted - step)
        elif self._wanted < 1.0:
            self._wanted = min(1.0, self._wanted + 5.0 * step)
        self._until_refresh -= 1
        if self._until_refresh <= 0:
            self._until_refresh = _REFRESH
            self.half_loop = self._inverse.half_loop()
            self.near_slack = self._inverse.pretension < NEAR_SLACK * self._nominal

    def learn(self, excess: float, limited: bool = False) -> None:
        """Update the correction with the joint torque sensor's result of this cycle.

        Args:
            excess: delivered minus desired joint torque, N*m; nan without a measurement.
            limited: True if the compensation limit reduces the friction term.
        """
        reversal = self.reversal
        if self.feedback.used and not self.beyond:
            self.feedback.update(
                excess,
                reversal.force,
                reversal.turning,
                self.direction.moving,
                not self.faded,
                limited,
                self.ideal,
                self.friction_term,
                self._correction,
                self.half_loop,
            )

    def swing(self, omega_m: float) -> float:
        """Return the kinetic energy (J) of the motor at `omega_m` rad/s relative to the joint; 0 outside a reversal."""
        if not self.reversal.turning or not self._has_encoder:
            return 0.0
        return 0.5 * self._inertia * (omega_m - self._motion.velocity / self._ratio) ** 2

    def applied(self, tau_m: float) -> None:
        """Account for the sent torque (N*m), so that a clipped friction term and elongation continue from there."""
        left = tau_m - self.ideal - self.planned
        term = self.friction_term
        wanted = self.ideal + term
        if wanted * wanted > (self.ideal + left) * wanted:
            self._stretch *= max(0.0, (self.ideal + left) / wanted)
            self.damping.replace_plan(self._stretch)
        if (term > 0.0 and left < term) or (term < 0.0 and left > term):
            self.friction_term = 0.0 if left * term < 0.0 else left
