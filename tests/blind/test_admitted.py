"""The package lets every drawn log in: units, kinematics and signs are those of a sound rig."""

from __future__ import annotations

import tomllib

import pytest

from tsa_ctrl.identify.admit import admit
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import model_from

from . import FAMILIES, case


@pytest.mark.parametrize(("family", "name"), [(family, name) for family, names in FAMILIES.items() for name in names])
def test_logs_and_model_are_admitted(family: str, name: str) -> None:
    drawn = case(family, name, 2, short=True)
    for each in (drawn, drawn.experiment):
        if each is not None:
            model = model_from(tomllib.loads(each.model), "nominal.toml")
            for log in each.logs:
                admit(Dataset.from_arrays(log.columns, log.name), model)
