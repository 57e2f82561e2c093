"""bench/otherwise: regressions that know no causes, on a drive made here; the split that all of them share."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from tools.bench import otherwise, regressions
from tools.command import Row
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.diagnosis.data.prepare import prepare
from tsa_ctrl.identify.diagnosis.data.split import split
from tsa_ctrl.model.parameters import model_from

NOISE = 0.02


def drive(seconds: float = 12.0, rate: float = 200.0) -> tuple[np.ndarray, np.ndarray]:
    """Angle, velocity, and the torque of friction, drag and a weight with white noise."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    q, omega = np.sin(2.1 * t) + 0.3 * np.sin(5.3 * t), 2.1 * np.cos(2.1 * t) + 1.59 * np.cos(5.3 * t)
    noise = NOISE * np.random.default_rng(1).standard_normal(len(t))
    return np.column_stack([omega, np.sign(omega), q]), 0.3 * np.sign(omega) + 0.1 * omega + 0.5 * q + noise


def test_a_sparse_regression_finds_the_three_terms_and_predicts_what_it_has_not_seen() -> None:
    signals, torque = drive()
    half = len(torque) // 2
    predict = regressions.sparse_regression(signals[:half], torque[:half])
    assert regressions.error(predict, signals[half:], torque[half:]) < 1.1 * NOISE
    size = np.abs(signals).max(axis=0)
    factors = regressions.thresholded(regressions.library(signals / size), torque, 0.1 * float(np.std(torque)))
    assert np.count_nonzero(factors) == 3


@pytest.mark.skipif(importlib.util.find_spec("sklearn") is None, reason="scikit-learn is not installed (extra dev)")
@pytest.mark.slow
@pytest.mark.parametrize("method", ["boosted trees", "small network"])
def test_what_knows_no_causes_beats_a_constant_far(method: str) -> None:
    signals, torque = drive()
    half = len(torque) // 2
    predict = regressions.METHODS[method](signals[:half], torque[:half])
    assert regressions.error(predict, signals[half:], torque[half:]) < 0.35 * float(np.std(torque))


def test_columns_are_chosen_by_what_they_were_not_fitted_on() -> None:
    signals, torque = drive()
    rng = np.random.default_rng(2)
    loose = np.column_stack([signals[:, :2], rng.standard_normal((len(torque), 300))])
    assert regressions.best_by_blocks([signals[:, :2], loose, signals], torque) == 2


def test_the_split_is_that_of_the_diagnosis_at_the_logs_own_rate() -> None:
    signals, torque = drive(60.0)
    t = np.arange(len(torque)) / 200.0
    logs = [Dataset.from_arrays({"t": t, "tau_m": torque, "q_m": signals[:, 2]}, f"log_{k}") for k in range(3)]
    model = model_from({"actuator": {"kind": "rigid_drive", "coulomb_friction": 0.2}}, "drive.toml")
    fit, held = otherwise.masks(split(prepare(logs, model), "log_1"))
    own = len(torque)
    assert len(fit) == len(held) == 3 * own
    assert not (fit & held).any()
    assert not held[:own].any()
    assert not held[2 * own :].any()
    assert held[own : 2 * own].mean() > 0.9


def test_the_table_has_a_line_for_each_method_and_what_was_named() -> None:
    rows: list[Row] = [
        {"set": "emps", "method": method, "rms": 2.5, "seconds": 1.0, "causes": [["torque_offset", "gravity_load"]]}
        for method in otherwise.METHODS
    ]
    rows[0]["rms"] = None  # the diagnosis refused the set
    head, lines = otherwise.table(rows)
    assert lines[0][1] == "refused (1)"
    assert len(head) == 2
    assert [line[0] for line in lines] == [*otherwise.METHODS, "named", "published"]
    assert lines[-2][1] == "torque offset or gravity load"
