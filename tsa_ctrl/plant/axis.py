"""Simulate one axis: derive its parameters from actuator file and settings, run the mechanics, update the readings."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TextIO

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.parameters import TendonSheath, load_tendon_sheath
from tsa_ctrl.model.routing import Routing
from tsa_ctrl.plant.chain import build_chain, settle
from tsa_ctrl.plant.effects import MAX_ELEMENTS, Presliding, effect_values, memory_of, steps_of, wound
from tsa_ctrl.plant.mechanics import Arrays, advance
from tsa_ctrl.plant.motion import build_motion
from tsa_ctrl.plant.sensors import MotorCommand, Readings
from tsa_ctrl.plant.settings import AxisSettings, HandRow, JointSettings, MotionSettings, PhysicsSettings
from tsa_ctrl.plant.state import (
    DELAY_SAMPLES,
    MOST_ANGLE,
    MOST_SPEED,
    MOST_TENSION,
    PARAMETERS,
    STATE,
    Load,
)

# Columns of the record of the plant's true state, with one CSV row per axis and period.
COLUMNS: tuple[tuple[str, str], ...] = (
    ("clock", "s, CLOCK_MONOTONIC"),
    ("t", "s since the plant's start"),
    ("axis", "place of the axis, 0 ..."),
    ("faults", "injected faults that are on"),
    ("state", "CiA 402 state, bits of the statusword"),
    ("enabled", "power stage on"),
    ("command", "N*m at the motor pulley, after the drive's clamp"),
    ("torque_loop", "N*m, measured by the current of the drive"),
    ("tau_m", "N*m that acts on the motor pulley"),
    ("q_m", "rad"),
    ("omega_m", "rad/s"),
    ("q_j", "rad"),
    ("omega_j", "rad/s"),
    ("t1", "N"),
    ("t2", "N"),
    ("t3", "N"),
    ("t4", "N"),
    ("tau_j", "N*m delivered to the load"),
    ("z", "state of the friction, -1 to 1"),
    ("theta", "rad"),
    ("pretension", "N, T_p0"),
    ("temperature", "deg C"),
    ("tau_outside", "N*m on the joint by a hand or a push"),
)
_FLUSH = 0.25  # s


class Record(Protocol):
    """Receive the true state of a machine, to store it on disk or in memory."""

    def due(self, t: float) -> bool: ...
    def row(self, values: Sequence[float]) -> None: ...
    def flush(self, clock: float) -> None: ...


class Rows:
    """Decide when a row is due: one every `period` s."""

    def __init__(self, period: float) -> None:
        self.period = period
        self._due = -1.0

    def due(self, t: float) -> bool:
        """Return True if a row is due at plant time t (s). Missed periods are skipped."""
        if t < self._due:
            return False
        self._due = max(self._due + self.period, t + 0.5 * self.period)
        return True


class Recorder(Rows):
    """Write rows to a CSV file and flush it every 0.25 s, so that a killed process loses only the newest rows."""

    def __init__(self, path: str | Path, period: float) -> None:
        super().__init__(period)
        self._flush_due = 0.0
        try:
            self._file: TextIO = Path(path).open("w", encoding="ascii", buffering=1 << 20)  # noqa: SIM115
        except OSError as error:
            raise UsageError(f"{path}: cannot be written ({error.strerror}); choose another place") from None
        self._file.write(",".join(name for name, _ in COLUMNS) + "\n")
        self._format = ",".join(["%.6f", "%.6f", "%d", "%d", "%d", "%d"] + ["%.9g"] * (len(COLUMNS) - 6)) + "\n"

    def row(self, values: Sequence[float]) -> None:
        self._file.write(self._format % tuple(values))

    def flush(self, clock: float) -> None:
        if clock >= self._flush_due:
            self._flush_due = clock + _FLUSH
            self._file.flush()

    def close(self) -> None:
        self._file.close()


@dataclass(frozen=True)
class Mass:
    """Hold the default inertia (kg*m^2), damping (N*m*s/rad) and weight torque (N*m) of a load."""

    inertia: float
    damping: float
    weight: float


PLAIN = Mass(0.02, 0.05, 1.0)
LIMB = Mass(0.05, 0.1, 4.0)  # pendulum load: a forearm or a shank without foot, with the damping of the tissue
_KINDS = {
    "imposed": Load.IMPOSED,
    "held": Load.IMPOSED,
    "free": Load.FREE,
    "spring": Load.SPRING,
    "weight": Load.WEIGHT,
    "limb": Load.WEIGHT,
    "wearer": Load.WEIGHT,
}
# Script of the hand in s, N*m/rad, N*m*s/rad, rad. It holds, lifts, holds, releases, grasps, pulls back and holds the
# limb.
WEARER: tuple[HandRow, ...] = (
    (0.0, 15.0, 1.0, 0.0),
    (1.5, 15.0, 1.0, 0.0),
    (3.0, 15.0, 1.0, 0.6),
    (4.0, 15.0, 1.0, 0.6),
    (4.05, 0.0, 0.0, 0.6),
    (7.0, 0.0, 0.0, 0.0),
    (7.5, 15.0, 1.0, 0.0),
    (9.0, 15.0, 1.0, -0.4),
    (10.5, 15.0, 1.0, 0.0),
    (12.0, 15.0, 1.0, 0.0),
)


def load_parameters(joint: JointSettings) -> dict[str, float]:
    """Return the load's parameters for the mechanics."""
    mass = LIMB if joint.load in ("limb", "wearer") else PLAIN
    return {
        "load": _KINDS[joint.load],
        "load_inertia": mass.inertia if joint.inertia is None else joint.inertia,
        "load_damping": mass.damping if joint.damping is None else joint.damping,
        "load_stiffness": joint.stiffness,
        "load_rest": joint.rest_angle,
        "weight": mass.weight if joint.weight_torque is None else joint.weight_torque,
        "weight_phase": joint.weight_phase,
        "hand_factor": 1.0,
        "hand_repeat": int(joint.hand_repeat),
    }


