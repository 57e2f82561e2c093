"""Build the parts of the loop from a checked configuration."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from enum import Enum
from pathlib import Path

import msgspec

from tsa_ctrl.bus.canopen.cia402 import PowerState
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.config import AxisSettings, Configuration, ControllerFile, joint_ranges
from tsa_ctrl.control.axis import ControlAxis, Safeguards, Timing
from tsa_ctrl.control.bending import Bending, Reading, routing_of
from tsa_ctrl.control.compensation_limit import Bound, CompensationLimit, bound_of, unmeasured_notes
from tsa_ctrl.control.direction import OVERSHOOT, UNSURE, Direction
from tsa_ctrl.control.estimator import ConfigurationMap, EstimateState, Estimator, Fixed
from tsa_ctrl.control.kalman import KalmanEstimator
from tsa_ctrl.control.law import Law
from tsa_ctrl.control.law_design import Plan
from tsa_ctrl.control.live_parameters import Tuner, parameters_of
from tsa_ctrl.control.motion_filter import FINER, LONGEST, WORTH, JointAngle, Motion
from tsa_ctrl.control.setpoint import SetPoint
from tsa_ctrl.control.settings import Attribution
from tsa_ctrl.control.stretch_estimator import StretchEstimator
from tsa_ctrl.control.tension_estimator import TensionEstimator
from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc.protocol import Description, Range, default_path
from tsa_ctrl.log.process import LogHeader
from tsa_ctrl.model.composition import Stack
from tsa_ctrl.model.feedforward import Feedforward
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.steady_sliding import (
    joint_compliance,
    least_stiffness,
    motor_stiffness,
    reversal_travel,
    sliding,
    wound_by_friction,
)
from tsa_ctrl.model.stretch import compliance_centre, profile_of, stretch_line
from tsa_ctrl.observer.friction_proof import EVERY, FrictionProof, SensorEvidence
from tsa_ctrl.observer.joint_torque import ElongationTorque, JointTorque, ModelTorque
from tsa_ctrl.observer.proven_friction import ProvenFriction
from tsa_ctrl.observer.stretch import StretchObserver
from tsa_ctrl.readiness import loose_lines
from tsa_ctrl.safety.causes import REMEDIES
from tsa_ctrl.safety.compensation_backoff import CompensationBackoff
from tsa_ctrl.safety.limiter import Limiter, Reason
from tsa_ctrl.safety.plausibility import Plausibility
from tsa_ctrl.safety.polarity_check import PolarityCheck
from tsa_ctrl.safety.residuals import DOUBT, FRICTION, Give
from tsa_ctrl.safety.supervisor import Supervisor
from tsa_ctrl.settings import referenced


class LoopPhase(Enum):
    """Phases of the loop; the values are the codes in the status."""

    STARTING = 0  # the child processes run, the bus is brought up
    SETTLING = 1  # cycles run with torque 0 until all nodes respond
    RUNNING = 2
    FAULTED = 3  # latched; torque 0 until a recovery or a stop is requested
    STOPPING = 4  # the torque ramps to 0, the drives are disabled
    RESETTING = 5  # a recovery was requested
    ENDED = 6

    @property
    def up(self) -> bool:
        """Return True if startup is over: the loop is running or has latched a fault."""
        return self in (LoopPhase.RUNNING, LoopPhase.FAULTED)

    @property
    def ending(self) -> bool:
        """Return True if the run may end without another ramp."""
        return self in (LoopPhase.STOPPING, LoopPhase.ENDED)


# Energy, J, that a friction term may feed into the joint before a sensor confirms the friction. Worn: a tenth of the
# energy that a person tolerates. Bench: a joint of 0.02 kg*m^2 at 6 rad/s, which can only hit the bench. A model file
# that was not tuned on this joint may belong to a worn joint, so it has the credit of that class until the friction
# confirms it.
UNPROVEN_ENERGY = {"worn": 0.1, "bench": 0.4}
# An older angle of another joint counts as missing, however many lost PDOs the bus tolerates: the friction must be that
# of the least wrap angle 50 ms after the loss, and 44 ms of them are the transition.
OLDEST_ANGLE = 6e-3  # s
LEAST_PERIODS = 3.5  # periods; three lost PDOs
AT_JOINT = 0.025  # 1, distance of the centre of bending from the joint over the length; no file is more precise
ZONE_OF_A_MOTOR = 0.1  # rad/s at the joint; the ringing of the motor that remains after averaging is slower
STATES = tuple(PowerState)
STATE_CODE = {state: float(code) for code, state in enumerate(STATES)}
CODES = {  # names of the values of each coded signal, from 0 on
    "state": [state.value for state in STATES],
    "estimate_state": [state.name.lower() for state in EstimateState],
    "limit_reason": [reason.name.lower() for reason in Reason],
}


def control_axes(configuration: Configuration, rig: Rig) -> tuple[ControlAxis, ...]:
    """Return one controlled axis for each axis of the rig."""
    file, period = configuration.file, configuration.period
    supervision = file.bus.supervision
    most_age = (supervision.tolerated_misses + 1.5) * period
    axes = []
    for settings, io, model, profile, plan, reason_for_fixed in zip(
        file.axes,
        rig.axes,
        configuration.models,
        configuration.profiles,
        configuration.plans,
        configuration.estimators,
        strict=True,
    ):
        joint_torque = joint_torque_of(settings, model, plan.inertia, period)
        supervisor = Supervisor(
            supervision, profile.reports_following, profile.mode_shows == "enabled", file.controller.rate
        )
        limit = CompensationLimit(
            bound_for(settings, model, joint_torque, reason_for_fixed, routing_notes(settings, model, file)),
            friction_proof_of(settings, model, joint_torque, plan.inertia, period),
            UNPROVEN_ENERGY[file.safety.use_class],
            model.joint_pulley_radius / model.motor_pulley_radius,
            period,
            UNPROVEN_ENERGY["worn"],
        )
        axes.append(
            ControlAxis(
                io=io,
                model=model,
                set_point=SetPoint(
                    settings.setpoint,
                    period,
                    configuration.folder,
                    plan.delay,
                    plan.lead,
                    plan.turn + plan.delay,
                    set_point_limit(settings, model),
                ),
                bending=Bending(settings.bending, model.bending_angle, routing_of(settings.bending, model.routing)),
                estimator=estimator_of(settings, model, joint_torque, period),
                law=law_of(settings, model, plan, period),
                safeguards=safeguards_of(settings, model, supervisor, joint_torque, limit, plan.inertia, period),
                timing=Timing(period, most_age, file.controller.stop_time),
                has_torque_sensor=settings.has_torque_sensor,
            )
        )
    by_name = {axis.name: axis for axis in axes}
    travel = joint_ranges(file.axes)
    for settings, axis, plan in zip(file.axes, axes, configuration.plans, strict=True):
        unmeasured, ahead = settings.bending.unmeasured, plan.delay + period  # the estimate acts from the next cycle on
        oldest = min(most_age, max(OLDEST_ANGLE, LEAST_PERIODS * period))
        measured = {name: _motion_of(other, oldest) for name, other in by_name.items() if name not in unmeasured}
        axis.bending.connect(measured, {**travel, **unmeasured}, period, ahead)
        if settings.bending.source == "sensor":
            axis.bending.measure(_measured_bending(axis))
    return tuple(axes)


def safeguards_of(
    settings: AxisSettings,
    model: TendonSheath,
    supervisor: Supervisor,
    joint_torque: JointTorque,
    limit: CompensationLimit,
    inertia: float,
    period: float,
) -> Safeguards:
    """Return the parts of one axis that may remove its torque; motor `inertia` in kg*m^2, `period` in s."""
    r_m, r_j = model.motor_pulley_radius, model.joint_pulley_radius
    return Safeguards(
        supervisor=supervisor,
        limiter=Limiter(settings.limits, period),
        polarity_check=polarity_check_of(settings, model, period),
        guard=CompensationBackoff(
            settings.passivity,
            period,
            by_stretch=not settings.has_torque_sensor,
            compliance=joint_compliance(model),
        ),
        plausibility=Plausibility(
            settings.plausibility,
            settings.limits.torque,
            settings.drive.rated_torque * settings.drive.gear_ratio,
            (r_m, r_j),
            settings.encoder is not None,
            give_of(settings, model, inertia),
            period,
            counts_of(settings, r_j / r_m),
            not settings.drive.differentiates,
        ),
        joint_torque=joint_torque,
        compensation_limit=limit,
    )


def law_of(settings: AxisSettings, model: TendonSheath, plan: Plan, period: float) -> Law:
    """Return the control law of one axis, with its filter of the joint's motion and its detector of the direction."""
    r_m, r_j = model.motor_pulley_radius, model.joint_pulley_radius
    encoder, direction = settings.encoder, settings.direction
    of_motor, of_joint = counts_of(settings, 1.0)
    joint_angle = None
    if encoder is not None:
        finest = max(r_m / r_j * of_motor, of_joint / FINER)
        if WORTH * finest < of_joint:
            joint_angle = JointAngle(of_joint, period)
        motion = Motion(period, of_joint if joint_angle is None else finest, plan.lead)
    else:
        motion = Motion(period, r_m / r_j * of_motor, 0.0, LONGEST)  # averages over the motor's ringing on its tendons
        direction = msgspec.structs.replace(direction, zone=max(direction.zone, ZONE_OF_A_MOTOR))
    signals = {"q_m"} if encoder is None else {"q_j", "q_m"}
    if settings.temperature.source != "none":
        signals.add("temperature")
    inverse = Feedforward(model, period, signals)
    way = reversal_travel(model)
    friction = abs(sliding(model).half_loop)
    unsure = UNSURE if bent_at_joint(model) else UNSURE + OVERSHOOT * friction
    seen = Direction(direction, motion, plan.lead, plan.reach, r_j, period, plan.give, way, unsure, friction)
    return Law(inverse, (r_m, r_j), settings.law, plan, motion, seen, period, encoder is not None, joint_angle)


