"""One axis of the machine: parameters from the actuator file and the settings, the compiled mechanics, the sensors."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.model.parameters import TendonSheath, load_tendon_sheath
from tsa_ctrl.plant.chain import settle
from tsa_ctrl.plant.chain_layout import build_chain
from tsa_ctrl.plant.effects import MAX_ELEMENTS, Presliding, effect_values, wound
from tsa_ctrl.plant.formula import memory_of, steps_of
from tsa_ctrl.plant.load import hand_table, load_parameters
from tsa_ctrl.plant.mechanics import Arrays, advance
from tsa_ctrl.plant.motion import build_motion
from tsa_ctrl.plant.readings import MotorCommand, Readings
from tsa_ctrl.plant.record import COLUMNS
from tsa_ctrl.plant.settings import AxisSettings, MotionSettings, PhysicsSettings
from tsa_ctrl.plant.state import DELAY_SAMPLES, PARAMETERS, STATE

CURVATURES: Mapping[str, tuple[tuple[float, float], ...]] = {
    "uniform": ((0.0, 0.0), (1.0, 1.0)),
    "motor_end": ((0.0, 0.0), (0.0, 1.0), (1.0, 1.0)),
    "joint_end": ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0)),
    "s_bent": ((0.0, 0.0), (0.1, 0.0), (0.35, 0.5), (0.65, 0.5), (0.9, 1.0), (1.0, 1.0)),  # two bends, straight between
}
_MIN_PRESLIDING = 1e-6  # m
_LEAST_ADVANCE = 1e-9  # s: less is the rounding of sub-steps

_TIME, _TORQUE, _MOTOR_SPEED, _MOTOR_ANGLE, _JOINT_ANGLE, _JOINT_SPEED, _JOINT_TORQUE, _TEMPERATURE, _SPEED_LIMITED = (
    (STATE.names or ()).index(name)
    for name in (
        "t", "torque_loop", "omega_m", "q_m_seen", "q_lagged", "omega_lagged", "tau_sensed", "temperature",
        "speed_limited",
    )
)  # fmt: skip


_TRUTH = operator.itemgetter(*((STATE.names or ()).index(name) for name, _ in COLUMNS[7:]))


class Axis:
    """Mechanics of one axis in its own time, s since the plant's start."""

    def __init__(self, settings: AxisSettings, physics: PhysicsSettings) -> None:
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
        _set(self.parameters, backlash_threshold=2.0 * 2.0 * math.pi / settings.encoder.counts_per_revolution)
        _set(
            self.parameters,
            motion_grid=motion.grid,
            motion_repeat=int(motion.repeat),
            motion_ramp=motion.ramp,
        )
        self.friction = float(self.parameters["friction"][0])  # mu at the start
        self._start_at_once = physics.start == "power_on"
        curve = np.ascontiguousarray(np.array(_profile(settings), dtype=np.float64).T)
        _set(self.parameters, centre=_centre(curve, self.parameters[0]))
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
        )
        self.time = 0.0  # s since the plant's start
        self._started = self._start_at_once
        self._rest(motion.angle[0] if joint.load == "imposed" else joint.initial_angle)

    def _build_chains(self, curve: NDArray[np.float64]) -> NDArray[np.float64]:
        """Both tendons element by element; a single element that nobody asks where the full model is chosen."""
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
        """Everything at standstill, the tendons at their pretension, the motor where it balances them."""
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
            theta=float(p["theta"]),
            temperature=25.0,
            t1=float(p["pretension"]),
            t2=float(p["pretension"]),
            t3=float(p["pretension"]),
            t4=float(p["pretension"]),
        )
        self._read()

    def advance(self, until: float) -> None:
        """Bring mechanics and readings to time `until`, s since the plant's start; the past is left alone."""
        if until - self.time < _LEAST_ADVANCE:
            return
        command = self.command
        if command.enabled and not self._started:
            self._started = True
            self.state["started"] = self.state["t"]
        advance(self.state, self.parameters, self._arrays, command.torque, command.enabled, command.max_speed, until)
        self._read()

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
        """What the record has of this axis, in its order from `enabled` on."""
        return (float(self.command.enabled), self.command.torque, *_TRUTH(self._values))

    def values(self) -> dict[str, float]:
        """The whole state by name, as it is now."""
        return dict(zip(STATE.names or (), self.state[0].item(), strict=True))


def _set(record: NDArray[Any], **values: float) -> None:
    for name, value in values.items():
        record[name] = value


def _table(points: list[tuple[float, float]]) -> NDArray[np.float64]:
    return np.ascontiguousarray(np.array(points, dtype=np.float64).reshape(-1, 2).T)


def _profile(settings: AxisSettings) -> tuple[tuple[float, float], ...]:
    coupling = settings.effects.get("elongation_coupling")
    chosen = coupling["curvature_profile"] if coupling else settings.tendon.curvature
    return CURVATURES[chosen] if isinstance(chosen, str) else tuple(chosen)


def _centre(curve: NDArray[np.float64], p: Any) -> float:
    """Share of a tendon's compliance, series springs included, between the motor and the centre of the bending."""
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
    natural = pretension * mu * theta / (4.0 * tendon_stiffness)  # half a tendon stretches by the friction it holds
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
