"""Test the effects in the plant's own equations against the reference values of the definitions."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import lsim

from tests.blind import memory as blind
from tests.blind import stretch_effects
from tests.blind.plant import Tensions
from tests.model.test_vectors import CASES, STATES
from tests.plant.bench import R_J, R_M, axis
from tsa_ctrl.errors import UsageError

DELAYED = [(1e-4, 0.42), (1e-5, 0.042)]  # s, physics.step and a delay that is too long for it
APART = {"velocity_lag"}  # an effect of a sensor in the plant, tested below
MOTION = ("tau_m", "omega_j", "q_j", "acceleration_j", "temperature", "t")  # of a state
WINDOW = 0.05  # s of motion before the evaluated state


def delivered(folder: Path, effects: dict[str, dict[str, Any]], state: dict[str, float], phase_shift: float) -> float:
    """Return the plant's joint torque in one state of the table, reached by a motion with constant acceleration."""
    tau_m, omega, q, acceleration, temperature, t = (state[name] for name in MOTION)
    motion = folder / "motion.csv"
    rows = []
    for at in (0.0, 2.0, 4.0, 7.0):
        back = at - t
        angle = q + omega * back + 0.5 * acceleration * back * back
        rows.append(f"{at},{angle!r},{omega + acceleration * back!r}")
    motion.write_text("t,q_j,omega_j\n" + "\n".join(rows) + "\n")
    shifted = {name: dict(values) for name, values in effects.items()}
    if "torque_ripple" in shifted:
        shifted["torque_ripple"]["phase"] += phase_shift
    joint = axis(
        folder,
        1e-5,  # the ripple depends on the motor's angle in the previous sub-step
        tendon={"curvature": "joint_end", "presliding": 1e-9},
        motion={"kind": "file", "file": str(motion), "repeat": False, "ramp": 0.0},
        environment={"temperature": [(0.0, temperature)]},
        drive={"torque_time_constant": 0.0, "peak_torque": 5.0},
        effects=shifted,
    )
    start = t - WINDOW
    back = -WINDOW
    joint.state["t"] = start
    joint.state["q_j"] = q + omega * back + 0.5 * acceleration * back * back
    joint.state["q_m"] = joint.state["q_j"] * R_J / R_M
    joint.command.enabled, joint.command.torque = True, tau_m
    joint.advance(t)
    values = joint.values()
    assert values["unsolved"] == 0
    return values["tau_j"]


@pytest.mark.parametrize(("effects", "expected"), CASES)
def test_the_plant_agrees_with_the_definitions(
    tmp_path: Path, effects: dict[str, dict[str, Any]], expected: tuple[float, ...]
) -> None:
    if APART & set(effects):
        pytest.skip("a sensor in the plant")
    compared = len(STATES) if "tendon_slack" in effects else 4  # a tendon can always become slack in the plant
    for state, value in list(zip(STATES, expected, strict=True))[:compared]:
        shift = 0.0
        if "torque_ripple" in effects:  # the plant's motor angle contains the tendon elongation
            ripple = effects["torque_ripple"]
            gain = 1.0 + effects.get("torque_constant_error", {}).get("relative_error", 0.0)
            acting = gain * state["tau_m"] + ripple["amplitude"] * math.sin(
                ripple["cycles_per_revolution"] * state["q_m"] + ripple["phase"]
            )
            acting -= effects.get("motor_side_friction", {}).get("coulomb", 0.0) * math.copysign(1.0, state["omega_j"])
            stretch = acting / R_M * 1.2 / (2 * 60e3) / R_M
            shift = -ripple["cycles_per_revolution"] * stretch
        assert delivered(tmp_path, effects, state, shift) == pytest.approx(value, abs=2e-6)


