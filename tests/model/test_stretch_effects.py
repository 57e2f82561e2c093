"""Effects of the tendon elongation. The reference of tests/blind integrates the strain along the tendons."""

from __future__ import annotations

import tomllib
from typing import Any

import numpy as np
import pytest

from tests.blind import stretch_effects
from tests.blind.cases import generator
from tests.blind.plant import Scene, Tensions, simulate
from tests.blind.rig import Rig, draw_rig, model_file
from tests.blind.two_encoders import stretch as by_the_strain
from tests.model.actuator import ACTUATOR
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.parameters import TendonSheath, model_from
from tsa_ctrl.model.predict import predict, stretch
from tsa_ctrl.model.signals import Signals
from tsa_ctrl.model.stretch import stretch_line

PROFILES = {"even": "uniform", "motor": "motor_end"}
EFFECTS: dict[str, dict[str, Any]] = {
    "series_spring": {"stiffness": 9e3},
    "series_spring at the joint": {"stiffness": 1.3e4, "end": "joint"},
    "tendon_creep": {"length": -3e-4, "time_constant": 2.5},
    "pulley_slip": {"length": 2e-4, "time": 103.7},
    "joint_play": {"gap": 0.03},
}


def scene(rig: Rig) -> Scene:
    """Return ten seconds of sliding in both directions under both signs of torque. The clock does not begin at 0."""
    t = 100.0 + np.arange(2000) * 5e-3
    q = 0.5 * np.sin(2.0 * np.pi * 0.4 * t)
    tau_m = 0.7 * rig.torque_limit * np.sin(2.0 * np.pi * 0.27 * t + 0.3)
    omega = np.gradient(q, t)
    still = np.zeros_like(t)
    return Scene(t, q, omega, np.gradient(omega, t), 1.3 * q, tau_m, still + rig.bending, still + 25.0)


def both(shape: str) -> tuple[Rig, Scene, Tensions, TendonSheath, Signals]:
    """Return a rig with its scene and its tensions by tests/blind, and its model and log for the package."""
    rig = draw_rig(generator("stretch effects", shape, 0))
    moment = scene(rig)
    effects = {"elongation_coupling": {"curvature_profile": PROFILES[shape]}}
    model = model_from(tomllib.loads(model_file(rig)), "rig.toml")
    assert isinstance(model, TendonSheath)
    log = Signals(t=moment.t, tau_m=moment.tau_m, omega_j=moment.omega)
    return rig, moment, simulate(rig, moment, effects), model.with_effects(effects), log


@pytest.mark.parametrize("shape", list(PROFILES))
@pytest.mark.parametrize("label", list(EFFECTS))
def test_stretch_equals_the_reference(label: str, shape: str) -> None:
    """The effect agrees within 1e-9 m. The elongation itself agrees within 1e-5 of its largest value."""
    name, parameters = label.partition(" ")[0], EFFECTS[label]
    rig, moment, tensions, model, log = both(shape)
    with_effect = model.with_effects({**model.effects, name: parameters})
    own = stretch(model, log)
    expected = stretch_effects.added(name, parameters, tensions, moment.t, rig.joint_radius)
    np.testing.assert_allclose(stretch(with_effect, log) - own, expected, rtol=0.0, atol=1e-9)
    reference = by_the_strain(rig, tensions, shape)
    np.testing.assert_allclose(own, reference, rtol=0.0, atol=1e-5 * float(np.max(np.abs(reference))))


def test_all_of_them_add_up() -> None:
    rig, moment, tensions, model, log = both("even")
    chosen = {name: EFFECTS[name] for name in stretch_effects.NAMES}
    added = stretch(model.with_effects({**model.effects, **chosen}), log) - stretch(model, log)
    each = [stretch_effects.added(name, p, tensions, moment.t, rig.joint_radius) for name, p in chosen.items()]
    np.testing.assert_allclose(added, np.sum(each, axis=0), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("name", stretch_effects.NAMES)
def test_no_torque_shows_them(name: str) -> None:
    """A log without angles can be predicted as well."""
    log = Signals(t=np.arange(3.0), tau_m=np.array([0.5, -0.4, 0.2]), omega_j=np.array([1.0, -1.0, 1.0]))
    model = ACTUATOR.with_effects({name: EFFECTS[name]})
    np.testing.assert_array_equal(predict(model, log), predict(ACTUATOR, log))


@pytest.mark.parametrize("name", [*stretch_effects.NAMES, "pulley_eccentricity"])
def test_the_stretch_tells_no_torque_beside_them(name: str) -> None:
    """The torque from an elongation that contains other terms would be wrong. The error states the remedy."""
    parameters = EFFECTS.get(name, {"relative_eccentricity": 0.1})
    with pytest.raises(UsageError, match=f"effects.{name}.*(series_stiffness|remove it|winds other lengths)"):
        stretch_line(ACTUATOR.with_effects({name: parameters}))


def test_a_pulley_off_its_centre_winds_up_what_its_arm_says() -> None:
    """The additional length is the integral of the lever arm over the angle. Its torque is (3.55) times this arm."""
    off = {"pulley_eccentricity": {"relative_eccentricity": 0.25, "phase": -0.6}}
    q = np.linspace(-1.2, 0.9, 4001)
    log = Signals(t=5e-3 * np.arange(q.size), tau_m=np.full(q.size, 0.3), omega_j=np.full(q.size, 0.1), q_j=q)
    arm = predict(ACTUATOR.with_effects(off), log) / predict(ACTUATOR, log)
    np.testing.assert_allclose(arm, 1.0 + 0.25 * np.sin(q - 0.6), atol=1e-12)
    even = {"elongation_coupling": {"curvature_profile": "uniform"}}
    beside = stretch(ACTUATOR.with_effects({**even, **off}), log) - stretch(ACTUATOR.with_effects(even), log)
    wound = ACTUATOR.joint_pulley_radius * np.concatenate(([0.0], np.cumsum(0.5 * np.diff(q) * (arm[1:] + arm[:-1]))))
    np.testing.assert_allclose(beside - beside[0], wound - ACTUATOR.joint_pulley_radius * (q - q[0]), atol=1e-9)
