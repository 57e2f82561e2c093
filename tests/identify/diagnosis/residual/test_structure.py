"""What the simulation error decides where most of what is left is structure."""

from __future__ import annotations

import numpy as np
import pytest

from tsa_ctrl.identify.diagnosis.residual.structure import ErrorCriterion, _interpolated


@pytest.mark.parametrize(
    ("share", "rival", "without", "covers"),
    [
        (0.9, 1.3, 2.6, True),  # explains 80 % as much, and is worse by less than what is left
        (0.9, 1.95, 2.6, False),  # explains 40 % as much
        (0.9, 1.95, 9.0, False),  # explains 88 % as much, but is worse by more than what is left
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


def test_a_stretch_that_is_not_known_is_no_drift() -> None:
    """Its two ends are a sample each, of which one is off."""
    noise = np.random.default_rng(1).normal(0.0, 0.01, 2000)
    told = np.ones(2000, dtype=np.bool_)
    told[900:1150] = False
    noise[[899, 1150]] = -0.04
    noise[900:1150] = 1.0  # friction of the wrong sign
    filled = _interpolated(noise, told, 8e-3)
    assert np.array_equal(filled[told], noise[told])
    assert np.max(np.abs(filled[~told])) < 0.01