@pytest.mark.parametrize(
    ("effect", "lagged", "true"),
    [("velocity_lag", "omega_lagged", "omega_j"), ("torque_sensor_lag", "tau_sensed", "tau_j")],
)
def test_a_sensor_lags_by_the_time_constant(tmp_path: Path, effect: str, lagged: str, true: str) -> None:
    joint = axis(tmp_path, motion={"kind": "sine", "ramp": 0.0}, effects={effect: {"time_constant": 0.02}})
    joint.advance(0.3)
    before = joint.values()[lagged]
    joint.advance(0.3001)
    after = joint.values()
    slope = (after[lagged] - before) / 1e-4
    assert after[lagged] + 0.02 * slope == pytest.approx(after[true], rel=1e-2)


def test_backlash_is_a_dead_interval_after_a_reversal(tmp_path: Path) -> None:
    joint = axis(
        tmp_path,
        motion={"kind": "sine", "amplitude": 0.5, "frequency": 1.0, "ramp": 0.0},
        effects={"backlash": {"gap": 0.05}},
    )
    dead = []
    for i in range(1, 1000):
        joint.advance(i * 1e-3)
        values = joint.values()
        if values["in_gap"]:
            dead.append(values["q_j"])
            assert values["tau_j"] == 0.0
    assert max(dead) == pytest.approx(0.5, abs=1e-3)
    assert min(angle for angle in dead if angle > 0) == pytest.approx(0.45, abs=4e-3)


def test_presliding_follows_dahl(tmp_path: Path) -> None:
    effects = {"presliding_hysteresis": {"presliding_distance": 0.05, "elements": 1, "displacement": "joint"}}
    joint = axis(tmp_path, motion={"kind": "sine", "amplitude": 0.1, "frequency": 0.5, "ramp": 0.0}, effects=effects)
    joint.advance(0.3)
    values = joint.values()
    assert values["z"] == pytest.approx(1.0 - math.exp(-values["q_j"] / 0.05), abs=1e-6)


@pytest.mark.parametrize("stage", ["joint", "motor"])
def test_the_plant_runs_a_formula_of_its_file(tmp_path: Path, stage: str) -> None:
    """k sin(3 q) + 0.1 tau tanh(omega) + 0.02 sigma reduces the torque at the joint or at the motor."""
    custom = {"expression": "k*sin(3*q_j) + 0.1*tau*tanh(omega_j) + 0.02*sigma", "stage": stage, "k": 0.05}
    for state in STATES[:4]:
        tau_m, omega, q = (state[name] for name in ("tau_m", "omega_j", "q_j"))
        plain = delivered(tmp_path, {}, state, 0.0)
        found = delivered(tmp_path, {"custom": custom}, state, 0.0)
        tau = plain if stage == "joint" else tau_m
        taken = 0.05 * math.sin(3.0 * q) + 0.1 * tau * math.tanh(omega) + 0.02 * math.copysign(1.0, omega)
        # At the motor it changes the input of the slope, cosh x, which follows from two motor torques.
        slope = (
            1.0 if stage == "joint" else (delivered(tmp_path, {}, {**state, "tau_m": tau_m + 0.1}, 0.0) - plain) / 0.1
        )
        assert plain - found == pytest.approx(slope * taken, abs=5e-6)


@pytest.mark.parametrize("stage", ["joint", "motor"])
def test_the_plant_remembers_as_the_formula_says(tmp_path: Path, stage: str) -> None:
    """The reference of two lags and a hysteresis is a loop of the blind benchmark and scipy's lsim."""
    expression = "0.3*(tau - lag(tau, 0.05)) + 0.02*dahl(tau, 0.1) + 0.2*(ring(tau, 20, 0.3) - tau)"
    moving = {"motion": {"kind": "sine", "ramp": 0.0}, "motor": {"inertia": 1e-5, "damping": 1e-3}}
    plain = axis(tmp_path, **moving)
    other = axis(tmp_path, effects={"custom": {"expression": expression, "stage": stage}}, **moving)
    tau, taken = [], []
    for step in range(1, 2001):
        for each in (plain, other):
            each.command.enabled, each.command.torque = True, 0.6 if step % 800 < 400 else -0.3
            each.advance(1e-4 * step)
        values = other.values()
        tau.append(values["torque_loop"] if stage == "motor" else values["tau_j"] + values["taken"])
        taken.append(values["taken"])
        if stage == "joint":  # the motion is prescribed, so the formula does not affect the tendons
            assert tau[-1] == pytest.approx(plain.values()["tau_j"], abs=1e-12)
    x = np.array(tau)
    w, h = 2.0 * math.pi * 20.0, 1e-4
    system = (np.array([[0.0, 1.0], [-w * w, -0.6 * w]]), np.array([[0.0], [w * w]]), np.eye(1, 2), 0.0)
    y = lsim(system, x, h * np.arange(len(x)), X0=[x[0], 0.0])[1]
    expected = 0.3 * (x - blind.first_order_lag(x, h, 0.05)) + 0.02 * blind.bristle(x, 0.1, 0.0)
    np.testing.assert_allclose(taken, expected + 0.2 * (y - x), atol=1e-9)


