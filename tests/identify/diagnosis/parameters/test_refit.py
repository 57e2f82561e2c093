"""An interval excludes values. An interval that would exclude nothing is not reported.

The covariances are synthetic.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tsa_ctrl.identify.diagnosis.fitting.problem import Hypothesis
from tsa_ctrl.identify.diagnosis.parameters.refit import Refit, effect_quantities
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.model.effects.search import Coordinate, Variant
from tsa_ctrl.outputs import json_types


def _quantity(effect: str, name: str, value: float, deviation: float, **others: float) -> Quantity:
    """Return the reported quantity of an effect whose parameter has this value and standard deviation."""
    coordinate = Coordinate(name, -math.inf, math.inf)
    variant = Variant(effect, (coordinate,), ((0.0,),), (0,), lambda u: {name: float(u[0]), **others})
    base: Any = SimpleNamespace(coordinates=lambda: ())
    fitted: Any = SimpleNamespace(hypothesis=Hypothesis(base, (variant,)), point=np.array([value]))
    found = effect_quantities(Refit(fitted, np.array([[deviation**2]]), factor=2.0))[effect][name]
    assert isinstance(found, Quantity)
    assert found.value == pytest.approx(value)
    return found


def test_what_is_known_has_its_interval() -> None:
    found = _quantity("torque_constant_error", "relative_error", -0.3, 0.05)
    assert (found.low, found.high) == pytest.approx((-0.4, -0.2))


def test_an_interval_ends_at_what_is_allowed() -> None:
    found = _quantity("torque_constant_error", "relative_error", -0.3, 0.2)
    assert (found.low, found.high) == pytest.approx((-0.5, 0.1))


@pytest.mark.parametrize(
    ("effect", "name", "value", "deviation", "others"),
    [
        pytest.param("torque_constant_error", "relative_error", -0.3, 0.6, {}, id="all that is allowed"),
        pytest.param("gravity_load", "phase", -1.4, 1.6, {"amplitude": 1.0}, id="more than a turn"),
        pytest.param("viscous_friction", "coefficient", 0.02, 1.0, {}, id="not even its size"),
    ],
)
def test_an_interval_that_leaves_nothing_out_is_none(
    effect: str, name: str, value: float, deviation: float, others: dict[str, float]
) -> None:
    found = _quantity(effect, name, value, deviation, **others)
    assert (found.low, found.high) == (-math.inf, math.inf)
    assert json_types(found)["low"] is None
