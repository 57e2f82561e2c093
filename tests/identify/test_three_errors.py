"""The three reported errors on synthetic signals: known noise, a pulse in each reversal, and an error that depends on a
signal.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.conftest import ROOT
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.diagnosis.data.prepare import prepare
from tsa_ctrl.identify.diagnosis.residual.flatness import not_flat
from tsa_ctrl.identify.three_errors import three_errors
from tsa_ctrl.model.parameters import load_model

NOISE = 4e-3  # N*m
PERIOD = 2e-3  # s
T = np.arange(0.0, 30.0, PERIOD)
OMEGA = 1.5 * np.cos(2.0 * np.pi * 0.4 * T)


def log(torque: np.ndarray) -> Dataset:
    tau_m = 0.4 * np.sin(2.0 * np.pi * 0.17 * T) + 0.1
    tau_j = 1.3 * tau_m - 0.3 * np.sign(OMEGA) + torque
    return Dataset.from_arrays({"t": T, "tau_m": tau_m, "omega_j": OMEGA, "tau_j": tau_j}, "by hand")


def noise(seed: int) -> np.ndarray:
    """Return white noise plus an equal amount of noise with a memory of 10 ms, (n,)."""
    rng = np.random.default_rng(seed)
    slow = np.convolve(rng.standard_normal(len(T) + 100), np.exp(-PERIOD / 0.010 * np.arange(101)), "valid")
    out = rng.standard_normal(len(T)) + slow / slow.std()
    return np.asarray(NOISE * out / out.std())


@pytest.mark.parametrize("seed", range(5))
def test_noise_is_told_whatever_the_model_misses(seed: int) -> None:
    missed = 0.05 * np.sin(3.0 * np.cumsum(OMEGA) * PERIOD)
    found = three_errors([log(noise(seed) + missed)], [missed + noise(seed)], "tau_j")
    assert found.sensor_noise == pytest.approx(NOISE, rel=0.25)
    assert found.sliding is not None
    assert found.sliding > 5.0 * NOISE


def test_friction_that_follows_another_joint_is_no_noise() -> None:
    """The estimate was three times the noise."""
    hip = 0.5 * np.sin(2.0 * np.pi * 0.9 * T)
    missed = 0.1 * hip * np.sign(OMEGA)
    columns = {name: log(noise(0) + missed)[name] for name in ("t", "tau_m", "omega_j", "tau_j")}
    moving = Dataset.from_arrays({**columns, "q_j.hip": hip}, "by hand")
    found = three_errors([moving], [missed + noise(0)], "tau_j")
    assert found.sensor_noise == pytest.approx(NOISE, rel=0.25)


@pytest.mark.parametrize("seed", range(3))
def test_a_burst_after_each_reversal_is_no_noise(seed: int) -> None:
    """The torque is lost for 60 ms of motion after each reversal, as by a backlash."""
    turns = np.flatnonzero(np.diff(np.sign(OMEGA)))
    missed = np.zeros(len(T))
    missed[np.minimum(np.add.outer(turns, np.arange(60)), len(T) - 1).ravel()] = 10.0 * NOISE
    found = three_errors([log(noise(seed) + missed)], [noise(seed) + missed], "tau_j")
    assert found.sensor_noise == pytest.approx(NOISE, rel=0.25)


def test_a_pulse_in_each_reversal_is_no_error_of_sliding() -> None:
    turns = np.flatnonzero(np.diff(np.sign(OMEGA)))
    pulse = np.zeros(len(T))
    pulse[np.add.outer(turns, np.arange(-4, 5)).ravel()] = 0.6
    found = three_errors([log(noise(1))], [noise(1) + pulse], "tau_j")
    assert found.sliding == pytest.approx(NOISE, rel=0.05)
    assert found.reversals is not None
    assert found.reversals > 0.3


def test_a_log_without_motion_has_no_error_of_sliding() -> None:
    still = Dataset.from_arrays({"t": T, "tau_m": 0.1 + noise(2), "omega_j": 0.0 * T, "tau_j": noise(3)}, "at rest")
    found = three_errors([still], [noise(3)], "tau_j")
    assert (found.sliding, found.sensor_noise) == (None, None)
    assert found.reversals == pytest.approx(NOISE, rel=0.01)


@pytest.mark.parametrize(("shape", "signal"), [("time", "the time"), ("angle", "the joint angle"), ("none", None)])
def test_an_error_that_is_not_flat_is_seen(shape: str, signal: str | None) -> None:
    nominal = load_model(ROOT / "config" / "actuator.toml")
    missed = {"time": T / 10.0 - 1.5, "angle": np.sin(3.0 * np.cumsum(OMEGA) * PERIOD), "none": 0.0 * T}[shape]
    residual = noise(4) + 3.0 * NOISE * missed
    found = not_flat(prepare([log(residual)], nominal), [residual], NOISE)
    assert (found and found.what) == signal