def hand_table(joint: JointSettings) -> NDArray[np.float64]:
    """Return the hand's script with the rows s, N*m/rad, N*m*s/rad and rad, shape (4, n); n = 0 without a hand."""
    rows = joint.hand or (WEARER if joint.load == "wearer" else ())
    return np.ascontiguousarray(np.array(rows, dtype=np.float64).reshape(-1, 4).T)


CURVATURES: Mapping[str, tuple[tuple[float, float], ...]] = {
    "uniform": ((0.0, 0.0), (1.0, 1.0)),
    "motor_end": ((0.0, 0.0), (0.0, 1.0), (1.0, 1.0)),
    "joint_end": ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0)),
    "s_bent": ((0.0, 0.0), (0.1, 0.0), (0.35, 0.5), (0.65, 0.5), (0.9, 1.0), (1.0, 1.0)),  # two bends, straight between
}
_MIN_PRESLIDING = 1e-6  # m
_LEAST_ADVANCE = 1e-9  # s; a smaller difference is the rounding error of the sub-steps

_TIME, _TORQUE, _MOTOR_SPEED, _MOTOR_ANGLE, _JOINT_ANGLE, _JOINT_SPEED, _JOINT_TORQUE, _TEMPERATURE, _SPEED_LIMITED = (
    (STATE.names or ()).index(name)
    for name in (
        "t", "torque_loop", "omega_m", "q_m_seen", "q_lagged", "omega_lagged", "tau_sensed", "temperature",
        "speed_limited",
    )
)  # fmt: skip


_Q, _OMEGA, _DELIVERED, _OUTSIDE = (
    (STATE.names or ()).index(name) for name in ("q_j", "omega_j", "tau_j", "tau_outside")
)
_TRUTH = operator.itemgetter(*((STATE.names or ()).index(name) for name, _ in COLUMNS[7:]))


