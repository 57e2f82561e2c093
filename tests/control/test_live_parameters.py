"""Test the parameters that may be changed while the loop runs, and their bounds."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.daemon.machine import WITH_CELLS, Machine
from tsa_ctrl.control.live_parameters import Parameter, Tuner, parameters_of
from tsa_ctrl.daemon.build import describe, tuners_of
from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc.mailbox import Mailbox
from tsa_ctrl.ipc.parameters import change

KINDS = ("fixed", "sensor", "map", "motor", "stretch", "tension")


NEEDS = {"map": [('# source = "fixed"  ', 'source = "command"  ')], "tension": [WITH_CELLS]}


def machine_of(folder: Path, kind: str) -> Machine:
    """Return a machine with an estimator of this kind and the settings that it requires."""
    return Machine(folder, ('# kind = "sensor"  ', f'kind = "{kind}"  '), *NEEDS.get(kind, []))


@pytest.fixture(params=KINDS)
def parameters(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[Parameter, ...]]:
    """Yield the parameters of an axis, for each kind of estimator."""
    machine = machine_of(tmp_path, request.param)
    yield parameters_of(machine.axis)
    machine.close()


def test_no_parameter_takes_what_is_outside(parameters: tuple[Parameter, ...]) -> None:
    """Values that are not finite or outside the bounds are rejected, and any value of a parameter without bounds."""
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


def test_every_parameter_takes_its_bounds(parameters: tuple[Parameter, ...]) -> None:
    tuner = Tuner(parameters, 1e3)  # s, long enough for every value to arrive
    for index, parameter in enumerate(parameters):
        if parameter.name == "direction_zone":  # never narrower than the encoder's noise
            continue
        for value in (parameter.high, parameter.low):  # in this order, because back_off cannot be raised
            if value is not None:
                tuner.set(index, value)
                tuner.update()
                assert parameter.value == value, parameter.name


@pytest.mark.parametrize("parameters", ["fixed"], indirect=True)
def test_a_torque_limit_comes_down_without_a_jump(parameters: tuple[Parameter, ...]) -> None:
    """The torque limit falls to zero in small steps that take between 0.2 and 0.26 s."""
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


# (low, high, rate per s) by name; the bounds are None if the parameter cannot be set. The file has x = 0.26,
# T_p0 = 45 N, a torque limit of 2 N*m and a rate limit of 200 N*m/s.
ALWAYS = {
    "compensation": (0.0, 1.2, 0.5),
    "slew": (1.0, 10_000.0, math.inf),
    "damping": (None, None, math.inf),
    "friction_angle": (None, None, 0.13),
    "pretension": (None, None, 22.5),
    "use_estimate": (None, None, math.inf),
    "bending_angle": (None, None, 2.0),
    "direction_zone": (0.005, 10.0, math.inf),
    "setpoint_gain": (-2.0, 2.0, 0.5),
    "back_off": (0.0, 1.0, math.inf),
    "torque_limit": (0.0, 2.0, 8.0),
    "rate_limit": (1.0, 200.0, math.inf),
}
USED = {"use_estimate": (0.0, 1.0, math.inf)}
OF_KIND = {
    "fixed": {"friction_angle": (0.0, 0.325, 0.13), "pretension": (0.0, 56.25, 22.5)},  # [uncertainty] 0.25
    "sensor": USED,
    "map": {"bending_angle": (0.0, 5.2, 2.0)},
    "motor": USED,
    "stretch": USED,
    "tension": USED,
}


def bounds(parameters: tuple[Parameter, ...]) -> dict[str, tuple[float | None, float | None, float]]:
    return {each.name: (each.low, each.high, each.rate) for each in parameters}


@pytest.mark.parametrize("kind", KINDS)
def test_bounds_and_rates_are_those_of_the_kind(kind: str, tmp_path: Path) -> None:
    machine = machine_of(tmp_path, kind)
    found = bounds(parameters_of(machine.axis))
    zone = machine.axis.direction.zone  # a client can only widen it
    expected = ALWAYS | OF_KIND[kind] | {"direction_zone": (zone, 10.0, math.inf)}
    assert list(found) == list(expected)
    for name, values in expected.items():
        assert found[name] == pytest.approx(values), name
    for parameter in parameters_of(machine.axis):
        if parameter.low is not None and parameter.high is not None:
            assert parameter.low <= parameter.value <= parameter.high, parameter.name
    machine.close()


@pytest.mark.parametrize("name", ["friction_angle", "pretension"])
@pytest.mark.parametrize("factor", [0.5, 1.2])
def test_the_law_uses_what_a_client_sets_and_never_more_than_the_file_has(
    tmp_path: Path, name: str, factor: float
) -> None:
    """A client can lower the friction torque that the law compensates, but not raise it above the file's value.

    A value of a client does not prove more friction.
    """
    machine = machine_of(tmp_path, "fixed")
    axis, law = machine.axis, machine.axis.law
    parameters = parameters_of(axis)
    index, chosen = next((n, p) for n, p in enumerate(parameters) if p.name == name)
    tuner, nominal = Tuner(parameters, 1e-3), law.half_loop

    def used() -> float:
        """Return the friction torque (N*m) of the law after one step of its inverse model."""
        law._inverse.update(0.0, 1.0, 0.1)
        return law._inverse.half_loop()

    tuner.set(index, factor * chosen.value)
    seen = []
    for _ in range(2000):
        tuner.update()
        axis.adapt()
        seen.append(used() * law.confirmed)
    x, pretension = (0.26, factor * 45.0) if name == "pretension" else (factor * 0.26, 45.0)
    friction = 2.0 * pretension * 0.020 * math.tanh(x)  # N*m, (3.55)
    assert used() == pytest.approx(friction, rel=2e-3)
    assert seen[-1] == pytest.approx(min(friction, nominal), rel=2e-3)
    assert max(seen) <= nominal * (1.0 + 1e-9)
    assert max(abs(b - a) for a, b in itertools.pairwise(seen)) < 2e-3  # N*m per cycle, so there is no step
    machine.close()


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "fixed"])
def test_where_an_estimator_determines_them_the_reason_is_given(kind: str, tmp_path: Path) -> None:
    machine = machine_of(tmp_path, kind)
    tuners = tuners_of(machine.axes, 1e-3)
    description = describe(machine.configuration, tuners)
    for name in ("friction_angle", "pretension"):
        with pytest.raises(UsageError, match=f"'{name}' cannot be set .* the estimator determines it, kind = .fixed."):
            change(machine.mailbox, description, name, 0.2)
    machine.close()


def test_damping_can_be_lowered_from_what_the_motor_bears(tmp_path: Path) -> None:
    machine = Machine(tmp_path, ("# motor_inertia = 1e-4 ", "motor_inertia = 1e-4 "))
    most = machine.axis.law.plan.damping
    assert 0.0 < most < 1.0
    assert bounds(parameters_of(machine.axis))["damping"] == (0.0, most, math.inf)
    machine.close()


@pytest.mark.parametrize("parameters", ["fixed"], indirect=True)
def test_what_moves_slowly_takes_its_time_and_then_rests(parameters: tuple[Parameter, ...]) -> None:
    index, gain = next((n, p) for n, p in enumerate(parameters) if p.name == "setpoint_gain")
    tuner = Tuner(parameters, 1e-3)
    tuner.set(index, 0.9)
    values = []
    for _ in range(202):
        tuner.update()
        values.append(gain.value)
    assert values[0] == pytest.approx(0.9995)
    assert values[99] == pytest.approx(0.95)
    assert values[198] > 0.9
    assert values[200:] == [0.9, 0.9]
    setattr(gain.part, gain.attribute, 0.3)
    tuner.update()
    assert gain.value == 0.3  # the change is complete and keeps no value


def test_the_value_before_the_first_cycle_is_unknown(tmp_path: Path) -> None:
    """Before the first cycle, the answer contains None as the previous value.

    A smaller back-off is accepted, because there is no published value to compare.
    """
    machine = machine_of(tmp_path, "fixed")
    description = describe(machine.configuration, tuners_of(machine.axes, 1e-3))
    for name, value in (("compensation", 0.5), ("back_off", 0.5)):
        _, answer = change(Mailbox(1, len(description.parameters[0])), description, name, value)
        assert (answer["before"], answer["value"]) == (None, value)
    machine.close()
