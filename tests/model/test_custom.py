"""[effects.custom]: a formula of the model file in simulation and inverse. Formulas without an inverse are rejected."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from tests.blind.memory import bristle, first_order_lag
from tests.model.actuator import ACTUATOR
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.feedforward import Feedforward
from tsa_ctrl.model.functions import BLOCK
from tsa_ctrl.model.parameters import RigidDrive, TendonSheath, load_tendon_sheath, save_model
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
        ({"expression": "lag(tau, lag)", "lag": 1.0}, "is a signal or a function already"),
        ({"expression": "lag(tau, T)", "T": -1.0}, r"'lag\(tau, T\)': T = -1; allowed is 1e-06 to 1e\+06 s"),
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


@pytest.mark.parametrize(
    "expression",
    [
        "1.5*tau",
        "0.2*sin(40*tau)",
        "tau*abs(omega_j)",
        "0.1*dahl(tau, 0.05)",  # its slope is 4 after a reversal
        "tau - 2*lag(tau, 1)*tanh(q_j)",
    ],
)
def test_a_controller_refuses_what_cannot_be_inverted(expression: str) -> None:
    with pytest.raises(UsageError, match="with rising input torque the output torque"):
        Feedforward(with_custom(expression), 1e-3)


@pytest.mark.parametrize(
    ("expression", "said"),
    [
        ("tau - ring(tau, 10, 0.05)", "increases by less than 5 % of the input within 1 ms"),
        ("tau - lag(tau, 0.5)", "increases by less than"),
        ("2*lag(tau, 1)", "does not increase in the steady state"),  # the initial response decays again, to below 0
        ("1.5*dahl(0.01*tau, 1)*lag(tau, 1)", "does not increase|grows without bound"),
        ("3*(lag(tau, 0.1) - lag(tau, 1))", "grows without bound"),  # valid at once and in the end, but not in between
    ],
)
def test_what_an_inverse_with_a_memory_would_run_away_with_is_refused(expression: str, said: str) -> None:
    with pytest.raises(UsageError, match=said) as caught:
        Feedforward(with_custom(expression), 1e-3)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "expression",
    [
        "0.4*(tau - lag(tau, 0.5))",
        "0.9*(tau - ring(tau, 10, 0.05))",
        "0.05*dahl(tau, 0.2) + 0.3*lag(tau, 5)",
        "0.3*lag(abs(omega_j), 2) + 0.2*ring(sigma, 3, 0.3)",  # does not depend on tau
    ],
)
def test_what_has_an_inverse_is_taken(expression: str) -> None:
    Feedforward(with_custom(expression), 1e-3)


MEMORIES = ["0.5*(tau - lag(tau, 0.1))", "0.3*(ring(tau, 8, 0.1) - tau)", "0.04*dahl(tau, 0.2)"]


@pytest.mark.parametrize("stage", ["joint", "motor"])
@pytest.mark.parametrize("expression", MEMORIES)
def test_the_inverse_delivers_what_is_wanted_through_cycles_that_were_lost(expression: str, stage: str) -> None:
    """Other calls of the inverse do not change its memory. Only the cycle's own torque does."""
    model = with_custom(expression, stage=stage).with_effects(
        {"tendon_slack": {}, "custom": {"expression": expression, "stage": stage}}
    )
    lost = np.isin(np.arange(600), [50, 51, 52, 200, 333, 334])
    t = (np.arange(600) * 2e-3)[~lost]
    wanted, omega = 0.5 * np.sin(9.0 * t), 0.4 + 0.2 * np.sin(5.0 * t)
    feedforward = Feedforward(model, 2e-3)

    def play() -> list[float]:
        out = []
        for at, tau, speed in zip(t.tolist(), wanted.tolist(), omega.tolist(), strict=True):
            assert feedforward.update(math.nan, 1.0, speed, t=at) != 0.0  # rejected without a change of the memory
            out.append(feedforward.update(tau, 1.0, speed, t=at))
            feedforward.domain()
        return out

    tau_m = play()
    found = predict(model, Signals(t=t, tau_m=np.array(tau_m), omega_j=omega))
    np.testing.assert_allclose(found, wanted, atol=1e-9)
    feedforward.reset()
    assert play() == tau_m