class Axis:
    """Simulate the mechanics of one axis; its time is in s since the plant's start."""

    def __init__(self, settings: AxisSettings, physics: PhysicsSettings, *, on_limb: bool = False) -> None:
        """Set the axis at rest; with `on_limb`, a limb moves its joint through `carry`."""
        self.settings = settings
        self.name = settings.name
        self.readings = Readings()
        self.command = MotorCommand()
        model = load_tendon_sheath(settings.actuator)
        joint = settings.joint
        held = MotionSettings(kind="still", offset=joint.initial_angle)
        motion = build_motion(held if joint.load == "held" else settings.motion)
        self.parameters: NDArray[Any] = np.zeros(1, PARAMETERS)
        self.state: NDArray[Any] = np.zeros(1, STATE)
        _set(self.parameters, step=physics.step)
        _set(self.parameters, **_transmission(model, settings), **_motor(settings), **load_parameters(settings.joint))
        _set(self.parameters, **effect_values(settings.effects, model))
        # A command between two SYNCs shortens the sub-steps: at 4 kHz to 0.6 of the step.
        delay, longest = float(self.parameters["sensor_delay"][0]), 0.5 * DELAY_SAMPLES * physics.step
        if delay > longest:
            raise UsageError(
                f"axis '{self.name}': [axis.effects.transport_delay] delay {delay:g} s; allowed is 0 to {longest:g} s "
                f"with [physics] step {physics.step:g} s; lower delay, or raise step (at most 1e-4 s)"
            )
        _set(self.parameters, backlash_threshold=2.0 * 2.0 * math.pi / settings.encoder.counts_per_revolution)
        _set(
            self.parameters,
            motion_grid=motion.grid,
            motion_repeat=int(motion.repeat),
            motion_ramp=motion.ramp,
        )
        self.friction = float(self.parameters["friction"][0])  # initial mu
        self._start_at_once = physics.start == "power_on"
        curve = np.ascontiguousarray(np.array(_profile(settings), dtype=np.float64).T)
        _set(self.parameters, centre=_centre(curve, self.parameters[0]))
        if on_limb:
            _set(self.parameters, load=Load.LIMB)
        self.routing = Routing.sum_of(model.routing, settings.effects.get("routing_by_joint", {}))
        joints, gains, starts, points = _routes(self.routing, self.name)
        steps = steps_of(settings.effects)
        self._arrays = Arrays(
            ring=np.zeros((2, DELAY_SAMPLES)),
            slip=np.zeros(MAX_ELEMENTS),
            curve=curve,
            chains=self._build_chains(curve),
            motion=np.ascontiguousarray(np.vstack((motion.angle, motion.speed))),
            bending=_table(settings.environment.bending),
            temperature=_table(settings.environment.temperature),
            formula=steps,
            memory=memory_of(steps),
            hand=hand_table(settings.joint),
            joints=joints,
            gains=gains,
            starts=starts,
            points=points,
        )
        self.time = 0.0  # s since the plant's start
        prescribed = not on_limb and joint.load in ("imposed", "held")
        self.travel = (float(motion.angle.min()), float(motion.angle.max())) if prescribed else None  # rad
        self._started = self._start_at_once
        self._rest(motion.angle[0] if prescribed else joint.initial_angle)

    def _build_chains(self, curve: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the chains of both tendons; for the full model they are unused and have a single element."""
        p, tendon = self.parameters[0], self.settings.tendon
        distributed = tendon.kind == "distributed"
        bristle = tendon.bristle_stiffness
        if p["hysteresis"] != Presliding.ELASTIC:
            radius = p["r_m"] if p["hysteresis"] == Presliding.MOTOR else p["r_j"]
            bristle = float(p["pretension"] * p["friction"] * p["theta"] / (p["hysteresis_distance"] * radius))
        _set(self.parameters, distributed=int(distributed))
        chain = build_chain(
            curve,
            tendon.elements if distributed else 1,
            float(p["stiffness"]),
            float(p["length"]),
            float(p["series_length"]),
            bristle,
            bool(p["series_at_joint"]),
        )
        return np.ascontiguousarray(np.stack((chain, chain)))

    def _rest(self, angle: float) -> None:
        """Set the state to rest, with both tendons at the pretension and the motor at the matching angle."""
        p = self.parameters[0]
        on_pulley = float(wound(p, angle))
        for chain, side in zip(self._arrays.chains, (-1.0, 1.0), strict=True):
            end = side * on_pulley
            settle(chain, end, end, float(p["pretension"]))
        _set(
            self.state,
            q_j=angle,
            q_lagged=angle,
            q_m=on_pulley / float(p["r_m"]),
            q_m_seen=on_pulley / float(p["r_m"]),
            started=0.0 if self._start_at_once else -1.0,
            limb_angle=angle,
            theta=float(p["theta"]),
            temperature=25.0,
            t1=float(p["pretension"]),
            t2=float(p["pretension"]),
            t3=float(p["pretension"]),
            t4=float(p["pretension"]),
        )
        self._read()

    def advance(self, until: float) -> None:
        """Advance mechanics and readings to time `until` (s since the plant's start); ignore a time in the past."""
        if until - self.time < _LEAST_ADVANCE:
            return
        command = self.command
        if command.enabled and not self._started:
            self._started = True
            self.state["started"] = self.state["t"]
        advance(self.state, self.parameters, self._arrays, command.torque, command.enabled, command.max_speed, until)
        self._read()
        if self.state["beyond"][0]:
            raise UsageError(self._beyond())

    def _beyond(self) -> str:
        """Return the message for a state that has left its range."""
        values = self.values()
        ranges = (
            ("tendon tension", ("t1", "t2", "t3", "t4"), MOST_TENSION, "N"),
            ("speed", ("omega_m", "omega_j"), MOST_SPEED, "rad/s"),
            ("angle", ("q_m", "q_j"), MOST_ANGLE, "rad"),
        )
        found = [(quantity, abs(values[name]), most, unit) for quantity, names, most, unit in ranges for name in names]
        quantity, value, most, unit = max(found, key=lambda row: math.inf if math.isnan(row[1]) else row[1] / row[2])
        return (
            f"plant's axis '{self.name}': {quantity} {value:.3g} {unit} at {values['t']:.4g} s; allowed is at most "
            f"{most:g} {unit}: correct the load or the hand in [axis.joint], the motion in [axis.motion], or the fault "
            "that causes it"
        )

    def see(self, angles: Mapping[str, float], speeds: Mapping[str, float]) -> None:
        """Store the present angles (rad) and speeds (rad/s), by axis name, of the joints that bend the sheaths."""
        assert self.routing is not None
        self.state["exchanged"] = self.time
        joints = self._arrays.joints
        for place, name in enumerate(self.routing.joints):
            joints[0, place], joints[1, place] = angles[name], speeds[name]

    def carry(self, angle: float, speed: float, acceleration: float) -> None:
        """Store the joint's present angle and its derivatives from the limb. The speed is held until the next call."""
        record = self.state[0]
        record["exchanged"] = self.time
        record["limb_angle"], record["limb_speed"], record["limb_acceleration"] = angle, speed, acceleration

    @property
    def bending_angle(self) -> float:
        """Return the wrap angle Theta_0 of both sheaths with all joints at 0, rad."""
        return float(self.parameters[0]["theta"])

    @property
    def joint(self) -> tuple[float, float]:
        """Return angle (rad) and speed (rad/s) of the joint."""
        return self._values[_Q], self._values[_OMEGA]

    @property
    def load_torque(self) -> float:
        """Return the torque of the tendons, the hand and a push on the load, N*m."""
        return float(self._values[_DELIVERED] + self._values[_OUTSIDE])

    def _read(self) -> None:
        self._values = values = self.state[0].item()
        readings = self.readings
        self.time = values[_TIME]
        readings.motor_torque = values[_TORQUE]
        readings.motor_speed = values[_MOTOR_SPEED]
        readings.motor_angle = values[_MOTOR_ANGLE]
        readings.joint_angle = values[_JOINT_ANGLE]
        readings.joint_speed = values[_JOINT_SPEED]
        readings.joint_torque = values[_JOINT_TORQUE]
        readings.temperature = values[_TEMPERATURE]
        readings.speed_limited = bool(values[_SPEED_LIMITED])

    def truth(self) -> tuple[float, ...]:
        """Return the values of this axis for the record, in the order of `COLUMNS` from `enabled` on."""
        return (float(self.command.enabled), self.command.torque, *_TRUTH(self._values))

    def values(self) -> dict[str, float]:
        """Return the current state by name."""
        return dict(zip(STATE.names or (), self.state[0].item(), strict=True))


def _set(record: NDArray[Any], **values: float) -> None:
    for name, value in values.items():
        record[name] = value


def _table(points: list[tuple[float, float]]) -> NDArray[np.float64]:
    return np.ascontiguousarray(np.array(points, dtype=np.float64).reshape(-1, 2).T)


def _routes(
    routing: Routing | None, own: str
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Return the arrays `joints`, `gains`, `starts` and `points` of the mechanics."""
    names = () if routing is None else routing.joints
    tendons = () if routing is None else (routing.a, routing.b)
    joints, gains = np.zeros((3, len(names))), np.zeros((2, len(names)))
    joints[2] = [float(name == own) for name in names]
    starts = [0]
    points: list[tuple[float, float]] = []
    for tendon, route in enumerate(tendons):
        gains[tendon] = [route.gains.get(name, 0.0) for name in names]
        for name in names:
            points += route.tables.get(name, ())
            starts.append(len(points))
    return joints, gains, np.array(starts, dtype=np.int64), _table(points)


def _profile(settings: AxisSettings) -> tuple[tuple[float, float], ...]:
    coupling = settings.effects.get("elongation_coupling")
    chosen = coupling["curvature_profile"] if coupling else settings.tendon.curvature
    return CURVATURES[chosen] if isinstance(chosen, str) else tuple(chosen)


def _centre(curve: NDArray[np.float64], p: Any) -> float:
    """Return the share of a tendon's compliance, series spring included, between motor and centre of the bending."""
    place = 1.0 - float(np.trapezoid(curve[1], curve[0]))  # mean of the fraction of length over the bending
    before = 0.0 if p["series_at_joint"] else p["series_length"]
    return float((before + place * p["length"]) / (p["series_length"] + p["length"]))


def _transmission(model: TendonSheath, settings: AxisSettings) -> dict[str, float]:
    factor = settings.perturbation
    stiffness = model.axial_stiffness * factor.axial_stiffness
    series = 0.0 if model.series_stiffness is None else stiffness / model.series_stiffness
    pretension = model.pretension * factor.pretension
    mu, theta = model.friction_coefficient * factor.friction_coefficient, model.bending_angle * factor.bending_angle
    tendon_stiffness = stiffness / (model.unstrained_length + series)
    natural = pretension * mu * theta / (4.0 * tendon_stiffness)  # elongation of half a tendon by friction
    return {
        "r_m": model.motor_pulley_radius * factor.motor_pulley_radius,
        "r_j": model.joint_pulley_radius * factor.joint_pulley_radius,
        "stiffness": stiffness,
        "length": model.unstrained_length,
        "series_length": series,
        "series_at_joint": int(model.series_at_joint),
        "pretension": pretension,
        "pretension_factor": 1.0,
        "theta_factor": 1.0,
        "tendon_stiffness": tendon_stiffness,
        "bending_arm": model.contact_offset + model.diameter / 2.0,
        "friction": mu,
        "theta": theta,
        "presliding": settings.tendon.presliding or max(natural, _MIN_PRESLIDING),
    }


def _motor(settings: AxisSettings) -> dict[str, float]:
    drive, motor = settings.drive, settings.motor
    return {
        "motor_inertia": motor.inertia,
        "motor_damping": motor.damping,
        "torque_lag": drive.torque_time_constant,
        "peak_torque": drive.peak_torque * drive.gear_ratio,
    }
