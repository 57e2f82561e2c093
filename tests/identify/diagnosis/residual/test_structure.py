"""Decisions by the simulation error when most of the residual is structure."""

from __future__ import annotations

import pytest

from tsa_ctrl.identify.diagnosis.residual.structure import ErrorCriterion


@pytest.mark.parametrize(
    ("share", "rival", "without", "covers"),
    [
        (0.9, 1.3, 2.6, True),  # explains 80 % as much; its excess error is smaller than the residual
        (0.9, 1.95, 2.6, False),  # explains 40 % as much
        (0.9, 1.95, 9.0, False),  # explains 88 % as much, but its excess error is larger than the residual
        (0.6, 1.65, 9.0, False),
        (0.7, 1.65, 9.0, True),
        (0.9, 0.9, 2.6, True),  # better than the cause itself
        (0.9, 2.6, 2.6, False),  # explains nothing
    ],
)
def test_a_rival_covers_when_it_explains_most_and_lacks_less_than_what_is_left(
    share: float, rival: float, without: float, covers: bool
) -> None:
    assert ErrorCriterion(share, 1.0).covers(rival, without) is covers
