"""A light motor on soft tendons that does not follow the joint through a reversal, as in the daemon's own logs."""

from __future__ import annotations

import pytest

from tests.blind.soft_tendons import record
from tests.identify.diagnosis.nominal import model
from tsa_ctrl.identify import diagnose

JOINT = pytest.mark.soak  # logs without a motor angle have this displacement, and the gate covers it


@pytest.mark.slow
@pytest.mark.parametrize(("compensated", "follows"), [pytest.param(False, "joint", marks=JOINT), (True, "motor")])
def test_presliding_is_found_in_the_displacement_that_shows_it(compensated: bool, follows: str) -> None:
    result = diagnose([record(1, compensated=compensated)], model())
    cause = result.causes[0]
    assert (cause.effect, cause.alternatives) == ("presliding_hysteresis", ()), result.sentence
    assert cause.parameters["displacement"] == follows
    assert result.gain > 0.9
    assert result.details is not None
    # the first effect of each group
    first = {ranked.group: ranked.effect for ranked in reversed(result.details.ranking)}
    of_torque = [each.effect for each in result.causes if each.explained_fraction > 0.0]
    assert [first[number] for number in range(len(of_torque))] == of_torque
    (softer,) = result.causes[1:]  # each tendon has 4e4 N/m; the file states a quarter more
    assert (softer.effect, softer.alternatives) == ("series_spring", ("parameter_error",))
