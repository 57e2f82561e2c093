"""A large cause that no short log separates from slow noise, but all logs together do.

No code of the package makes the logs.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tsa_ctrl.identify.dataset import load_logs
from tsa_ctrl.identify.diagnosis import diagnose
from tsa_ctrl.identify.diagnosis.residual.changes import drift
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.model.parameters import RigidDrive, load_model

RATE, SECONDS = 190.0, 6.0
GRAVITY = 0.65  # N*m
DRIVE = RigidDrive(inertia=0.006, coulomb_friction=0.02, viscous_friction=0.01)

Columns = dict[str, NDArray[np.float64]]


def pendulum(seed: int, gravity: float) -> Columns:
    """Return six seconds of a hobby servo with a pendulum.

    It makes one slow and one faster swing, and its friction grows with its load.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(round(RATE * SECONDS)) / RATE
    slow, fast = rng.uniform(0.12, 0.3), rng.uniform(0.5, 1.0)
    low, high = rng.uniform(0.8, 1.6), rng.uniform(0.05, 0.2)
    w, v = 2.0 * np.pi * slow, 2.0 * np.pi * fast
    q = low * np.sin(w * t) + high * np.sin(v * t + 1.0)
    omega = low * w * np.cos(w * t) + high * v * np.cos(v * t + 1.0)
    acceleration = -low * w**2 * np.sin(w * t) - high * v**2 * np.sin(v * t + 1.0)
    load = gravity * np.sin(q)
    friction = (0.05 + 0.25 * np.abs(load)) * np.tanh(omega / 0.05)
    drift = np.cumsum(rng.normal(0.0, 0.004, len(t)))
    tau = 0.0035 * acceleration + friction + load + drift + rng.normal(0.0, 0.02, len(t))
    return {"t": t, "tau_m": tau, "q_m": q, "omega_m": omega + rng.normal(0.0, 0.02, len(t))}


def logs(gravity: float) -> dict[str, Columns]:
    return {f"{number}.csv": pendulum(number, gravity) for number in range(4)}


@pytest.mark.slow
def test_gravity_is_named_from_many_short_logs() -> None:
    found = diagnose(logs(GRAVITY), DRIVE)
    named = [name for cause in found.causes for name in (cause.effect, *cause.alternatives)]
    assert "gravity_load" in named
    # these explain the error far worse
    assert not {"torque_offset", "direction_asymmetric_friction", "parameter_error"} & set(named)
    assert found.rms.recalibrated is not None
    assert found.rms.extended is not None
    assert found.rms.extended < 0.6 * found.rms.recalibrated


@pytest.mark.slow
def test_the_measured_servo_has_its_published_gravity(data_dir: Path) -> None:
    """Six logs of 6 s give 0.64 to 0.67 N*m by least squares. No single log separates it from slow noise."""
    files = sorted((data_dir / "bam").glob("*.csv.gz"))
    if not files:
        pytest.skip("the measured data here have no bam")
    found = diagnose(load_logs(files), load_model(data_dir / "bam" / "xl330.toml"))
    cause = next(cause for cause in found.causes if cause.effect == "gravity_load")
    amplitude = cause.parameters["amplitude"]
    assert isinstance(amplitude, Quantity)
    assert amplitude.low < 0.64
    assert amplitude.high > 0.67
    assert found.rms.recalibrated is not None
    assert found.rms.extended is not None
    assert found.rms.extended < 0.5 * found.rms.recalibrated


@pytest.mark.slow
def test_a_program_that_begins_alike_in_each_log_does_not_put_a_clock_in_the_place_of_an_offset(data_dir: Path) -> None:
    """The drive rests half of the time.

    A step in time with a dead zone would leave 0.6 of the mean square of the error.
    """
    files = sorted((data_dir / "epos" / "start_stop").glob("*.csv.gz"))
    if not files:
        pytest.skip("the measured data here have no epos/start_stop")
    found = diagnose(load_logs(files), load_model(data_dir / "epos" / "drive.toml"))
    assert [(cause.effect, cause.alternatives) for cause in found.causes] == [("torque_offset", ())]
    assert found.rms.recalibrated is not None
    assert found.rms.extended is not None
    assert found.rms.extended < 0.7 * found.rms.recalibrated


@pytest.mark.slow
def test_no_gravity_is_named_where_there_is_none() -> None:
    found = diagnose(logs(0.0), DRIVE)
    assert "gravity_load" not in [name for cause in found.causes for name in (cause.effect, *cause.alternatives)]


def test_a_drift_is_no_more_than_all_of_what_is_left() -> None:
    t = np.arange(6000) * 8e-3
    wander = 0.5 * np.sin(2.0 * np.pi * 0.06 * t) + np.random.default_rng(2).normal(0.0, 0.01, len(t))
    found = drift(wander, np.ones(len(t), dtype=np.bool_), [slice(0, len(t))], 8e-3, 0.01)
    assert found.found
    assert 0.9 < found.share <= 1.0


@pytest.mark.filterwarnings("error")
def test_a_log_that_leaves_nothing_has_no_drift() -> None:
    assert not drift(np.zeros(6000), np.ones(6000, dtype=np.bool_), [slice(0, 6000)], 8e-3, 0.01).found


def test_a_refusal_names_the_measured_quantity_its_value_and_what_is_needed() -> None:
    t = np.arange(4000) * 5e-3
    noise = np.random.default_rng(1).normal(0.0, 0.05, len(t))
    still = {"t": t, "tau_m": np.sin(t), "omega_m": 1e-3 * np.cos(t) + noise}
    assert re.search(
        r"its speed stands 6 times out of the velocity's noise of [\d.]+ rad/s in 0.0% of the time, [\d.]+% are needed",
        diagnose({"still.csv": still}, DRIVE).sentence,
    )


@pytest.mark.slow
def test_one_level_of_load_is_refused_in_a_sentence_that_is_read_at_once(data_dir: Path) -> None:
    """The first sentence has at most 35 words. The log is a trial of the measured cable drive under one load."""
    folder = data_dir / "davinci"
    logs = load_logs([folder / "load050_0.3Hz.csv.gz"])
    sentence = diagnose(logs, load_model(folder / "actuator.toml")).sentence
    assert "rests on one level" in sentence
    assert len(sentence.split(". ")[0].split()) <= 35


def test_the_share_of_a_drift_refers_to_the_residual() -> None:
    """A drift with a tenth of the mean square has the share 0.1, even if it exceeds the noise."""
    t = np.arange(6000) * 8e-3
    residual = 0.1 * np.sin(2.0 * np.pi * 1.7 * t) + 0.033 * np.sin(2.0 * np.pi * t / 40.0)
    residual += 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    found = drift(residual, np.ones(6000, dtype=np.bool_), [slice(0, 6000)], 8e-3, 1e-3)
    assert 0.05 < found.shown < 0.15
