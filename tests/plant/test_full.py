"""Test the mechanics with the full model: closed forms, standstill, slack and loads."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.model.capstan import Pair
from tests.plant.bench import ACTUATOR, R_J, R_M, T_P0, X, actuator_file, axis
from tsa_ctrl.plant.axis import Axis

RAMP = {"kind": "sine", "amplitude": 1.0, "frequency": 0.2, "ramp": 0.0}  # 1.26 rad/s at the start
CLOSED_FORMS = {
    "uniform": lambda tau, x: R_J * (tau / R_M - 2 * T_P0 * x),
    "motor_end": lambda tau, x: R_J * (tau / (R_M * math.cosh(x)) - 2 * T_P0 * math.tanh(x)),
    "joint_end": lambda tau, x: R_J * (tau / R_M * math.cosh(x) - 2 * T_P0 * math.sinh(x)),
}


def run(axis: Axis, torque: float, seconds: float) -> dict[str, float]:
    """Hold a motor torque for some time, and return the final state."""
    axis.command.enabled, axis.command.torque = True, torque
    start = axis.time
    for i in range(round(seconds / 1e-3)):
        axis.advance(start + (i + 1) * 1e-3)
    values = axis.values()
    assert values["unsolved"] == 0
    return values


@pytest.mark.parametrize("curvature", list(CLOSED_FORMS))
@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("torque", [1.0, -0.6, 0.0])
def test_sliding_delivers_what_the_closed_form_says(
    tmp_path: Path, curvature: str, direction: int, torque: float
) -> None:
    motion = {**RAMP, "amplitude": float(direction)}
    joint = axis(tmp_path, tendon={"curvature": curvature}, motion=motion)
    delivered = run(joint, torque, 0.1)["tau_j"]
    assert delivered == pytest.approx(CLOSED_FORMS[curvature](torque, direction * X), abs=1e-8)


def test_any_profile_lies_where_its_quadrature_says(tmp_path: Path) -> None:
    points = [(0.0, 0.0), (0.3, 0.1), (0.3, 0.5), (0.8, 0.5), (1.0, 1.0)]
    joint = axis(tmp_path, tendon={"curvature": points}, motion=RAMP)
    delivered = run(joint, 0.7, 0.1)["tau_j"]
    s = (np.arange(200_000) + 0.5) / 200_000
    theta = np.where(s < 0.3, s / 3.0, np.where(s < 0.8, 0.5, 0.5 + (s - 0.8) * 2.5))
    alpha, beta = np.exp(X * theta).mean(), np.exp(-X * theta).mean()
    expected = (
        R_J / (alpha + beta) * (0.7 / R_M * (alpha * math.exp(-X) + beta * math.exp(X)) - 4 * math.sinh(X) * T_P0)
    )
    assert delivered == pytest.approx(expected, abs=1e-6)


def test_a_series_element_takes_part_in_the_elongation(tmp_path: Path) -> None:
    joint = axis(tmp_path, tendon={"curvature": "motor_end"}, motion=RAMP)
    for name, value in {"series_length": 3.0}.items():
        joint.parameters[name] = value
    delivered = run(joint, 0.7, 0.1)["tau_j"]
    alpha, beta = 1.2 * math.exp(X) + 3.0, 1.2 * math.exp(-X) + 3.0
    expected = (
        R_J / (alpha + beta) * (0.7 / R_M * (alpha * math.exp(-X) + beta * math.exp(X)) - 4 * math.sinh(X) * T_P0 * 4.2)
    )
    assert delivered == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("position", ["motor", "joint"])
@pytest.mark.parametrize("kind", ["full", "distributed"])
@pytest.mark.parametrize("direction", [1, -1])
def test_a_series_spring_stands_at_either_end(tmp_path: Path, kind: str, position: str, direction: int) -> None:
    """The reference is the capstan equation integrated along the tendons with 40 contacts."""
    curve = [(0.0, 0.0), (0.3, 0.4), (0.7, 0.4), (1.0, 1.0)]
    spring = f"[tendon]\nseries_stiffness = 2e4\nseries_position = '{position}'"
    joint = axis(
        tmp_path,
        actuator=actuator_file(tmp_path, ACTUATOR.replace("[tendon]", spring)),
        tendon={"kind": kind, "curvature": curve},
        motion={**RAMP, "amplitude": float(direction)},
    )
    springs = {f"{position}_spring": 1.0 / 2e4}
    expected = Pair(tuple(curve), X, **springs).joint_torque(0.7, direction)
    assert run(joint, 0.7, 0.1)["tau_j"] == pytest.approx(expected, abs=1e-8 if kind == "full" else 2e-4)


def test_beyond_slack_one_tendon_carries_all(tmp_path: Path) -> None:
    joint = axis(tmp_path, motion=RAMP)
    values = run(joint, 2.4, 0.1)
    assert values["t1"] == values["t2"] == 0.0
    assert values["t3"] == pytest.approx(2.4 / R_M)
    assert values["tau_j"] == pytest.approx(R_J * 2.4 / R_M * math.exp(-X))


def test_tensions_never_push(tmp_path: Path) -> None:
    joint = axis(tmp_path, motion={**RAMP, "frequency": 1.0})
    for torque in (2.5, -2.5, 0.0, 2.5):
        values = run(joint, torque, 0.02)
        assert min(values[name] for name in ("t1", "t2", "t3", "t4")) >= 0.0


@pytest.mark.parametrize("kind", ["full", "distributed"])
def test_at_standstill_friction_holds_a_load_inside_the_band(tmp_path: Path, kind: str) -> None:
    load = {"load": "weight", "weight_torque": 0.3, "weight_phase": math.pi / 2, "inertia": 0.02, "damping": 1.0}
    joint = axis(tmp_path, tendon={"kind": kind}, joint=load, motor={"inertia": 1e-3, "damping": 0.02})
    joint.command.enabled = True
    held = run(joint, 0.24, 1.0)  # the motor torque for the weight without friction
    moved = run(joint, 0.24 + 0.1, 1.0)
    assert abs(held["omega_j"]) < 1e-5
    assert held["tau_j"] == pytest.approx(0.3 * math.cos(held["q_j"]), abs=1e-4)
    assert abs(moved["q_j"] - held["q_j"]) < 0.02  # 0.125 N*m at the joint is within the friction band of +-0.585 N*m


@pytest.mark.parametrize("kind", ["full", "distributed"])
def test_no_chatter_at_standstill(tmp_path: Path, kind: str) -> None:
    load = {"load": "spring", "stiffness": 4.0, "inertia": 0.02, "damping": 1.0}
    joint = axis(tmp_path, tendon={"kind": kind}, joint=load, motor={"inertia": 1e-3, "damping": 0.02})
    run(joint, 0.9, 2.0)
    speeds = [run(joint, 0.9, 0.001)["omega_j"] for _ in range(200)]
    assert max(speeds) * min(speeds) >= 0.0  # it creeps to rest without a reversal
    assert abs(speeds[-1]) <= abs(speeds[0]) < 1e-3


def test_a_torque_beyond_the_band_moves_the_joint(tmp_path: Path) -> None:
    joint = axis(tmp_path, joint={"load": "free", "damping": 0.2}, motor={"inertia": 1e-3, "damping": 1e-4})
    values = run(joint, 1.0, 2.0)
    drive = R_J * (1.0 - 1e-4 * values["omega_m"]) / R_M - 2 * T_P0 * R_J * X
    assert values["omega_j"] == pytest.approx(drive / 0.2, rel=1e-3)


def test_the_weight_pulls_as_a_pendulum(tmp_path: Path) -> None:
    load = {"load": "weight", "weight_torque": 5.0, "weight_phase": 0.0, "initial_angle": 1.0, "damping": 0.3}
    joint = axis(tmp_path, joint=load)
    joint.parameters["friction"] = 0.0
    joint.command.enabled = False
    values = {}
    for i in range(4000):
        joint.advance((i + 1) * 1e-3)
        values = joint.values()
    assert values["q_j"] == pytest.approx(0.0, abs=1e-3)


def test_halving_the_step_changes_little(tmp_path: Path) -> None:
    def final(step: float) -> float:
        joint = axis(tmp_path, step, joint={"load": "spring"}, motor={"inertia": 1e-4, "damping": 0.02})
        return run(joint, 0.9, 0.3)["q_j"]

    coarse, middle, fine = (final(step) for step in (1e-4, 5e-5, 2.5e-5))
    assert abs(middle - fine) < 0.7 * abs(coarse - middle) + 1e-9


def test_a_torn_tendon_leaves_the_other(tmp_path: Path) -> None:
    joint = axis(tmp_path, motion=RAMP)
    joint.parameters["torn_b"] = 1
    values = run(joint, -0.5, 0.05)
    assert values["t3"] == values["t4"] == 0.0
    assert values["t1"] == pytest.approx(0.5 / R_M)


def test_bending_changes_friction_and_pretension(tmp_path: Path) -> None:
    environment: dict[str, Any] = {"bending": [(0.0, 1.0), (0.01, 1.4)]}
    joint = axis(tmp_path, tendon={"curvature": "joint_end"}, motion=RAMP, environment=environment)
    values = run(joint, 1.0, 0.1)
    pretension = T_P0 + 60e3 / 1.2 * (0.4e-3 + 0.3e-3) * 0.4 * 2.6
    x = 1.4 * X
    assert values["pretension"] == pytest.approx(pretension)
    assert values["tau_j"] == pytest.approx(R_J * (1.0 / R_M * math.cosh(x) - 2 * pretension * math.sinh(x)), abs=1e-8)