def set_point_limit(settings: AxisSettings, model: TendonSheath) -> float:
    """Return the largest set-point, N*m: the joint torque at the motor's torque limit without friction."""
    return settings.limits.torque * model.joint_pulley_radius / model.motor_pulley_radius


def give_of(settings: AxisSettings, model: TendonSheath, inertia: float) -> Give:
    """Return the compliance between motor and joint, with the uncertainty of friction and stiffness.

    `inertia` of the motor is in kg*m^2, and 0 if it is not known.
    """
    stiffness = motor_stiffness(model)
    friction = model.most_friction - 1.0
    lost = float(model.effects.get("motor_side_friction", {}).get("coulomb", 0.0))
    geared = model.joint_pulley_radius / model.motor_pulley_radius
    play = 2.0 * geared * float(model.effects.get("backlash", {}).get("gap", 0.0))
    least_free, free = free_shares(model)
    return Give(
        stiffness=stiffness,
        wound=wound_by_friction(model) + 2.0 * lost / stiffness,
        domain=taut_torque(model),
        play=play + sum(counts_of(settings, geared)),
        doubt=max(DOUBT, 2.0 * model.axial_stiffness_uncertainty),
        free=free,
        least_free=least_free,
        friction=max(FRICTION, friction),
        inertia=inertia,
    )


