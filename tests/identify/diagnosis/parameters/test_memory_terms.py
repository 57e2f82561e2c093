"""Terms with memory are found with their constants if the load has memory. The data are synthetic."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lsim

from tests.blind.memory import bristle, first_order_lag
from tests.identify.diagnosis.parameters.swinging import swinging
from tests.model.actuator import ACTUATOR
from tsa_ctrl.identify.diagnosis import Diagnosis, diagnose
from tsa_ctrl.model.parameters import TendonSheath

Array = NDArray[np.float64]
PERIOD, NOISE = 4e-3, 2e-3  # s, N*m
X, RATIO = ACTUATOR.friction_angle, ACTUATOR.joint_pulley_radius / ACTUATOR.motor_pulley_radius
HALF_LOOP = 2.0 * ACTUATOR.pretension * ACTUATOR.joint_pulley_radius * math.sinh(X)


def lagging(tau: Array) -> Array:
    return np.asarray(tau - 0.25 * (tau - first_order_lag(tau, PERIOD, 0.4)))


def ringing(tau: Array) -> Array:
    w = 2.0 * math.pi * 7.0
    system = (np.array([[0.0, 1.0], [-w * w, -0.1 * w]]), np.array([[0.0], [w * w]]), np.eye(1, 2), 0.0)
    swung = lsim(system, tau, PERIOD * np.arange(len(tau)), X0=[tau[0], 0.0])[1]
    return np.asarray(tau + 0.3 * (swung - tau))


def loop(tau: Array) -> Array:
    return np.asarray(tau + 0.15 * bristle(tau, 0.4, 0.0))


def nothing(tau: Array) -> Array:
    return tau


def diagnosed(sensor: object, seed: int = 3) -> Diagnosis:
    """Return the diagnosis of two logs of 20 s: a swinging joint, torques of both signs, and `sensor` applied to the
    torque.
    """
    logs = {}
    for k in range(2):
        rng = np.random.default_rng([seed, k])
        t = PERIOD * np.arange(5000)
        q, omega, tau_m = swinging(rng, t)
        tendons = RATIO * math.cosh(X) * tau_m - HALF_LOOP * np.sign(omega)
        measured = sensor(tendons) + rng.normal(0.0, NOISE, len(t))  # type: ignore[operator]
        logs[f"{k}.csv"] = {"t": t, "tau_m": tau_m, "tau_j": measured, "omega_j": omega, "q_j": q}
    return diagnose(logs, model())


def model() -> TendonSheath:
    return dataclasses.replace(ACTUATOR, source="nominal.toml")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensor", "expression", "constants"),
    [
        (lagging, "a*(tau - lag(tau, b))", {"a": 0.25, "b": 0.4}),
        (ringing, "a*(tau - ring(tau, b, c))", {"a": 0.3, "b": 7.0, "c": 0.05}),
        (loop, "a*dahl(tau, b)", {"a": -0.15, "b": 0.4}),
    ],
    ids=["lag", "ring", "hysteresis"],
)
def test_it_is_found_with_its_constants(sensor: object, expression: str, constants: dict[str, float]) -> None:
    found = diagnosed(sensor)
    assert not found.causes
    assert found.formula is not None
    assert found.formula.expression == expression
    assert found.formula.gain > 0.9
    for name, value in constants.items():
        assert found.formula.constants[name].value == pytest.approx(value, rel=0.03)


@pytest.mark.slow
def test_where_there_is_none_there_is_no_formula() -> None:
    found = diagnosed(nothing)
    assert found.formula is None
    assert not found.causes
