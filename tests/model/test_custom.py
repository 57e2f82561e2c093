"""[effects.custom]: a formula of the model file, in simulation and inverse; what cannot be inverted is refused."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from tests.model.actuator import ACTUATOR
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.feedforward import Feedforward
from tsa_ctrl.model.parameters import TendonSheath, load_tendon_sheath, save_model
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.signals import Signals

T = np.arange(100) * 0.01
SIGNALS = Signals(t=T, tau_m=0.4 * np.sin(5.0 * T), omega_j=np.cos(3.0 * T), q_j=np.sin(3.0 * T) / 3.0)
BASE = dataclasses.replace(ACTUATOR, source="a.toml")


def with_custom(expression: str, **more: float | str) -> TendonSheath:
    return BASE.with_effects({"custom": {"expression": expression, **more}})


def test_at_the_joint_it_is_taken_from_what_the_tendons_bring() -> None:
    plain = predict(BASE, SIGNALS)
    found = predict(with_custom("k*tau*abs(omega_j) + 0.01*q_j", k=0.2), SIGNALS)
    assert SIGNALS.q_j is not None
    taken = 0.2 * plain * np.abs(SIGNALS.omega_j) + 0.01 * SIGNALS.q_j
    np.testing.assert_allclose(plain - found, taken, atol=1e-12)


def test_at_the_motor_it_is_taken_before_the_tendons() -> None:
    found = predict(with_custom("0.1*sigma", stage="motor"), SIGNALS)
    expected = predict(BASE.with_effects({"motor_side_friction": {"coulomb": 0.1}}), SIGNALS)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_file_with_a_formula_loads_again_to_the_same_model(tmp_path: Path) -> None:
    model = with_custom("k*sin(3*q_j)", k=0.08)
    save_model(model, tmp_path / "a.toml")
    assert load_tendon_sheath(tmp_path / "a.toml").effects == model.effects


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"expression": "k*q_i", "k": 1.0}, "'q_i' is neither a signal nor a parameter"),
        ({"expression": "k*q_j", "k": "much"}, "allowed is a number"),
        ({"expression": "tau", "tau": 1.0}, "is a signal or a function already"),
        ({"expression": 3.0}, "a formula in quotes"),
        ({"expression": "q_j", "stage": "both"}, '"joint" or "motor"'),
        ({}, "key 'expression' is missing"),
    ],
)
def test_what_is_wrong_with_the_table_is_one_line(table: dict[str, object], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        BASE.with_effects({"custom": table})  # type: ignore[dict-item]


def test_a_column_that_the_formula_needs_is_named() -> None:
    with pytest.raises(UsageError, match="needs column temperature"):
        predict(with_custom("0.01*(temperature - 25)"), SIGNALS)


def test_a_formula_without_a_value_is_said_with_its_place() -> None:
    with pytest.raises(UsageError, match="has no finite value at tau"):
        predict(with_custom("1/(omega_j - omega_j)"), SIGNALS)


@pytest.mark.parametrize("expression", ["1.5*tau", "0.2*sin(40*tau)", "tau*abs(omega_j)"])
def test_a_controller_refuses_what_cannot_be_inverted(expression: str) -> None:
    with pytest.raises(UsageError, match="cannot be inverted"):
        Feedforward(with_custom(expression), 1e-3)