def taut_torque(model: TendonSheath) -> float:
    """Return the motor torque up to which both tendons pull in both directions, (3.54), N*m.

    The elongation lowers the pretension of tendons that the joint drives. With all bends at the motor and x = 0.8, one
    of them is slack at half of 2 T_p r_M.
    """
    if "elongation_coupling" not in model.effects:
        points = [list(point) for point in profile_of(model).points]
        model = model.with_effects({**model.effects, "elongation_coupling": {"curvature_profile": points}})
    transmission = Stack.of(model.effects, model.source).transmission(model)
    ends = [transmission.limits(sigma, model.friction_angle, model.pretension) for sigma in (-1.0, 1.0)]
    return min(abs(end) for pair in ends for end in pair)


def shape_known(model: TendonSheath) -> bool:
    """Return True if the model file states where the sheath bends."""
    return model.bending_centre is not None or "elongation_coupling" in model.effects


def bent_at_joint(model: TendonSheath) -> bool:
    """Return True if the model file places all bending at the joint, within `AT_JOINT`."""
    return shape_known(model) and 1.0 - compliance_centre(model) < AT_JOINT


def free_shares(model: TendonSheath) -> tuple[float, float]:
    """Return the bounds of 1 - s_c, the share of the friction that appears in the elongation.

    They are 0 and 1 for an unknown curvature profile, because all bending may be at the joint or at the motor.
    """
    if not shape_known(model):
        return 0.0, 1.0
    share, uncertain = 1.0 - compliance_centre(model), model.bending_centre_uncertainty
    return max(0.0, share - uncertain), min(1.0, share + uncertain)


