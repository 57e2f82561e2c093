"""A nominal model and a time axis for synthetic logs, and the diagnosis of blind cases."""

from __future__ import annotations

import tomllib

import numpy as np

from tests.blind.cases import Case
from tsa_ctrl.identify import Diagnosis, diagnose
from tsa_ctrl.model.parameters import TendonSheath, model_from

T = np.arange(0.0, 20.0, 0.005)
MODEL = """
[actuator]
motor_pulley_radius = 0.02
joint_pulley_radius = 0.025
[tendon]
axial_stiffness = 6e4
unstrained_length = 1.2
diameter = 6e-4
[sheath]
friction_coefficient = 0.1
bending_angle = 2.6
[pretension]
value = 45.0
"""


def model(text: str = MODEL) -> TendonSheath:
    made = model_from(tomllib.loads(text), "nominal.toml")
    assert isinstance(made, TendonSheath)
    return made


def diagnosed(hidden: Case) -> Diagnosis:
    """Return the diagnosis of the logs of a blind case with its nominal model."""
    logs = {log.name: log.columns for log in hidden.logs}
    return diagnose(logs, model_from(tomllib.loads(hidden.model), "nominal.toml"))


def named(found: Diagnosis) -> list[set[str]]:
    """Return one set per cause: the identified effect and its alternatives."""
    return [{cause.effect, *cause.alternatives} for cause in found.causes]
