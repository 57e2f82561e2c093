"""Recalibration changes the parameters of a base model but keeps the file's reference tension."""

from __future__ import annotations

import math

import pytest

from tests.identify.diagnosis.nominal import model
from tsa_ctrl.identify.diagnosis.hypotheses.base import TendonBase


@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_recalibration_leaves_the_reference_tension_at_the_file_s_pretension(factor: float) -> None:
    base = TendonBase(model())
    built = base.build([0.0, math.log(factor)], {"tension_dependent_friction": {"exponent": 0.3}})
    assert built.effects["tension_dependent_friction"]["reference_tension"] == 45.0
    assert built == base.given.with_effects(built.effects).recalibrated(
        friction_angle=base.given.friction_angle, pretension=45.0 * factor
    )
