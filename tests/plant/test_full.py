"""Test the mechanics with the full model: closed forms, standstill, slack and loads."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from tests.model.capstan import Pair
from tests.plant.bench import ACTUATOR, R_J, R_M, T_P0, X, actuator_file, axis
from tsa_ctrl.plant.axis import CURVATURES, Axis

RAMP = {"kind": "sine", "amplitude": 1.0, "frequency": 0.2, "ramp": 0.0}  # 1.26 rad/s at the start
CURVES: dict[str, list[tuple[float, float]]] = {  # share of the length, share of the wrap angle
    "uniform": [(0.0, 0.0), (1.0, 1.0)],
    "motor_end": [(0.0, 0.0), (0.0, 1.0), (1.0, 1.0)],
    "joint_end": [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)],
    "with a jump": [(0.0, 0.0), (0.3, 0.1), (0.3, 0.5), (0.8, 0.5), (1.0, 1.0)],
}
NEAREST = 6e-4 / 1.2  # of the length, from a pulley to a contact
APART = {  # point bends at this distance
    "motor_end": [(0.0, 0.0), (NEAREST, 0.0), (NEAREST, 1.0), (1.0, 1.0)],
    "joint_end": [(0.0, 0.0), (1.0 - NEAREST, 0.0), (1.0 - NEAREST, 1.0), (1.0, 1.0)],
}
SPRING = "[tendon]\nseries_stiffness = 2e4\nseries_position = '{}'"


def run(axis: Axis, torque: float, seconds: float) -> dict[str, float]:
    """Hold a motor torque for some time, and return the final state."""
    axis.command.enabled, axis.command.torque = True, torque
    start = axis.time
    for i in range(round(seconds / 1e-3)):
        axis.advance(start + (i + 1) * 1e-3)
    values = axis.values()
    assert values["unsolved"] == 0
    return values


@pytest.mark.parametrize("curvature", list(CURVES))
@pytest.mark.parametrize("spring", ["", "motor", "joint"])
@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("kind", ["full", "distributed"])
def test_sliding_delivers_what_the_capstan_equation_says(
    tmp_path: Path, kind: str, direction: int, spring: str, curvature: str
) -> None:
    """The reference is the capstan equation integrated along the tendons, with a spring in series at either end.

    The distributed tendons have 40 contacts, none of them nearer than 0.6 mm to a pulley.
    """
    curve = CURVES[curvature]
    joint = axis(
        tmp_path,
        actuator=actuator_file(tmp_path, ACTUATOR.replace("[tendon]", SPRING.format(spring) if spring else "[tendon]")),
        tendon={"kind": kind, "curvature": curvature if curvature in CURVATURES else curve},
        motion={**RAMP, "amplitude": float(direction)},
    )
    reference = curve if kind == "full" else APART.get(curvature, curve)
    pair = Pair(tuple(reference), X, **({f"{spring}_spring": 1.0 / 2e4} if spring else {}))
    coarse = spring or curvature not in CURVATURES
    within = 1e-8 if kind == "full" else 2e-4 if coarse else 1e-5
    for torque in (1.0, -0.6):
        delivered = run(joint, torque, 0.1 if kind == "full" else 0.2)["tau_j"]
        assert delivered == pytest.approx(pair.joint_torque(torque, direction), abs=within)


def test_beyond_slack_one_tendon_carries_all(tmp_path: Path) -> None:
    joint = axis(tmp_path, motion=RAMP)
    values = run(joint, 2.4, 0.1)
    assert values["t1"] == values["t2"] == 0.0
    assert values["t3"] == pytest.approx(2.4 / R_M)
    assert values["tau_j"] == pytest.approx(R_J * 2.4 / R_M * math.exp(-X))


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
