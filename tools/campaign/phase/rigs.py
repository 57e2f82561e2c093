"""Return the daemon's configuration and the plant's settings of a random rig, based on the example files."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import TypeVar

import msgspec

from tools.campaign.phase.plan import Draw
from tools.command import CONFIG
from tsa_ctrl.config import AxisSettings as ControlSettings
from tsa_ctrl.config import Configuration, load_configuration, with_estimators
from tsa_ctrl.control.settings import SetPointSettings
from tsa_ctrl.plant.axis import CURVATURES
from tsa_ctrl.plant.settings import AxisSettings, PlantSettings, load_plant

LIMIT = 2.0  # N*m at the motor, [axis.limits] torque as shipped
FADE_IN = 0.1  # s
STOP_TIME = 0.1  # s
SETTLE = 20  # cycles
RATE_OF_TWO = 500.0  # Hz; two axes at 1000 Hz exceed a bus of 1 Mbit/s
WANTED = {
    "constant": SetPointSettings(kind="constant", offset=0.5),
    "negative": SetPointSettings(kind="constant", offset=-0.5),
    "sine": SetPointSettings(kind="sine", amplitude=0.5, frequency=2.0),
    "step": SetPointSettings(kind="step", offset=0.2, amplitude=0.4, at=0.3),
}  # N*m at the joint, within the domain of the tendons
_replace = msgspec.structs.replace
Axis = TypeVar("Axis", ControlSettings, AxisSettings)


@cache
def _shipped() -> tuple[Configuration, PlantSettings]:
    return load_configuration(CONFIG / "controller.toml"), load_plant(CONFIG / "plant.toml")


def controller_of(draw: Draw, compensation: float | None = None) -> Configuration:
    """Return the daemon's configuration of a rig. `compensation` replaces the shipped value."""
    base, _ = _shipped()
    file = base.file
    (axis,) = file.axes
    rate = file.controller.rate if draw.axes == 1 else RATE_OF_TWO
    law = _replace(axis.law, fade_in=FADE_IN, motor_inertia=draw.inertia, delay=(draw.delay + 1.5) / rate + 5e-4)
    if compensation is not None:
        law = _replace(law, compensation=compensation)
    sensor = axis.torque_sensor if draw.sensor else None
    estimator = type(axis.estimator)()  # the default kind, which `with_estimators` chooses by the shape
    encoder = axis.encoder if draw.encoder else None
    wanted = WANTED[draw.wanted]
    axis = _replace(axis, setpoint=wanted, law=law, encoder=encoder, torque_sensor=sensor, estimator=estimator)
    axes = [axis] if draw.axes == 1 else [_placed(axis, place) for place in range(draw.axes)]
    controller = _replace(file.controller, rate=rate, settle_cycles=SETTLE, stop_time=STOP_TIME)
    file = _replace(file, axes=tuple(axes), controller=controller, log=_replace(file.log, enabled=False))
    (model,) = base.models
    profile = [list(point) for point in CURVATURES[draw.shape]] if draw.shape == "s_bent" else draw.shape
    shaped = model.with_effects({"elongation_coupling": {"curvature_profile": profile}})
    models = (shaped,) * draw.axes
    file, estimators = with_estimators(file, models)
    return dataclasses.replace(
        base, file=file, models=models, profiles=base.profiles * draw.axes, estimators=estimators
    )


def plant_of(draw: Draw) -> PlantSettings:
    """Return the plant's settings, with distributed tendons. Its motion and time start at the first enable."""
    _, base = _shipped()
    (axis,) = base.axis
    factors = _replace(
        axis.perturbation, friction_coefficient=draw.friction, pretension=draw.pretension, axial_stiffness=1.0
    )
    axis = _replace(
        axis,
        perturbation=factors,
        tendon=_replace(axis.tendon, kind="distributed", curvature=draw.shape),
        drive=_replace(axis.drive, delay_periods=draw.delay),
        motor=_replace(axis.motor, inertia=draw.inertia),
        joint=_replace(axis.joint, load=draw.load),
        motion=_replace(axis.motion, ramp=0.1),
        encoder=_replace(axis.encoder, present=draw.encoder),
        torque_sensor=_replace(axis.torque_sensor, present=draw.sensor),
    )
    physics = _replace(base.physics, start="first_enable", seed=draw.seed % 1_000_000)
    return _replace(base, physics=physics, axis=[_placed(axis, place) for place in range(draw.axes)])


def _placed(axis: Axis, place: int) -> Axis:
    """Return an axis of the controller or the plant with the nodes of its place on the bus."""
    drive = _replace(axis.drive, node_id=1 + place, serial_number=1 + place)
    encoder = axis.encoder and _replace(axis.encoder, node_id=32 + place)
    sensor = axis.torque_sensor and _replace(axis.torque_sensor, node_id=64 + place)
    return _replace(axis, name=f"axis {place}", drive=drive, encoder=encoder, torque_sensor=sensor)
