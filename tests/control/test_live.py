"""What may be changed while the loop runs, and how far."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.daemon.machine import Machine
from tsa_ctrl.control.live import Parameter, Tuner, parameters_of

KINDS = ("fixed", "sensor", "map", "motor", "stretch")


@pytest.fixture(params=KINDS)
def parameters(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[Parameter, ...]]:
    """Those of an axis with each kind of estimator."""
    bending = [('# source = "fixed"  ', 'source = "command"  ')] if request.param == "map" else []
    machine = Machine(tmp_path, ('# kind = "stretch"  ', f'kind = "{request.param}"  '), *bending)
    yield parameters_of(machine.axis)
    machine.close()


def test_every_parameter_that_can_be_set_has_finite_bounds(parameters: tuple[Parameter, ...]) -> None:
    """Both or none; in order, and what is now lies between them."""
    assert any(parameter.low is not None for parameter in parameters)
    for parameter in parameters:
        assert (parameter.low is None) == (parameter.high is None), parameter.name
        if parameter.low is not None and parameter.high is not None:
            assert -math.inf < parameter.low < parameter.high < math.inf, parameter.name
            assert parameter.low <= parameter.value <= parameter.high, parameter.name


def test_no_parameter_takes_what_is_outside(parameters: tuple[Parameter, ...]) -> None:
    """Nor what is no number; nor anything where there are no bounds."""
    tuner = Tuner(parameters, 1e-3)
    before = [parameter.value for parameter in parameters]
    for index, parameter in enumerate(parameters):
        low, high = parameter.low, parameter.high
        outside = [math.nan, math.inf, -math.inf]
        if low is not None and high is not None:
            outside += [math.nextafter(low, -math.inf), math.nextafter(high, math.inf)]
        else:
            outside += [0.0, 1.0]
        for value in outside:
            tuner.set(index, value)
            tuner.update()
    assert [parameter.value for parameter in parameters] == before


def test_a_torque_limit_comes_down_without_a_jump(parameters: tuple[Parameter, ...]) -> None:
    """From all to nothing within a quarter of a second, in steps that the torque can follow."""
    index, limit = next((n, p) for n, p in enumerate(parameters) if p.name == "torque_limit")
    tuner, before = Tuner(parameters, 1e-3), limit.value
    tuner.set(index, 0.0)
    values = []
    for _ in range(260):
        tuner.update()
        values.append(limit.value)
    assert values[0] > 0.99 * before
    assert values[200] > 0.0
    assert values[-1] == 0.0


def test_limits_can_be_lowered_never_raised(parameters: tuple[Parameter, ...]) -> None:
    """The upper bound of both is what the file says."""
    by_name = {parameter.name: parameter for parameter in parameters}
    for name in ("torque_limit", "rate_limit"):
        assert by_name[name].high == by_name[name].value
