"""Terms with memory are found with their constants if the load has memory. The data are synthetic."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lsim

from tests.blind.memory import bristle, first_order_lag
from tests.identify.diagnosis.parameters.swinging import NOMINAL, PERIOD, recorded
from tsa_ctrl.identify.diagnosis import Diagnosis, diagnose

Array = NDArray[np.float64]
NOISE = 2e-3  # N*m


def lagging(tau: Array) -> Array:
    return np.asarray(tau - 0.25 * (tau - first_order_lag(tau, PERIOD, 0.4)))


def ringing(tau: Array) -> Array:
    w = 2.0 * math.pi * 7.0
    system = (np.array([[0.0, 1.0], [-w * w, -0.1 * w]]), np.array([[0.0], [w * w]]), np.eye(1, 2), 0.0)
    swung = lsim(system, tau, PERIOD * np.arange(len(tau)), X0=[tau[0], 0.0])[1]
    return np.asarray(tau + 0.3 * (swung - tau))


def loop(tau: Array) -> Array:
    return np.asarray(tau + 0.15 * bristle(tau, 0.4, 0.0))


def diagnosed(sensor: Callable[[Array], Array]) -> Diagnosis:
    """Return the diagnosis of two logs of 20 s with `sensor` applied to the torque."""
    logs = {f"{k}.csv": recorded(np.random.default_rng([3, k]), 5000, NOISE, sensor) for k in range(2)}
    return diagnose(logs, NOMINAL)


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
    found = diagnosed(lambda tau: tau)
    assert found.formula is None
    assert not found.causes
