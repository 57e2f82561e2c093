"""Test that the package accepts every random log, with the units, kinematics and signs of a healthy rig."""

from __future__ import annotations

import tomllib

import pytest

from tsa_ctrl.identify.admit import admit
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import model_from

from . import FAMILIES
from .drawn import drawn, together

pytestmark = together
# Families of the gate. The first name of each is sufficient here.
ASKED = ("none", "single", "pair", "outside", "confounded")
SEEDS = {"single": 1}  # the same seeds as in other tests; 0 for the other families


@pytest.mark.slow
@pytest.mark.parametrize(
    ("family", "name"),
    [
        pytest.param(family, name, marks=[pytest.mark.soak] if family in ASKED and name != names[0] else [])
        for family, names in FAMILIES.items()
        for name in names
    ],
)
def test_logs_and_model_are_admitted(family: str, name: str) -> None:
    given = drawn(family, name, SEEDS.get(family, 0))
    for each in (given, given.experiment):
        if each is not None:
            model = model_from(tomllib.loads(each.model), "nominal.toml")
            for log in each.logs:
                admit(Dataset.from_arrays(log.columns, log.name), model)
