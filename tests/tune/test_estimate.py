"""Which form of the transmission tune keeps, on logs from the elongation equilibrium that shares no code with it."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from tests.identify import tendon_logs
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import TendonSheath, model_from
from tsa_ctrl.tune.estimate import Form, estimate, sliding_error


def rig_and_log(profile: str, seed: int = 3) -> tuple[tendon_logs.Rig, TendonSheath, Dataset]:
    rng = np.random.default_rng(seed)
    rig = tendon_logs.draw_rig(rng, profile)
    model = model_from(tomllib.loads(tendon_logs.model_text(rig, rng)), "nominal.toml")
    assert isinstance(model, TendonSheath)
    return rig, model, Dataset.from_arrays(tendon_logs.record(rig, rng, seconds=20.0, rate=200.0), "a.csv")


@pytest.mark.parametrize(
    ("profile", "form"), [("joint_end", Form.GIVEN), ("uniform", Form.UNIFORM), ("motor_end", Form.MOTOR_END)]
)
def test_the_form_that_made_the_data_is_kept(profile: str, form: Form) -> None:
    _, model, log = rig_and_log(profile)
    assert estimate([log], model, certified_gain=False, forms=True).form is form


def test_the_given_form_is_kept_when_asked_for() -> None:
    _, model, log = rig_and_log("motor_end")
    found = estimate([log], model, certified_gain=False, forms=False)
    assert found.form is Form.GIVEN
    assert found.model.effects == {}


def test_the_chosen_form_has_the_half_loop_of_the_truth() -> None:
    rig, model, log = rig_and_log("motor_end")
    found = estimate([log], model, certified_gain=False, forms=True).model
    loop = 2.0 * found.pretension * found.joint_pulley_radius * np.tanh(found.friction_angle)
    assert loop == pytest.approx(rig.truth()["half_loop_torque"], rel=0.03)


def test_the_new_model_predicts_sliding_better() -> None:
    _, model, log = rig_and_log("uniform")
    found = estimate([log], model, certified_gain=False, forms=True)
    assert sliding_error([log], found.model) < 0.7 * sliding_error([log], model)
