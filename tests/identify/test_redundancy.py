"""Redundant columns must agree. The logs come from the equilibrium of two tendons."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable

import numpy as np
import pytest

from tests.blind import tendon_logs
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.admit import admit
from tsa_ctrl.identify.calibrate import calibrate
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.energy import foreign_torque
from tsa_ctrl.identify.redundancy import compare
from tsa_ctrl.model.parameters import TendonSheath, model_from

Columns = dict[str, np.ndarray]
Change = Callable[[Columns], Columns]
SEEDS = range(3)  # one of each profile
RPM, COUNTS = 30.0 / math.pi, 4096 / (2.0 * math.pi)


def rig_log(seed: int) -> tuple[Columns, TendonSheath]:
    """Return a log with every redundant column, and the nominal model of its rig."""
    rng = np.random.default_rng(seed)
    rig = tendon_logs.draw_rig(rng, tendon_logs.PROFILES[seed % 3])
    model = model_from(tomllib.loads(tendon_logs.model_text(rig, rng)), "nominal")
    assert isinstance(model, TendonSheath)
    log = tendon_logs.record(rig, rng, seconds=20.0)
    period = float(log["t"][1] - log["t"][0])
    q = np.concatenate([[0.0], np.cumsum(0.5 * (log["omega_j"][1:] + log["omega_j"][:-1])) * period])
    ratio = model.joint_pulley_radius / model.motor_pulley_radius
    command = log["tau_m"] + rng.normal(0.0, 0.01 * np.std(log["tau_m"]), len(q))
    return {**log, "q_j": q, "q_m": ratio * q, "omega_m": ratio * log["omega_j"], "tau_m_cmd": command}, model


def times(name: str, factor: float) -> Change:
    return lambda log: {**log, name: factor * log[name]}


def shifted(name: str, seconds: float) -> Change:
    return lambda log: {**log, name: np.roll(log[name], round(seconds / (log["t"][1] - log["t"][0])))}


@pytest.mark.parametrize("seed", SEEDS)
def test_a_right_log_is_accepted_without_a_remark(seed: int) -> None:
    log, model = rig_log(seed)
    found = Dataset.from_arrays(log, "log")
    admit(found, model, "tau_j")
    assert [note for note in found.notes if "derived" not in note] == []
    assert foreign_torque(found, model) == ""


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (times("omega_j", RPM), "column q_j and column omega_j disagree: .*omega_j seems to be in rpm"),
        (times("omega_j", 180.0 / math.pi), "omega_j is 180/pi times dq_j/dt; omega_j seems to be in degrees/s"),
        (times("q_j", 180.0 / math.pi), "q_j seems to be in degrees: use rad"),
        (times("q_j", 0.5 / math.pi), "q_j seems to be in revolutions"),
        (times("q_m", COUNTS), "q_m seems to be in counts"),
        (times("omega_j", 25.0), "omega_j seems to be in counts or mm"),
        (times("omega_j", 1.6), "omega_j is 1.6 times dq_j/dt"),
        (times("tau_m_cmd", 100.0), "tau_m_cmd seems to be in N.cm"),
        (times("tau_m_cmd", -1.0), "tau_m runs against tau_m_cmd"),
        (shifted("omega_j", 0.3), "omega_j is (29|30). ms later than dq_j/dt; align"),
    ],
)
def test_two_columns_that_disagree_are_named_with_factor_and_unit(seed: int, change: Change, said: str) -> None:
    log, model = rig_log(seed)
    with pytest.raises(UsageError, match=said):
        admit(Dataset.from_arrays(change(log), "log"), model, "tau_j")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (times("omega_j", 1.05), "column omega_j is 1.050 times dq_j/dt"),
        (shifted("omega_j", 0.05), r"column omega_j is (4|5)[0-9.]* ms later than dq_j/dt"),
    ],
)
def test_a_small_difference_is_a_remark(change: Change, said: str) -> None:
    log, _ = rig_log(0)
    assert any(re.match(said, note) for note in Dataset.from_arrays(change(log), "log").notes)


@pytest.mark.parametrize("seed", SEEDS)
def test_both_ends_in_one_wrong_unit_are_found_by_their_friction(seed: int) -> None:
    """No pair of columns shows the wrong unit, because both torques agree with each other."""
    log, model = rig_log(seed)
    wrong = {name: 30.0 * values if name.startswith("tau") else values for name, values in log.items()}
    with pytest.raises(UsageError, match=r"friction torque .* times the model's, .* times what \[uncertainty\] allows"):
        calibrate([Dataset.from_arrays(wrong, "log")], model)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("names", [("tau_j",), ("tau_m", "tau_m_cmd"), ("omega_j", "q_j", "omega_m", "q_m")])
def test_columns_of_another_run_are_rejected(names: tuple[str, ...], seed: int) -> None:
    (log, model), (other, _) = rig_log(seed), rig_log(seed + 20)
    n = min(len(log["t"]), len(other["t"]))
    mixed = {name: (other if name in names else log)[name][:n] for name in log}
    with pytest.raises(UsageError, match="another log"):
        calibrate([Dataset.from_arrays(mixed, "log")], model)


@pytest.mark.parametrize("seed", SEEDS)
def test_noise_in_place_of_a_torque_is_rejected(seed: int) -> None:
    log, model = rig_log(seed)
    noise = np.random.default_rng(seed).normal(0.0, np.std(log["tau_j"]), len(log["t"]))
    with pytest.raises(UsageError, match="column tau_j is noise"):
        calibrate([Dataset.from_arrays({**log, "tau_j": noise}, "log")], model)


def test_noise_makes_the_range_of_a_scale_wider_and_never_wrong() -> None:
    rng = np.random.default_rng(1)
    x = np.sin(np.arange(4000) * 0.01)
    for noise in (0.01, 0.1, 0.3):
        found = compare(x + noise * rng.normal(size=4000), 2.0 * x + noise * rng.normal(size=4000), 1e-3)
        assert found is not None
        assert 0.998 * found.low < 2.0 < 1.002 * found.high
    assert compare(x, rng.normal(size=4000), 1e-3) is None
