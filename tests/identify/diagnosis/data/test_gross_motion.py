"""Frequency band of the motion that friction follows.

The band is full if friction follows the encoder, and narrower otherwise. The torque is synthesised from a separate
friction state along an exactly known motion.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.blind import memory
from tests.model.actuator import ACTUATOR
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.diagnosis.data.audit import audit
from tsa_ctrl.identify.diagnosis.data.gross_motion import along_gross_motion
from tsa_ctrl.identify.diagnosis.data.prepare import narrowed, prepare
from tsa_ctrl.identify.diagnosis.data.split import Split, split

RATE = 500.0  # Hz
SHAKE = 0.006  # rad, at 15 to 25 Hz; the presliding distance is 0.02 rad
COUNT = 2.0 * np.pi / 8192


def _logs(friction_follows_all: bool, logs: int = 4, seconds: float = 12.0) -> list[Dataset]:
    """Return logs of a motor that shakes while it moves.

    Friction follows the whole encoder signal or only the gross motion.
    """
    out = []
    for number in range(logs):
        rng = np.random.default_rng(number)
        t = np.arange(round(seconds * RATE)) / RATE
        gross = 0.3 * np.sin(2.0 * np.pi * (0.3 + 0.1 * number) * t) + 0.1 * np.sin(2.0 * np.pi * 0.77 * t)
        shaken = np.zeros_like(t)
        for frequency in rng.uniform(15.0, 25.0, 5):
            shaken += SHAKE / np.sqrt(5.0) * np.sin(2.0 * np.pi * frequency * t + rng.uniform(0.0, 2.0 * np.pi))
        whole = gross + shaken
        z = memory.bristle(whole if friction_follows_all else gross, 0.02, 1.0)
        tau_m = 0.3 * np.sin(2.0 * np.pi * 0.21 * t + number)
        tau_j = 1.4 * tau_m - 0.1 * z + 0.002 * rng.standard_normal(len(t))
        counted = np.round(whole / COUNT) * COUNT
        out.append(Dataset.from_arrays({"t": t, "tau_m": tau_m, "tau_j": tau_j, "q_j": counted}, f"log_{number}"))
    return out


def _narrowed(logs: list[Dataset]) -> Split:
    return along_gross_motion(split(prepare(logs, ACTUATOR), None), ACTUATOR)


def test_friction_that_does_not_follow_a_shaking_motor_gets_the_motion_below_it() -> None:
    data = _narrowed(_logs(friction_follows_all=False))
    assert 1.0 < data.frame.runs[0].band < 15.0
    assert f"friction follows the motion up to {data.frame.runs[0].band:.2g} Hz" in audit(data.frame).notes[-1]
    turns = np.count_nonzero(np.diff(np.sign(data.frame.runs[0].signals.omega_j)))
    assert turns < 40  # 12 s with about one reversal per second; the shaking alone has 480


def test_friction_that_follows_all_that_the_encoder_shows_keeps_all_of_it() -> None:
    logs = _logs(friction_follows_all=True)
    before = split(prepare(logs, ACTUATOR), None)
    after = _narrowed(logs)
    assert after is before or after.frame.runs[0].band == np.inf
    assert np.array_equal(after.frame.runs[0].signals.omega_j, before.frame.runs[0].signals.omega_j)


def test_logs_that_are_held_out_have_no_say() -> None:
    """Nothing is narrowed if the only log whose friction follows the gross motion is held out."""
    logs = [*_logs(friction_follows_all=True, logs=3), _logs(friction_follows_all=False)[3]]
    data = along_gross_motion(split(prepare(logs, ACTUATOR), "log_3"), ACTUATOR)
    assert data.frame.runs[0].band == np.inf


@pytest.mark.parametrize("band", [5.0, 12.0])
def test_the_acceleration_keeps_its_own_band(band: float) -> None:
    own = prepare(_logs(friction_follows_all=True, logs=1), ACTUATOR)[0]
    below = narrowed(own, band)
    assert np.array_equal(own.full.acceleration, below.full.acceleration)
    assert float(np.std(below.full.omega_j)) < 0.9 * float(np.std(own.full.omega_j))
    assert float(np.mean(below.velocity_error)) != float(np.mean(own.velocity_error))


def test_what_was_recorded_is_not_made_again() -> None:
    log = _logs(friction_follows_all=True, logs=1)[0]
    columns = {name: log[name] for name in ("t", "tau_m", "tau_j", "q_j")}
    recorded = {**columns, "omega_j": np.gradient(log["q_j"], log["t"]), "q_m": 1.3 * log["q_j"]}
    own = prepare([Dataset.from_arrays(recorded, "both")], ACTUATOR)[0]
    below = narrowed(own, 5.0)
    shared = [name for name in ("tau_m", "omega_j", "q_j") if getattr(below.full, name) is getattr(own.full, name)]
    assert shared == ["tau_m", "omega_j", "q_j"]
    assert not np.array_equal(below.signals.omega_m, own.signals.omega_m)
    assert np.array_equal(below.velocity_error, own.velocity_error)