def counts_of(settings: AxisSettings, geared: float) -> tuple[float, float]:
    """Return one count of the motor and the joint encoder (0 without one), rad at the motor; `geared` is r_J/r_M."""
    motor = 2.0 * math.pi / (settings.drive.counts_per_revolution * settings.drive.gear_ratio)
    encoder = settings.encoder
    return motor, 0.0 if encoder is None else 2.0 * math.pi * geared / encoder.counts_per_revolution


def polarity_check_of(settings: AxisSettings, model: TendonSheath, period: float) -> PolarityCheck:
    """Return the check of the motor torque's direction and size."""
    geared = model.joint_pulley_radius / model.motor_pulley_radius
    counts = math.hypot(*counts_of(settings, geared))  # their rounding errors are independent
    stiffness = least_stiffness(model) if settings.plausibility.slip is None else 0.0
    slope = max(1.0, *(sliding(model, sigma).slope / geared for sigma in (-1.0, 1.0)))
    return PolarityCheck(settings.limits.torque, geared, period, wound_by_friction(model), counts, stiffness, slope)


def joint_torque_of(settings: AxisSettings, model: TendonSheath, inertia: float, period: float) -> JointTorque:
    """Return the estimate of the joint torque without its sensor: from the model and, if possible, the elongation."""
    encoder = settings.encoder
    by_model = ModelTorque(model, period, inertia)
    if encoder is None:
        return JointTorque(by_model, None, "", period)
    try:
        counts = counts_of(settings, 1.0)
        stretch = StretchObserver(model, period, counts, inertia)
    except UsageError as error:
        return JointTorque(by_model, None, f"no joint torque from the tendons' stretch: {error}", period)
    return JointTorque(by_model, stretch, "", period, ElongationTorque(model, period, counts), shape_known(model))


def friction_proof_of(
    settings: AxisSettings, model: TendonSheath, joint_torque: JointTorque, inertia: float, period: float
) -> FrictionProof:
    """Return the proof of the friction torque by a sensor on the bus and by the elongation.

    A serial sensor counts only without an elongation, because its values are delayed, and a changing torque then looks
    like friction.
    """
    stretch = joint_torque.stretch
    by_sensor = by_elongation = None
    if settings.torque_sensor is not None or (settings.has_torque_sensor and stretch is None):
        by_sensor = ProvenFriction(model, period, inertia, True)
    if stretch is not None:
        by_elongation = ProvenFriction(model, period * (EVERY if by_sensor else 1), inertia, False, stretch)
    per_angle = (0.0, 0.0)
    if stretch is not None:
        per_stretch = stretch_line(model).per_stretch
        per_angle = (per_stretch * model.motor_pulley_radius, per_stretch * model.joint_pulley_radius)
    evidence = SensorEvidence(
        joint_torque.model.half_loop, period, model.joint_pulley_radius / model.motor_pulley_radius, per_angle
    )
    return FrictionProof(by_sensor, by_elongation, evidence)


def bound_for(
    settings: AxisSettings,
    model: TendonSheath,
    joint_torque: JointTorque,
    reason_for_fixed: str,
    more: Sequence[str] = (),
) -> Bound:
    """Return the bound on the friction that this axis may compensate, with notes, to which `more` is added.

    `reason_for_fixed` is the reason why the estimator does not use the tendon elongation; empty if it does.
    """
    estimator = settings.estimator
    follows = estimator.kind != "tension" or estimator.attribute is Attribution.BENDING
    bound = bound_of(
        model,
        bending_range=settings.bending.range,
        bending_known=estimator.kind == "map" or (estimator.kind != "fixed" and bool(estimator.use) and follows),
        sees=settings.has_torque_sensor or joint_torque.stretch is not None,
        compensation=settings.law.compensation,
    )
    notes = [*bound.notes, *unmeasured_notes(settings.bending, model), *more]
    if reason_for_fixed and not joint_torque.unsupported_reason:  # the latter has the same effect and is reported
        notes.append(reason_for_fixed)
    if settings.oscillation is not None:
        notes.append("[axis.oscillation] no longer has an effect: the guard of [axis.passivity] replaces it; remove it")
    return Bound(bound.seen, bound.unseen, tuple(notes))


def _motion_of(axis: ControlAxis, oldest: float) -> Reading:
    """Return the function that reads the joint of an axis for the sheaths of others; older than `oldest` s is nan."""
    return lambda: axis.present_motion() if axis.image.pdo_age <= oldest else (math.nan, math.nan)