def test_over_a_log_longer_than_a_block_it_remembers() -> None:
    """`predict` works in blocks, and the memory continues across them."""
    t = np.arange(2 * BLOCK + 100) * 1e-3
    signals = Signals(t=t, tau_m=0.4 * np.sin(0.3 * t), omega_j=np.ones(len(t)))
    plain = predict(BASE, signals)
    found = predict(with_custom("tau - lag(tau, 5)"), signals)
    np.testing.assert_allclose(found, first_order_lag(plain, 1e-3, 5.0), atol=1e-9)
    at_motor = predict(with_custom("tau - lag(tau, 5)", stage="motor"), signals)
    lagged = dataclasses.replace(signals, tau_m=first_order_lag(signals.tau_m, 1e-3, 5.0))
    np.testing.assert_allclose(at_motor, predict(BASE, lagged), atol=1e-9)


@pytest.mark.parametrize("count", [BLOCK, 2 * BLOCK + 100])
def test_over_a_log_longer_than_a_block_a_formula_is_that_of_each_sample(count: int) -> None:
    t = np.arange(count) * 1e-3
    omega, q_j = np.cos(3.0 * t), np.sin(3.0 * t) / 3.0
    signals = Signals(t=t, tau_m=0.4 * np.sin(0.3 * t), omega_j=omega, q_j=q_j, omega_m=omega)
    stiff = BASE.with_effects({"joint_stiffness": {"stiffness": 0.3, "rest_angle": 0.0}})
    custom = {"expression": "0.2*tau*abs(omega_j) + 0.01*t"}
    tendons = predict(BASE, signals)  # tau does not include the torque of the joint's own spring
    taken = 0.2 * tendons * np.abs(omega) + 0.01 * t
    found = predict(stiff.with_effects({**stiff.effects, "custom": custom}), signals)
    np.testing.assert_allclose(predict(stiff, signals) - found, taken, atol=1e-12)
    reduced = dataclasses.replace(signals, tau_m=signals.tau_m * (1.0 - 0.2 * np.abs(omega)) - 0.01 * t)
    at_motor = predict(with_custom(custom["expression"], stage="motor"), signals)
    np.testing.assert_allclose(at_motor, predict(BASE, reduced), atol=1e-12)
    drive = RigidDrive(viscous_friction=0.2)
    added = predict(dataclasses.replace(drive, effects={"custom": {**custom, "stage": "joint"}}), signals)
    np.testing.assert_allclose(added - 0.2 * omega, 0.04 * omega * np.abs(omega) + 0.01 * t, atol=1e-12)


def test_a_plain_drive_remembers_too() -> None:
    """The formula enters as tau_M += f."""
    t = np.arange(500) * 0.01
    signals = Signals(t=t, tau_m=np.zeros(500), omega_j=np.cos(3.0 * t), omega_m=np.cos(3.0 * t))
    drive = RigidDrive(viscous_friction=0.2)
    custom = {"custom": {"expression": "0.1*dahl(omega_j, 0.3)", "stage": "joint"}}
    found = predict(dataclasses.replace(drive, effects=custom), signals) - predict(drive, signals)
    np.testing.assert_allclose(found, 0.1 * bristle(np.cos(3.0 * t), 0.3, 0.0), atol=1e-12)


def test_a_torque_that_is_cut_is_what_is_remembered() -> None:
    """Beyond slack the tendons deliver less than desired, and the memory continues from the delivered torque."""
    model = with_custom("0.5*(tau - lag(tau, 0.3))")
    t = np.arange(400) * 2e-3
    wanted = np.where(t < 0.4, 3.0, 0.3)
    feedforward = Feedforward(model, 2e-3)
    rows = zip(t.tolist(), wanted.tolist(), strict=True)
    tau_m = np.array([feedforward.update(tau, 1.0, 0.5, t=at) for at, tau in rows])
    found = predict(model, Signals(t=t, tau_m=tau_m, omega_j=np.full(400, 0.5)))
    assert np.all(found[t < 0.4] < 2.5)
    np.testing.assert_allclose(found[t >= 0.4], 0.3, atol=1e-9)


def test_an_error_in_a_formula_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    save_model(ACTUATOR, path)
    with path.open("a", encoding="utf-8") as file:
        file.write('\n[effects.custom]\nexpression = "2*speed"\n')
    with pytest.raises(UsageError, match=rf"^{path}: \[effects.custom\] expression: 'speed' is neither"):
        load_tendon_sheath(path)
