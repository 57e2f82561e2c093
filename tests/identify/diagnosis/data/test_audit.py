"""The audit decides whether logs excite the drive. Sufficient excitation stays sufficient when logs are added."""

from __future__ import annotations

import numpy as np

from tests.model.actuator import ACTUATOR
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.diagnosis.data.audit import Audit, audit
from tsa_ctrl.identify.diagnosis.data.prepare import prepare
from tsa_ctrl.identify.diagnosis.data.split import split

RATE = 200.0


def _log(name: str, speed: float, noise: float, seconds: float = 20.0) -> Dataset:
    rng = np.random.default_rng(len(name))
    t = np.arange(round(seconds * RATE)) / RATE
    omega = speed * np.sin(2.0 * t) + noise * rng.standard_normal(len(t))
    tau_m = np.sin(0.7 * t) + 0.01 * rng.standard_normal(len(t))
    tau_j = 0.8 * tau_m - 0.1 * np.sign(np.sin(2.0 * t)) + 0.01 * rng.standard_normal(len(t))
    return Dataset.from_arrays({"t": t, "tau_m": tau_m, "tau_j": tau_j, "omega_j": omega}, name)


def _audit(*logs: Dataset) -> Audit:
    return audit(split(prepare(logs, ACTUATOR), None).frame)


def test_a_good_log_is_enough() -> None:
    assert _audit(_log("a", 1.0, 0.01)).insufficient == ""


def test_noise_alone_is_not() -> None:
    assert "hardly moves" in _audit(_log("a", 0.002, 0.05)).insufficient


def test_a_noisy_log_more_takes_nothing_from_a_good_one() -> None:
    assert _audit(_log("a", 1.0, 0.01), _log("bb", 1.0, 2.0)).insufficient == ""


def test_ten_still_logs_more_take_nothing_from_a_good_one() -> None:
    still = [_log("b" * n, 0.0, 0.01) for n in range(2, 32)]
    assert _audit(_log("a", 1.0, 0.01), *still).insufficient == ""


def test_a_torque_that_rests_while_the_joint_moves_is_reported() -> None:
    """A disconnected cable holds the last torque value for two seconds."""
    log = _log("a", 1.0, 0.01)
    torque = log["tau_j"].copy()
    torque[1000:1400] = torque[1000]
    loose = Dataset.from_arrays({**{name: log[name] for name in ("t", "tau_m", "omega_j")}, "tau_j": torque}, "loose")
    (said,) = [line for line in _audit(loose).suspicions if "while the joint moves" in line]
    assert "tau_j stays at" in said
    assert "for 2 s from t = 5 s on" in said
    assert not [line for line in _audit(log).suspicions if "while the joint moves" in line]
