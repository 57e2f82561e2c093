"""Test that a late cycle, in which the joint has moved further than expected, causes no reversal."""

from __future__ import annotations

import math

import pytest

from tests.control.laws import COUNT, PERIOD, law
from tests.control.sliding import actuator
from tsa_ctrl.control.law import Law

SPEED = 3.0  # rad/s, speed of a knee during gait
STALL = 100  # number of the late cycle


def lowest_force(made: Law, lateness: float, skipped: int, told: bool) -> float:
    """Return the smallest `reversal.force` around one late cycle of a joint that moves at SPEED.

    The law receives the lateness if `told` is set.
    """
    lowest, number = 1.0, 0
    while number < STALL + 60:
        late = lateness if number == STALL else 0.0
        angle = SPEED * (number * PERIOD + late)
        made.late = late if told else 0.0
        made.observe(round(angle / COUNT) * COUNT, angle, True, 0.3, 0.0)
        if number > STALL - 20:
            lowest = min(lowest, made.reversal.force)
        if number == STALL:
            made.skip_cycles(skipped)
            number += skipped
        number += 1
    return lowest


@pytest.mark.parametrize(("lateness", "skipped"), [(0.4e-3, 0), (0.9e-3, 0), (2.9e-3, 3), (9.5e-3, 10)])
def test_a_late_cycle_does_not_turn_the_friction_term(lateness: float, skipped: int) -> None:
    """The friction term is not reversed if the law gets the lateness.

    Regression test: the term was reversed for 10 ms, by 0.8 N*m at the joint of the demo.
    """
    made = law(actuator(), motor_inertia=1e-4)
    assert lowest_force(made, lateness, skipped, told=True) > 0.99


def test_the_term_turns_if_the_lateness_is_not_told() -> None:
    assert lowest_force(law(actuator(), motor_inertia=1e-4), 2.9e-3, 3, told=False) < 0.5


def test_a_law_without_lateness_is_on_time() -> None:
    assert law(actuator()).late == 0.0
    assert math.isfinite(law(actuator()).half_loop)
