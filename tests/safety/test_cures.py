"""Every cause that latches says what to do about it."""

from __future__ import annotations

import pytest

from tsa_ctrl.safety.cures import CURES
from tsa_ctrl.safety.supervisor import Cause, Fault


def cure(fault: Fault) -> str:
    return next(words for needle, words in CURES.items() if needle in str(fault))


@pytest.mark.parametrize("cause", list(Cause))
def test_every_cause_has_a_cure(cause: Cause) -> None:
    assert cure(Fault(cause, "drive node 1", 0.0)) == CURES[cause.value]


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (Fault(Cause.TRIPPED, "over-speed at the limiter", 0.0), "tendons before anything else"),
        (Fault(Cause.EMERGENCY, "drive node 1: EMCY 0x8130", 0.0), "held up"),
        (Fault(Cause.TRIPPED, "motor and joint moved apart by 0.5 rad at the motor", 0.0), "look at the tendons"),
    ],
)
def test_what_was_found_comes_before_what_latched_it(fault: Fault, words: str) -> None:
    assert words in cure(fault)
