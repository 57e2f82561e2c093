"""Pictures of a diagnosis: what an axis shows."""

from __future__ import annotations

import numpy as np
import pytest

from tsa_ctrl.identify.diagnosis.report.pictures import _span


def test_single_samples_do_not_set_the_axis() -> None:
    values = np.linspace(-10.0, 20.0, 10_000)
    values[::500] = -600.0
    low, high = _span(values)
    assert -16.0 < low < -10.0
    assert 20.0 < high < 26.0


@pytest.mark.parametrize("value", [0.0, 3.0])
def test_a_residual_without_spread_has_an_axis(value: float) -> None:
    low, high = _span(np.full(10, value))
    assert low < value < high