BESIDE: dict[str, dict[str, Any]] = {
    "series_spring": {"stiffness": 9e3},
    "tendon_creep": {"length": -3e-4, "time_constant": 1.5},
    "pulley_slip": {"length": 2e-4, "time": 1.1},
    "joint_play": {"gap": 0.03},
}


@pytest.mark.parametrize("name", list(BESIDE))
def test_what_only_the_angles_show(tmp_path: Path, name: str) -> None:
    """The effect changes r_M q_M - r_J q_J of the encoders as defined, but not the joint torque."""
    plain = axis(tmp_path, motion={"kind": "sine", "ramp": 0.0})
    other = axis(tmp_path, motion={"kind": "sine", "ramp": 0.0}, effects={name: BESIDE[name]})
    side, compared = 0.0, 0
    for step in range(1, 21):
        t, torque = 0.1 * step, 0.3 if step <= 12 else -0.3
        stretches = []
        for each in (plain, other):
            each.command.enabled, each.command.torque = True, torque
            each.advance(t)
            stretches.append(R_M * each.readings.motor_angle - R_J * each.readings.joint_angle)
        values = other.values()
        assert values["tau_j"] == plain.values()["tau_j"]
        before, side = side, math.copysign(1.0, values["t4"] - values["t2"])
        if side != before:
            continue  # the joint is crossing the backlash
        compared += 1
        tensions = Tensions(*(np.array([values[key]]) for key in ("t1", "t2", "t3", "t4", "tau_j")))
        clock = np.array([0.0, t])  # the creep starts with the log
        expected = stretch_effects.added(name, BESIDE[name], tensions, clock, R_J)[-1]
        assert stretches[1] - stretches[0] == pytest.approx(expected, abs=3e-6)
    assert compared > 12


@pytest.mark.parametrize(("step", "delay"), DELAYED)
def test_a_delay_beyond_the_memory_of_the_torque_is_rejected(tmp_path: Path, step: float, delay: float) -> None:
    with pytest.raises(UsageError, match=rf"delay {delay:g} s; allowed is 0 to {0.4096 * step / 1e-4:g} s"):
        axis(tmp_path, step, effects={"transport_delay": {"delay": delay}})


@pytest.mark.parametrize(("step", "delay"), DELAYED)
def test_the_longest_delay_is_simulated_with_sub_steps_of_half_the_step(
    tmp_path: Path, step: float, delay: float
) -> None:
    late = 0.95 * delay
    joint = axis(tmp_path, step, effects={"transport_delay": {"delay": late}})
    joint.command.enabled, joint.command.torque = True, 0.3
    times = 0.55 * step * np.arange(1, math.ceil(3.0 * delay / (0.55 * step)))
    sensed, true = np.empty_like(times), np.empty_like(times)
    for row, time in enumerate(times):
        joint.advance(float(time))
        sensed[row], true[row] = joint.readings.joint_torque, joint.values()["tau_j"]
    after = times > late + 0.01
    assert sensed[after] == pytest.approx(np.interp(times[after] - late, times, true), abs=1e-6)
