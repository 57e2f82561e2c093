"""Hidden direction of motion: the torque reveals it where velocity noise hides it.

The diagnosis reports it and derives no cause from it. Torque and motion come from the independent plant of the blind
benchmark or are synthesised in this module.
"""

from __future__ import annotations

import dataclasses
import tomllib

import numpy as np
import pytest

from tests.blind import case
from tests.identify.diagnosis.nominal import diagnosed
from tests.model.actuator import ACTUATOR
from tsa_ctrl.identify import diagnose
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.diagnosis.data.audit import audit
from tsa_ctrl.identify.diagnosis.data.direction import with_hidden_direction
from tsa_ctrl.identify.diagnosis.data.frame import Run
from tsa_ctrl.identify.diagnosis.data.prepare import prepare
from tsa_ctrl.identify.diagnosis.data.split import Split, split
from tsa_ctrl.identify.diagnosis.noise.nuisance import uncertain
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import RigidDrive, model_from
from tsa_ctrl.model.signals import hold_direction

RATE = 250.0
DRIVE = RigidDrive(coulomb_friction=0.3, viscous_friction=0.1)


def _seen(name: str, seed: int) -> tuple[Split, Split, Array]:
    """Return the split data before and after the direction is inferred, and the true direction at the compute rate."""
    hidden = case("hidden_direction", name, seed, short=True)
    model = model_from(tomllib.loads(hidden.model), "nominal.toml")
    before = split(prepare([Dataset.from_arrays(log.columns, log.name) for log in hidden.logs], model), None)
    assert hidden.bench is not None
    true = hidden.bench.runs[0].pick(hidden.bench.runs[0].scene.direction())
    count = len(before.frame.runs[0].signals)
    return before, with_hidden_direction(before, model), true[: count * (len(true) // count) : len(true) // count]


@pytest.mark.parametrize(("name", "seed"), [("plateaus", 1), ("slow_walk", 2), ("slow_multisine", 3)])
def test_the_torque_shows_which_way_a_slow_joint_moves(name: str, seed: int) -> None:
    before, after, true = _seen(name, seed)
    wrong = [hold_direction(data.frame.runs[0].signals.omega_j) != true for data in (before, after)]
    assert np.mean(wrong[1]) < 0.2 * np.mean(wrong[0])
    run = after.frame.runs[0]
    assert not np.any(wrong[1] & ~uncertain(run, run.signals.omega_j))
    assert run.told > 0.99
    assert "the velocity shows no direction" in audit(after.frame).notes[-1]


def test_held_out_errors_leave_hidden_stretches_out() -> None:
    before, after, _ = _seen("slow_walk", 2)
    assert after.held.sum() < before.held.sum()
    assert np.array_equal(after.frame.train, before.frame.train)


def test_a_log_that_moves_is_left_as_it_is() -> None:
    rng = np.random.default_rng(1)
    t = np.arange(round(12.0 * RATE)) / RATE
    omega = np.sin(3.0 * t) + 0.002 * rng.standard_normal(len(t))
    tau_m = np.sin(0.7 * t)
    log = Dataset.from_arrays({"t": t, "tau_m": tau_m, "tau_j": 0.8 * tau_m - 0.1 * np.sign(omega), "omega_j": omega})
    data = split(prepare([log], ACTUATOR), None)
    assert with_hidden_direction(data, ACTUATOR) is data


def _run(omega: Array, error: float) -> Run:
    """Return a run with this velocity, (n,) at RATE, and a velocity error of `error` rad/s."""
    t = np.arange(len(omega)) / RATE
    log = Dataset.from_arrays({"t": t, "tau_m": np.sin(t), "tau_j": np.sin(t), "omega_j": omega})
    run = prepare([log], ACTUATOR)[0]
    signals = dataclasses.replace(run.signals, omega_j=omega)
    return dataclasses.replace(run, signals=signals, velocity_error=np.full(len(omega), error))


@pytest.mark.parametrize(
    ("speed", "seconds", "sure"),
    [
        pytest.param(0.03, 0.04, False, id="noise makes as much of a rest now and then"),
        pytest.param(0.05, 0.04, True, id="as much it never makes"),
        pytest.param(0.03, 0.2, True, id="nor for so long"),
    ],
)
def test_what_noise_takes_out_of_a_slow_stretch_has_no_direction(speed: float, seconds: float, sure: bool) -> None:
    omega = np.full(round(10.0 * RATE), 0.002)
    start = round(4.0 * RATE)
    omega[start : start + round(seconds * RATE)] = speed
    run = _run(omega, 0.01)
    unknown = uncertain(run, omega)
    inside = unknown[start + 2 : start + round(seconds * RATE) - 2]
    assert bool(np.any(inside)) is not sure
    assert np.all(unknown[: start - 2])


def _stop_and_go(offset: float) -> dict[str, Array]:
    """Return columns of a plain drive that rests half of the time.

    At rest the motor holds a torque within the friction band.
    """
    rng = np.random.default_rng(7)
    t = np.arange(round(30.0 * RATE)) / RATE
    moving = np.floor(t / 1.5) % 2.0 == 0.0
    way = np.where(np.floor(t / 3.0) % 2.0 == 0.0, 1.0, -1.0)
    omega = np.where(moving, way * (1.0 + np.sin(2.0 * np.pi * t / 1.5) ** 2), 0.0)
    resting = 0.2 * way  # an arbitrary controller residual: within the friction, on the side of the last motion
    tau_m = np.where(moving, 0.3 * np.sign(omega) + 0.1 * omega + offset, resting)
    return {"t": t, "tau_m": tau_m + 0.005 * rng.standard_normal(len(t)), "omega_m": omega}


def test_a_rest_is_neither_learned_from_nor_counted() -> None:
    log = Dataset.from_arrays(_stop_and_go(0.0), "log")
    data = with_hidden_direction(split(prepare([log], DRIVE), None), DRIVE)
    still = data.frame.runs[0].average((data.frame.runs[0].signals.omega_j == 0.0).astype(float)) > 0.0
    assert still.mean() > 0.4
    assert not np.any(still & (data.frame.train | data.held | data.fit))
    assert "friction at rest is anything within its band" in audit(data.frame).notes[-1]


@pytest.mark.slow
# an offset (tilt) is the harder case
@pytest.mark.parametrize("offset", [pytest.param(0.0, marks=pytest.mark.soak), 0.05])
def test_what_a_drive_holds_at_rest_is_no_cause(offset: float) -> None:
    result = diagnose({"log": _stop_and_go(offset)}, dataclasses.replace(DRIVE, torque_offset=0.0))
    assert result.causes == ()
    found = {name: error.found.value for name, error in result.parameter_errors.items()}
    assert found["coulomb_friction"] == pytest.approx(0.3, abs=0.01)
    assert found["torque_offset"] == pytest.approx(offset, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed"),
    [
        pytest.param("slow_gait", 1, marks=pytest.mark.soak),
        pytest.param("slow_multisine", 1, marks=pytest.mark.soak),
        pytest.param("plateaus", 1, marks=pytest.mark.soak),
        ("plateaus", 2),
    ],
)
def test_hidden_directions_are_no_structure(name: str, seed: int) -> None:
    hidden = case("hidden_direction", name, seed, short=True)
    assert diagnosed(hidden).verdict.value == "consistent"


def _on_a_spring(seed: int) -> dict[str, Array]:
    """Return columns of a joint on a spring, whose tendons stick for most of the time, with a slow torque sensor.

    While it sticks, the joint torque is constant, and the motor torque moves within the friction band.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(round(16.0 * RATE)) / RATE
    tau_m = sum(
        rng.uniform(0.15, 0.4) * np.sin(2.0 * np.pi * f * t + rng.uniform(0.0, 6.0)) for f in (0.13, 0.31, 0.57)
    )
    driven, friction = 1.29 * tau_m, 0.6
    tau_j, sliding = np.zeros(len(t)), 0.0
    for index, torque in enumerate(driven):
        sliding = min(max(sliding, torque - friction), torque + friction)
        tau_j[index] = sliding
    omega = np.gradient(tau_j, t) / 4.0
    slow, level = np.zeros(len(t)), 0.0
    for index, torque in enumerate(tau_j):
        level += (torque - level) * (1.0 - np.exp(-1.0 / (RATE * 0.06)))
        slow[index] = level
    return {
        "t": t,
        "tau_m": tau_m + 1e-3 * rng.standard_normal(len(t)),
        "omega_j": omega + 6e-4 * rng.standard_normal(len(t)),
        "q_j": np.round(tau_j / 4.0 / 1e-4) * 1e-4,
        "tau_j": slow + 5e-3 * rng.standard_normal(len(t)),
    }


@pytest.mark.slow
@pytest.mark.parametrize("measured", ["omega_j", pytest.param("q_j", marks=pytest.mark.soak)])
def test_a_lag_is_found_on_a_joint_that_sticks_most_of_the_time(measured: str) -> None:
    logs = {f"log {seed}": _on_a_spring(seed) for seed in (1, 2)}
    for columns in logs.values():
        del columns["omega_j" if measured == "q_j" else "q_j"]
    result = diagnose(logs, ACTUATOR)
    lag = next(cause for cause in result.causes if cause.effect == "torque_sensor_lag")
    value = lag.parameters["time_constant"]
    assert not isinstance(value, str)
    assert value.value == pytest.approx(0.06, rel=0.1)
