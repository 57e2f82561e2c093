"""Connect the parts of one controlled axis, so that they start, stop and reset together."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from tsa_ctrl.bus.canopen.cia402 import PowerState, decode
from tsa_ctrl.bus.live.axis import Axis as BusAxis
from tsa_ctrl.bus.live.image import Image
from tsa_ctrl.control.bending import Bending
from tsa_ctrl.control.compensation_limit import CompensationLimit
from tsa_ctrl.control.estimator import ConfigurationMap, Estimator, Fixed, Sample
from tsa_ctrl.control.law import Law
from tsa_ctrl.control.setpoint import SetPoint
from tsa_ctrl.control.temperature import Temperature
from tsa_ctrl.model.composition import Stack
from tsa_ctrl.model.effects.lever import unmoved
from tsa_ctrl.model.functions import SCALARS
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.steady_sliding import sliding_by, transmitted_by
from tsa_ctrl.observer.joint_torque import JointTorque
from tsa_ctrl.observer.stretch import StretchState
from tsa_ctrl.safety.causes import Cause, Finding
from tsa_ctrl.safety.compensation_backoff import CompensationBackoff, Observed
from tsa_ctrl.safety.limiter import Limiter, Reason
from tsa_ctrl.safety.lost_commands import LostCommands
from tsa_ctrl.safety.plausibility import Plausibility
from tsa_ctrl.safety.polarity_check import PolarityCheck
from tsa_ctrl.safety.supervisor import Phase, Request, Supervisor

# Joint torque, tendon tensions, wrap angle and temperature come from a node on the bus or from separate sensors.

Source = Callable[[float], float]  # monotonic time now (s) -> SI value; nan if it is missing or too old


class Instruments:
    """Hold the measurements of one axis in this cycle; nan if a measurement is missing or too old."""

    __slots__ = (
        "_image",
        "_t1",
        "_t3",
        "_tau_j",
        "_temperature",
        "_theta",
        "t1",
        "t3",
        "tau_j",
        "temperature",
        "theta",
    )

    def __init__(self, image: Image) -> None:
        self._image = image
        self._tau_j: Source | None = None
        self._t1: Source | None = None
        self._t3: Source | None = None
        self._theta: Source | None = None
        self._temperature: Source | None = None
        self.tau_j = math.nan  # N*m, joint torque
        self.t1 = math.nan  # N, motor-side tension of tendon a
        self.t3 = math.nan  # N, motor-side tension of tendon b
        self.theta = math.nan  # rad, wrap angle of the sheath
        self.temperature = math.nan  # degC, of the sheath

    def connect(self, sources: Mapping[str, Source]) -> None:
        """Read "tau_j", "t1", "t3", "theta" or "temperature" from these sources instead of the bus."""
        self._tau_j, self._t1, self._t3, self._theta = (sources.get(name) for name in ("tau_j", "t1", "t3", "theta"))
        self._temperature = sources.get("temperature")

    def update(self, now: float) -> None:
        """Read all sources at the monotonic time `now` (s), in about a microsecond each."""
        self.tau_j = self._image.tau_j if self._tau_j is None else self._tau_j(now)
        if self._t1 is not None:
            self.t1 = self._t1(now)
        if self._t3 is not None:
            self.t3 = self._t3(now)
        if self._theta is not None:
            self.theta = self._theta(now)
        if self._temperature is not None:
            self.temperature = self._temperature(now)


BENT = 2.5  # of the friction torque: a sheath bent 40 % more has 1.4 times the angle and 1.8 times the pretension
_TRIPPING = {Reason.OVER_SPEED: Cause.OVER_SPEED, Reason.NOT_FINITE: Cause.NOT_FINITE}
_ON = (PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE, PowerState.FAULT_REACTION_ACTIVE)
NOTICEABLE = 1e-3  # smallest relative change of a parameter that the law adopts


@dataclass(slots=True)
class Terms:
    """Hold the inputs and results of the last cycle for the log, in SI units."""

    q_j: float = 0.0
    omega_j: float = 0.0
    q_m: float = 0.0  # rad, of the motor without `routed`, as if both paths had the same length
    omega_m: float = 0.0
    routed: float = 0.0  # rad of the motor, caused by paths of different lengths
    tau_j_des: float = 0.0
    tau_m_cmd: float = 0.0
    sigma: float = 0.0
    theta: float = 0.0
    reason: Reason = Reason.DISABLED
    permitted: bool = False
    state: float = 0.0  # code of the drive's state
    t: float = 0.0  # s, planned time of the cycle, and its number
    cycle: float = 0.0
    lateness: float = 0.0  # s, from the planned time to SYNC
    work: float = 0.0  # s, execution time until the commands were sent
    drive_age: float = 0.0  # s since the last PDOs of the drive, as of the last status
    joint_age: float = 0.0  # s, of the joint encoder, or of the drive without one
    sensor_age: float = 0.0  # s, of the torque sensor on the bus; 0 without one


@dataclass(frozen=True)
class Safeguards:
    """Hold the parts of an axis that can remove or reduce its torque."""

    supervisor: Supervisor
    limiter: Limiter
    polarity_check: PolarityCheck
    guard: CompensationBackoff
    plausibility: Plausibility
    joint_torque: JointTorque
    compensation_limit: CompensationLimit


@dataclass(frozen=True)
class Timing:
    """Hold the times of an axis, s.

    Attributes:
        period: period of the loop.
        most_age: largest age of measurements that may drive the motor.
        stop_time: duration of the ramp from full torque to 0.
    """

    period: float
    most_age: float
    stop_time: float


class ControlAxis:
    """Control one axis by its parts; its clock starts at every enable."""

    def __init__(
        self,
        io: BusAxis,
        model: TendonSheath,
        set_point: SetPoint,
        bending: Bending,
        estimator: Estimator,
        law: Law,
        safeguards: Safeguards,
        timing: Timing,
        has_torque_sensor: bool,
    ) -> None:
        """Connect the parts; `has_torque_sensor`: True if the bus or a serial line has a joint torque sensor."""
        self.name = io.name
        self.io = io
        self.image: Image = io.image
        self.instruments = Instruments(io.image)
        self._temperature = Temperature(timing.period)
        self.model = model
        self.supervisor = safeguards.supervisor
        self.set_point = set_point
        self.direction = law.direction
        self.bending = bending
        self.estimator = estimator
        self.law = law
        self.limiter = safeguards.limiter
        self.polarity_check = safeguards.polarity_check
        self.guard = safeguards.guard
        self.compensation_limit = safeguards.compensation_limit
        self.plausibility = safeguards.plausibility
        self.joint_torque = safeguards.joint_torque
        self._lost_commands = LostCommands(io.readback, str(io.image.nodes[0]))
        self.most_age = timing.most_age
        self.request = Request.DISABLE
        self.ramp = 1.0
        self.terms = Terms()
        self._period = timing.period
        self._stop_time = timing.stop_time
        self._register: Callable[[], tuple[float, float] | None] = lambda: None
        self._ramp_from: float | None = None  # s, when the ramp to 0 began
        self._stopping = False
        self._enabled_at: float | None = None
        self._has_encoder = io.nodes.encoder is not None
        self._ratio = model.motor_pulley_radius / model.joint_pulley_radius
        self._gearing = 1.0 / self._ratio
        # rad of the motor per rad of `Bending.path_difference`
        self._path_arm = model.lever / model.motor_pulley_radius
        self.limiter.ceiling = self.polarity_check.ceiling
        self._used = (model.friction_angle, model.pretension)
        self._imbalance = 0.0  # 1, of the two tendons' friction angles
        self._nominal = self._used
        self._sliding = sliding_by(model)
        self._nominal_half_loop = abs(self._sliding(1.0, *self._nominal).motor_half_loop)
        self._effects = Stack.of(model.effects, model.source)
        self._still = unmoved(model.bending_angle)
        self._measures_wrap_angle = isinstance(estimator, ConfigurationMap)
        self._transmitted = transmitted_by(model)
        self._has_torque_sensor = has_torque_sensor
        self._sample = Sample(0.0, 0.0, math.nan, math.nan, math.nan, False)
        self._observed = Observed()
        law.bound = self.compensation_limit.share

    @property
    def reason(self) -> Reason:
        """Return why this cycle's torque is not the desired one, with priority for the limiter and then the guard."""
        return self.terms.reason or self.guard.reason or self.compensation_limit.reason

    @property
    def trusted(self) -> bool:
        """Return True if a tuning of this joint wrote the model file; each bring-up sets it before any enable."""
        return self.compensation_limit.trusted

    @trusted.setter
    def trusted(self, value: bool) -> None:
        self.compensation_limit.trusted = value

    @property
    def at_rest(self) -> bool:
        """Return True if the drive is known to be disabled, or if a fault keeps it disabled."""
        return self.supervisor.phase in (Phase.STANDBY, Phase.FAULT)

    @property
    def is_off(self) -> bool:
        """Return True if no torque is permitted, and the drive does not report that its power stage is on."""
        return self.at_rest and not (self.image.fresh and decode(self.image.statusword) in _ON)

    def enable(self) -> None:
        """Request torque, which fades in once drive and supervisor permit it."""
        self._stopping = False
        self._ramp_from = None
        self.ramp = 1.0
        self.request = Request.ENABLE

    def stop(self) -> None:
        """Ramp the torque to 0, then disable the drive."""
        self._stopping = True
        if self.request is not Request.ENABLE:
            self.request = Request.DISABLE

    def connect(self, register: Callable[[], tuple[float, float] | None]) -> None:
        """Connect the function that returns each new set-point of the socket once: value (N*m), monotonic time (s)."""
        self._register = register

    def joint(self) -> tuple[float, float]:
        """Return angle (rad) and velocity (rad/s) of the joint; without an encoder, the geared values of the motor."""
        image = self.image
        if self._has_encoder:
            return image.q_j, image.omega_j
        return image.q_m * self._ratio, image.omega_m * self._ratio

    def present_motion(self) -> tuple[float, float]:
        """Return the joint's angle (rad) and velocity (rad/s) in this cycle; nan while they are missing or too old."""
        age, velocity = self.image.pdo_age, self.law.velocity
        if not age <= self.most_age:
            return math.nan, math.nan
        return self.joint()[0] + age * velocity, velocity

    def read_motion(self) -> None:
        """Store this cycle's motion of motor and joint in `terms`."""
        image, terms = self.image, self.terms
        terms.q_j, terms.omega_j = self.joint()
        difference, rate = self.bending.path_difference()
        terms.routed = self._path_arm * difference
        terms.q_m, terms.omega_m = image.q_m - terms.routed, image.omega_m - self._path_arm * rate

    def since_enable(self, now: float) -> float:
        """Return the seconds since torque was permitted; the first call after a release starts the clock."""
        if self._enabled_at is None:
            self._enabled_at = now
        if self._stopping:
            if self._ramp_from is None:
                self._ramp_from = now - self._period
            self.ramp = 1.0 - (now - self._ramp_from) / self._stop_time  # by time, so lost cycles do not lengthen it
            if self.ramp <= 1e-9:
                self.ramp = 0.0
                self.request = Request.DISABLE
        return now - self._enabled_at

    def receive_setpoint(self, now: float, t: float) -> None:
        """Accept the set-point that has arrived since the last cycle; `t`: s since the enable.

        Its age follows from the client's time stamp, which is limited to `now`.
        """
        found = self._register()
        if found is not None:
            value, time = found
            self.set_point.receive(value, t - max(now - time, 0.0))

    def after_command(self, now: float) -> None:
        """Complete a cycle after its command: inform the law, latch the limiter's findings, use the measurements."""
        image, terms, instruments = self.image, self.terms, self.instruments
        instruments.update(now)
        self.law.temperature = self._temperature.update(instruments.temperature)
        terms.theta = theta = self.bending.update()
        self.joint_torque.update(
            image, terms.omega_j, instruments.tau_j, terms.tau_m_cmd, terms.permitted, terms.routed
        )
        proven, law = self.compensation_limit.proven, self.law
        stretch = self.joint_torque.stretch
        tau_m = self._frictionless_torque() if image.fresh else math.nan
        if stretch is not None and image.fresh and stretch.state is StretchState.ESTIMATED:
            proven.compare(
                instruments.tau_j,
                stretch.torque,
                tau_m,
                terms.q_m,
                terms.q_j,
                stretch.confirmation.confirmed,
                terms.omega_j,
            )
        if not image.fresh:
            proven.miss(self._period)
        elif not terms.permitted:
            proven.pause()
        else:
            proven.update(
                tau_m,
                image.omega_m,
                terms.q_m,
                terms.q_j,
                instruments.tau_j,
                law.velocity,
                law.reversal.turning,
                law.half_loop if self._measures_wrap_angle else self._nominal_half_loop,
            )
        if not terms.permitted:
            self.release()
            self.plausibility.learn(instruments.tau_j if image.fresh else math.nan)
            return
        self.law.applied(terms.tau_m_cmd)
        if self._has_torque_sensor:
            # A stop only reduces torque, whatever the tendons still hold. Without compensation, no term reverses.
            counts = image.fresh and self.ramp == 1.0 and law.compensation > 0.0
            excess = self._sensed - terms.tau_j_des if counts else math.nan
            self.direction.measure(excess, law.reversal.turning)
            law.learn(excess, self.compensation_limit.reason is not Reason.NONE)
        lost = self._lost_commands.update(now)
        if lost is not None:
            self.supervisor.trip(lost, now)
        if terms.reason in _TRIPPING:
            detail = f"joint {terms.omega_j:.1f} rad/s, motor {image.omega_m:.1f} rad/s, at the limiter"
            self.supervisor.trip(Finding(_TRIPPING[terms.reason], detail), now)
        if image.fresh:
            feedback = (image.tau_m, image.q_m, image.omega_m)
            tau_j = instruments.tau_j
            expected = self._expected() if tau_j == tau_j else (0.0, 0.0)
            wrong = self.plausibility.update(now, terms.tau_m_cmd, feedback, terms.q_j, tau_j, expected, terms.routed)
            wrong = wrong or self.polarity_check.update(
                now, image.tau_m, self._stretch(), image.tau_j, terms.sigma, terms.omega_j
            )
            self.limiter.ceiling = self.polarity_check.ceiling
            soft = None if wrong else self.joint_torque.contradiction
            if soft is not None:
                wrong = Finding(Cause.SOFT_TENDONS, soft)
            if wrong is not None:
                self.joint_torque.distrust()
                self.supervisor.trip(wrong, now)
        else:
            self.plausibility.skip_cycles()
        sample = self._sample
        sample.sigma, sample.omega_j, sample.theta = terms.sigma, terms.omega_j, theta
        sample.tau_m, sample.tau_j, sample.admit = image.tau_m, self._sensed, image.fresh
        sample.q_j, sample.q_m, sample.t1, sample.t3 = terms.q_j, image.q_m, instruments.t1, instruments.t3
        sample.fading = self.bending.fading
        sample.temperature = self.law.temperature
        sample.t = self.since_enable(now)
        self.estimator.update(sample)
        self.adapt()
        self._watch()
        self.law.update_backoff(self.set_point.rate, self.set_point.silent)

    def _frictionless_torque(self) -> float:
        """Return the reported motor torque with the ripple and torque constant of the model, but without friction, N*m.

        A ripple depends on the motor angle alone, so its compensation adds no energy in a cycle. The direction in
        `_still` is 0, so friction in the motor adds nothing. A file that no tuning of this joint wrote may have the
        ripple of another motor.
        """
        if not self.trusted:
            return self.image.tau_m
        self._still.q_m = self.terms.q_m
        return self._effects.on_the_pulley(SCALARS, self.image.tau_m, self._still)

    def _expected(self) -> tuple[float, float]:
        """Return the joint torque (N*m) of the model for the motor torque, with friction in either direction.

        A slow tendon may stick for seconds after the law's direction has reversed. The estimate may also lag behind an
        increase of the bending (BENT).
        """
        angle, pretension = self._used
        more = self.bending.most_more
        if more > 0.0 and isinstance(self.estimator, ConfigurationMap):  # the angle of another joint is missing
            angle, pretension = self.estimator.parameters(self.terms.theta + more)
        with_motion, against = self._transmitted(self.image.tau_m, angle, pretension)
        middle, either = 0.5 * (with_motion + against), 0.5 * BENT * (with_motion - against)
        return middle + either, middle - either

    def _stretch(self) -> float:
        """Return the angle between motor and joint, rad at the motor; nan without an encoder."""
        return self.terms.q_m - self.image.q_j / self._ratio if self._has_encoder else math.nan

    def skip_cycles(self, periods: int) -> None:
        """Account for periods without a cycle, because the loop was late, in all parts that count cycles."""
        self.image.skipped += periods
        self.law.skip_cycles(periods)
        self.joint_torque.skip_cycles(periods)
        self.plausibility.skip_cycles()
        self.compensation_limit.proven.miss(periods * self._period)
        if self._enabled_at is not None:  # the guard runs only with torque
            self.guard.skip_cycles(periods)

    def release(self) -> None:
        """Reset all states of the axis once, when torque is no longer permitted."""
        if self._stopping and self.request is Request.ENABLE:
            self.request = Request.DISABLE
        if self._enabled_at is None:
            return
        self._enabled_at = None
        self.set_point.reset()
        self.estimator.reset()
        self.law.reset()
        self.guard.reset()
        self.law.damping.share = 1.0
        self.compensation_limit.reset()
        self.law.bound = self.compensation_limit.share
        self.plausibility.reset()
        self.polarity_check.reset()
        self._lost_commands.reset()
        self.limiter.ceiling = self.polarity_check.ceiling
        self.terms.tau_j_des = 0.0
        self._take_over(self._nominal)

    @property
    def _sensed(self) -> float:
        """Return the torque of the joint torque sensor, N*m; nan while the tendon elongation contradicts it."""
        return math.nan if self.compensation_limit.proven.contradicted else self.instruments.tau_j

    def _delivered(self) -> float:
        """Return the joint torque by its sensor, or else by the tendon elongation, N*m; nan while it is unknown."""
        if not self.image.fresh:
            return math.nan
        if self._has_torque_sensor and not self.compensation_limit.proven.contradicted:
            return self.instruments.tau_j
        stretch = self.joint_torque.stretch
        return self.joint_torque.torque if stretch is not None and stretch.state is StretchState.ESTIMATED else math.nan

    def _watch(self) -> None:
        """Pass the effect of the compensation to the guard, and apply its request."""
        law, terms, guard, gearing = self.law, self.terms, self.guard, self._gearing
        velocity = law.velocity
        swing = law.swing(terms.omega_m) if law.reversal.turning else 0.0
        seen = self._observed
        seen.tau_j, seen.omega_j = self._delivered(), velocity
        seen.wanted, seen.rate = self.ramp * terms.tau_j_des, self.set_point.rate
        seen.term, seen.half_loop = gearing * law.friction_term, gearing * law.half_loop
        seen.added, seen.ideal = terms.tau_m_cmd - law.ideal, law.ideal
        seen.swing, seen.turns = swing, self.direction.follows
        guard.update(seen)
        law.damping.share = guard.damping
        if guard.ratio == guard.ratio:
            self.compensation_limit.observe(guard.ratio * law.half_loop)
        limit, moving = self.compensation_limit, velocity if abs(velocity) > self.direction.zone else 0.0
        law.bound = limit.update(
            law.half_loop,
            law.friction_term,
            moving,
            terms.tau_j_des,
            self.set_point.rate,
            law.compensation,
            self._sensed if limit.proven.confirms_sensor else math.nan,
        )
        law.room = limit.room

    def adapt(self) -> None:
        """Pass the estimate to the law if that is permitted, otherwise the model file's values."""
        estimator = self.estimator
        angle, pretension = self._nominal
        if estimator.use:
            angle, pretension = estimator.friction_angle, estimator.pretension
        theta = self.terms.theta
        imbalance = self.bending.difference / theta if theta > 0.0 else 0.0
        used_angle, used_pretension = self._used
        if (
            abs(angle - used_angle) > NOTICEABLE * used_angle
            or abs(pretension - used_pretension) > NOTICEABLE * used_pretension
            or abs(imbalance - self._imbalance) > NOTICEABLE
        ):
            self._take_over((angle, pretension), imbalance)

    def _take_over(self, parameters: tuple[float, float], imbalance: float = 0.0) -> None:
        if (*parameters, imbalance) != (*self._used, self._imbalance):
            self._used, self._imbalance = parameters, imbalance
            self.law.set_parameters(*parameters, imbalance)
            if isinstance(self.estimator, Fixed):  # a client's value is no proof of more friction
                half_loop = abs(self._sliding(1.0, *parameters).motor_half_loop)
                self.law.confirmed = min(1.0, self._nominal_half_loop / half_loop) if half_loop > 0.0 else 1.0
            self.joint_torque.set_parameters(*parameters, imbalance, bent=self._measures_wrap_angle)
            if self._measures_wrap_angle:
                self.compensation_limit.proven.set_slopes(self.joint_torque.model.slopes)
