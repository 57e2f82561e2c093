"""Test that the hidden plant agrees with its tensions and with the reference values of the catalogue."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from .motion import grid, plain_motion, rich_motion
from .plant import Scene, joint_torque, simulate
from .rig import Rig, draw_rig

VECTORS = json.loads((Path(__file__).parent / "vectors.json").read_text())


def rig_of(actuator: dict[str, float]) -> Rig:
    return Rig(
        motor_radius=actuator["motor_pulley_radius"],
        joint_radius=actuator["joint_pulley_radius"],
        axial_stiffness=actuator["axial_stiffness"],
        length=actuator["unstrained_length"],
        diameter=actuator["diameter"],
        contact_offset=actuator["contact_offset"],
        mu=actuator["friction_coefficient"],
        bending=actuator["bending_angle"],
        pretension=actuator["pretension"],
    )


RIG = rig_of(VECTORS["actuator"])


def scene(rng: np.random.Generator, rig: Rig, level: float = 0.8) -> Scene:
    """Return ten seconds of a sine motion with an unrelated slower torque."""
    t = grid(10.0, 4000.0)
    motion = plain_motion(rng, t, "sine", 0.8, 2.0)
    tau_m = level * rig.torque_limit * np.sin(2.0 * np.pi * 0.23 * t + 0.4)
    ratio = rig.joint_radius / rig.motor_radius
    return Scene(
        t=t,
        q=motion.q,
        omega=motion.omega,
        acceleration=motion.acceleration,
        q_m=ratio * motion.q,
        tau_m=tau_m,
        theta=np.full_like(t, rig.bending),
        temperature=np.full_like(t, 25.0),
    )


@pytest.mark.parametrize("reference", VECTORS["cases"], ids=lambda c: "+".join(c["effects"]) or "plain")
def test_agrees_with_the_reference_values(reference: dict[str, Any]) -> None:
    """Each reference case of effects without memory agrees with its expected torque, alone and in combination."""
    for state, expected in zip(VECTORS["states"], reference["expected"], strict=True):
        one = {key: np.array([value]) for key, value in state.items()}
        effects = dict(reference["effects"])
        sigma = None
        if "velocity_lag" in effects:  # the state contains the recorded velocity, and the scene the true one
            lag = effects.pop("velocity_lag")["time_constant"]
            sigma = np.sign(one["omega_j"] + lag * one["acceleration_j"])
        moment = Scene(
            t=one["t"],
            q=one["q_j"],
            omega=one["omega_j"],
            acceleration=one["acceleration_j"],
            q_m=one["q_m"],
            tau_m=one["tau_m"],
            theta=np.array([RIG.bending]),
            temperature=one["temperature"],
            sigma=sigma,
        )
        assert joint_torque(RIG, moment, effects)[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_motor_side_tensions_carry_the_motor_torque(seed: int) -> None:
    """r_M (T3 - T1) is the motor torque, (T1 + T3) / 2 the pretension, and r_J (T4 - T2) the joint torque."""
    rng = np.random.default_rng(seed)
    rig = draw_rig(rng)
    moved = scene(rng, rig)
    tensions = simulate(rig, moved, {})
    np.testing.assert_allclose(rig.motor_radius * (tensions.t3 - tensions.t1), moved.tau_m, atol=1e-12)
    np.testing.assert_allclose(0.5 * (tensions.t1 + tensions.t3), rig.pretension)
    np.testing.assert_allclose(rig.joint_radius * (tensions.t4 - tensions.t2), tensions.joint_torque, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_plain_rig_follows_the_closed_form(seed: int) -> None:
    """Without effects, the torque is tau_J = r_J (tau_M / r_M cosh x - 2 T_p sigma sinh x)."""
    rng = np.random.default_rng(seed)
    rig = draw_rig(rng)
    moved = scene(rng, rig)
    sigma = moved.direction()
    forward = moved.tau_m / rig.motor_radius * np.cosh(rig.x)
    expected = rig.joint_radius * (forward - 2.0 * rig.pretension * sigma * np.sinh(rig.x))
    np.testing.assert_allclose(joint_torque(rig, moved, {}), expected, atol=1e-11)


LOSSES: dict[str, dict[str, Any]] = {
    "plain": {},
    "stribeck_friction": {"static_excess": 0.6, "stribeck_velocity": 0.3},
    "tension_dependent_friction": {"exponent": 0.3},
    "load_dependent_friction": {"coefficient": 0.2},
    "sheath_asymmetry": {"relative_difference": 0.5},
    "motor_side_friction": {"coulomb": 0.05},
    "viscous_friction": {"coefficient": 0.05},
    "pretension_relaxation": {"relaxed_fraction": 0.1, "time_constant": 4.0},
}


@pytest.mark.parametrize("name", LOSSES)
@pytest.mark.parametrize("seed", range(4))
def test_friction_never_creates_power(name: str, seed: int) -> None:
    """In every sample, the motor supplies at least the power that the joint delivers."""
    rng = np.random.default_rng(seed)
    rig = draw_rig(rng)
    moved = scene(rng, rig)
    effects = {} if name == "plain" else {name: LOSSES[name]}
    ratio = rig.joint_radius / rig.motor_radius
    lost = ratio * moved.tau_m * moved.omega - joint_torque(rig, moved, effects) * moved.omega
    assert lost.min() > -1e-9


@pytest.mark.parametrize("profile", ["uniform", "motor_end"])
@pytest.mark.parametrize("spring", [None, 2e4])
def test_elongations_share_the_path_length_change(profile: str, spring: float | None) -> None:
    """The sum of both elongations, including the springs, equals the path of the tensioner."""
    rng = np.random.default_rng(3)
    rig = Rig(0.02, 0.025, 6e4, 1.2, 0.6e-3, 0.4e-3, 0.2, 2.6, 45.0, spring)
    moved = scene(rng, rig)
    tensions = simulate(rig, moved, {"elongation_coupling": {"curvature_profile": profile}})
    strips = (np.arange(2000) + 0.5) / 2000.0
    bent = strips if profile == "uniform" else np.ones_like(strips)
    for k in range(0, moved.t.size, 7919):
        growth = np.exp(moved.direction()[k] * rig.x * bent)
        stretch = (tensions.t1[k] * growth.mean() + tensions.t3[k] * (1.0 / growth).mean()) / rig.axial_stiffness
        total = stretch * rig.length + ((tensions.t1[k] + tensions.t3[k]) / spring if spring else 0.0)
        given = 2.0 * rig.pretension / rig.tendon_stiffness
        assert total == pytest.approx(given, rel=1e-6)


def test_a_slack_tendon_leaves_all_to_the_other() -> None:
    rng = np.random.default_rng(0)
    moved = scene(rng, RIG, level=1.8)
    tensions = simulate(RIG, moved, {"tendon_slack": {}})
    assert min(tensions.t1.min(), tensions.t3.min()) == 0.0
    np.testing.assert_allclose(RIG.motor_radius * (tensions.t3 - tensions.t1), moved.tau_m, atol=1e-12)
    slack = np.abs(moved.tau_m) > RIG.torque_limit
    assert 0.1 < slack.mean() < 0.9
    np.testing.assert_array_equal(slack, (tensions.t1 == 0.0) | (tensions.t3 == 0.0))


def test_delay_shifts_the_torque() -> None:
    """The joint torque at t is the undelayed torque at t minus the delay."""
    rng = np.random.default_rng(1)
    moved = scene(rng, RIG)
    late = joint_torque(RIG, moved, {"transport_delay": {"delay": 0.02}})
    np.testing.assert_allclose(late[80:], joint_torque(RIG, moved, {})[:-80], atol=1e-9)


@pytest.mark.parametrize(
    ("law", "after_one", "after_nine"),
    [("exponential", 1.0 - 0.3 * (1.0 - np.exp(-1.0)), 1.0 - 0.3 * (1.0 - np.exp(-9.0))), ("logarithmic", None, 0.7)],
)
def test_relaxation_follows_its_law(law: str, after_one: float | None, after_nine: float) -> None:
    """The pretension after one and nine time constants agrees with the relaxation law. Note that log10(1 + 9) = 1."""
    rng = np.random.default_rng(2)
    moved = scene(rng, RIG, level=0.2)
    effect = {"relaxed_fraction": 0.3, "time_constant": 1.0, "law": law}
    tensions = simulate(RIG, moved, {"pretension_relaxation": effect})
    share = 0.5 * (tensions.t1 + tensions.t3) / RIG.pretension
    assert share[4000 * 9] == pytest.approx(after_nine, rel=1e-9)
    assert share[4000] == pytest.approx(after_one if after_one is not None else 1.0 - 0.3 * np.log10(2.0), rel=1e-9)


def test_motion_derivatives_belong_together() -> None:
    """The integral of the velocity is the angle, and the integral of the acceleration is the velocity."""
    motion = rich_motion(np.random.default_rng(5), grid(20.0, 4000.0))
    step = motion.t[1] - motion.t[0]
    back = motion.q[0] + np.concatenate([[0.0], np.cumsum(0.5 * (motion.omega[1:] + motion.omega[:-1])) * step])
    np.testing.assert_allclose(back, motion.q, atol=1e-5)
    speed = motion.omega[0] + np.cumsum(motion.acceleration) * step
    np.testing.assert_allclose(speed, motion.omega, atol=0.02 * motion.speed)