def routing_notes(settings: AxisSettings, model: TendonSheath, file: ControllerFile) -> tuple[str, ...]:
    """Return notes on joints that bend the sheaths but have no encoder, and on slack tendons within the travel."""
    routing = routing_of(settings.bending, model.routing)
    if routing is None:
        return ()
    unmeasured = settings.bending.unmeasured
    notes = [
        f"joint '{other.name}', which bends this sheath, has no encoder: its angle is that of its motor. The friction "
        "is wrong unless the motor's position is 0 where the joint's angle is 0; an encoder at that joint measures it"
        for other in file.axes
        if other.name in routing.joints and other.encoder is None and other.name not in unmeasured
    ]
    travel = {**joint_ranges(file.axes), **unmeasured}
    least = 0.5 * sum(route.extremes(travel)[0] for route in (routing.a, routing.b))
    pretension = model.pretension + model.pretension_slope * least
    if pretension <= 0.0:
        notes.append(
            f"at the least wrap angle that [routing] gives over the joints' travel, {model.bending_angle + least:.3g} "
            f"rad, the pretension would be {pretension:.3g} N: the tendons go slack and transmit no torque; narrow the "
            "travel, or correct gains or pretension"
        )
    return tuple(notes)


def _measured_bending(axis: ControlAxis) -> Callable[[], float]:
    return lambda: axis.instruments.theta


def estimator_of(settings: AxisSettings, model: TendonSheath, joint_torque: JointTorque, period: float) -> Estimator:
    """Return the estimator that the configuration selects."""
    chosen = settings.estimator
    if chosen.kind == "fixed":
        return Fixed(model)
    if chosen.kind == "map":
        routed = routing_of(settings.bending, model.routing) is not None
        return ConfigurationMap(model, chosen, period, math.inf if routed else None)
    if chosen.kind == "tension":
        return TensionEstimator(model, chosen, period)
    if chosen.kind == "stretch":
        assert joint_torque.stretch is not None  # the configuration was checked
        return StretchEstimator(model, chosen, joint_torque.stretch, period, lambda: joint_torque.contradicted)
    return KalmanEstimator(model, chosen, period)


def tuners_of(axes: Sequence[ControlAxis], period: float) -> tuple[Tuner, ...]:
    """Return the tuner of the live parameters of each axis."""
    return tuple(Tuner(parameters_of(axis), period) for axis in axes)


def ranges_of(tuner: Tuner) -> list[Range]:
    """Return the live parameters of an axis for its clients."""
    return [Range(p.name, p.unit, p.low, p.high, p.doc, p.restores, p.switch) for p in tuner.parameters]


def describe(configuration: Configuration, tuners: Sequence[Tuner]) -> Description:
    """Return the description of the run for the socket server."""
    file, load = configuration.file, configuration.load
    return Description(
        path=file.socket.path or default_path(),
        group=file.socket.group,
        name=file.controller.name,
        period=configuration.period,
        axes=[axis.name for axis in file.axes],
        parameters=[ranges_of(tuner) for tuner in tuners],
        codes=CODES,
        phases=[phase.name.lower() for phase in LoopPhase],
        set_point_limit=[
            set_point_limit(axis, model) if axis.setpoint.kind == "socket" else None
            for axis, model in zip(file.axes, configuration.models, strict=True)
        ],
        set_point_timeout=[axis.setpoint.timeout for axis in file.axes],
        watch_group=file.socket.watch_group,
        estimators=[
            f"{axis.estimator.kind}{', in use' if axis.estimator.use else ''}{f' ({note})' if note else ''}"
            for axis, note in zip(file.axes, configuration.estimators, strict=True)
        ],
        figures={"bus": file.channels, "bitrate": load.bitrate, "load": load.worst, "rate": file.controller.rate},
        remedies=REMEDIES,
        loose_bounds=loose_lines(configuration),
    )


def log_header(configuration: Configuration) -> LogHeader:
    """Return the header of the log: all files of the configuration, and the names of the codes."""
    files = {**referenced(configuration.path), configuration.path.name: configuration.text}
    for axis in configuration.file.axes:
        profile = Path("drives", f"{axis.drive.profile}.toml")  # "generic" is used without a name in the file
        if (configuration.folder / profile).is_file():
            files[str(profile)] = (configuration.folder / profile).read_text(encoding="utf-8")
    return LogHeader(
        axes=tuple(axis.name for axis in configuration.file.axes),
        rate=configuration.file.controller.rate,
        files=files,
        codes={signal: dict(enumerate(names)) for signal, names in CODES.items()},
    )
