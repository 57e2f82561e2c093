"""How a motor rings on its tendons after reversals, and the slew that does not excite it.

The motor is a damped inertia on a spring, in small steps; the package shares nothing with it.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.control.sliding import R_J, R_M, actuator
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.tune.ringing import Turn, ringing, slew_without_ringing, turn_of

PERIOD = 1e-3  # s
SECONDS = 8.0
SUB_STEPS = 20
LAG = 0.0032  # s, of the velocity
X, PRETENSION = 0.26, 45.0
FRICTION = 2.0 * PRETENSION * R_M * math.tanh(X)  # N*m at the motor
COMPENSATION = 0.95


def rig(frequency: float, slew: float, damping: float = 25.0, noise: float = 5e-3, creep: float = 0.0) -> Dataset:
    """A joint moved at 0.6 Hz; the friction term turns with it at `slew`, and the motor follows the torque.

    frequency in Hz and damping in 1/s of the motor on its tendons (0 Hz: it follows at once); creep: N*m at the joint
    that fade after each reversal, as presliding does.
    """
    rng = np.random.default_rng(3)
    t = PERIOD * np.arange(round(SECONDS / PERIOD))
    omega = 1.2 * np.cos(2.0 * np.pi * 0.6 * t)
    sigma = np.sign(omega)
    term, level = np.zeros(t.size), 0.0
    for n, wanted in enumerate(
        COMPENSATION * FRICTION * np.sign(np.cos(2.0 * np.pi * 0.6 * (t + 0.5 * FRICTION / slew)))
    ):
        level += min(max(wanted - level, -slew * PERIOD), slew * PERIOD)
        term[n] = level
    tau_m = 0.2 * np.sin(2.0 * np.pi * 0.23 * t) + term
    pulled = tau_m
    if frequency > 0.0:
        pulled = swinging(tau_m, 2.0 * math.pi * frequency, damping)
    x = X * sigma
    tau_j = R_J * (pulled / R_M * np.cosh(x) - 2.0 * PRETENSION * np.sinh(x))
    since = np.mod(t - 0.25 / 0.6, 0.5 / 0.6)
    tau_j += creep * sigma * np.exp(-since / 0.03)
    lagged = 1.2 * np.cos(2.0 * np.pi * 0.6 * (t - LAG))
    columns = {
        "t": t,
        "tau_m": tau_m + rng.normal(0.0, 2e-3, t.size),
        "tau_j": tau_j + rng.normal(0.0, noise, t.size),
        "omega_j": lagged,
    }
    return Dataset.from_arrays(columns, "rig")


def swinging(torque: np.ndarray, w: float, damping: float) -> np.ndarray:
    """What a damped inertia on a spring (rad/s, 1/s) hands on of a torque, in the same unit."""
    place, speed, found = float(torque[0]), 0.0, np.empty(torque.size)
    step = PERIOD / SUB_STEPS
    for n, wanted in enumerate(torque.tolist()):
        for _ in range(SUB_STEPS):
            speed += step * (w * w * (wanted - place) - 2.0 * damping * speed)
            place += step * speed
        found[n] = place
    return found


@pytest.mark.parametrize("frequency", [43.0, 97.7, 160.0])
def test_the_frequency_of_the_ringing_is_found(frequency: float) -> None:
    found = ringing([rig(frequency, 250.0)], actuator(), 2.0 * FRICTION / 250.0)
    assert found is not None
    assert found.value == pytest.approx(frequency, rel=0.02)
    assert found.low < found.value < found.high
    assert found.high - found.low < 0.05 * frequency


@pytest.mark.parametrize("creep", [0.0, 0.1])
def test_a_motor_that_follows_at_once_rings_at_nothing(creep: float) -> None:
    assert ringing([rig(0.0, 250.0, creep=creep)], actuator(), 2.0 * FRICTION / 250.0) is None


def test_too_few_reversals_say_nothing() -> None:
    log = rig(97.7, 250.0)
    few = Dataset.from_arrays({name: log[name][:3000] for name in ("t", "tau_m", "tau_j", "omega_j")}, "few")
    assert ringing([few], actuator(), 2.0 * FRICTION / 250.0) is None


def test_a_turn_within_one_period_leaves_next_to_nothing_of_the_ringing() -> None:
    frequency, given = 97.7, 200.0
    turn = turn_of(actuator(), COMPENSATION)
    assert turn == pytest.approx(2.0 * COMPENSATION * FRICTION, rel=0.02)
    found = ringing([rig(frequency, given)], actuator(), turn / given)
    assert found is not None
    slew = slew_without_ringing(turn, found.value, 1000.0)
    assert swing(frequency, slew) < 0.15 * swing(frequency, given)


def swing(frequency: float, slew: float) -> float:
    """RMS (N*m) of what is left 15 to 45 ms after the reversals, without noise, but for its mean."""
    log = rig(frequency, slew, noise=0.0)
    still = rig(0.0, slew, noise=0.0)
    since = np.mod(log["t"] - 0.25 / 0.6, 0.5 / 0.6)
    part = (since > 0.015) & (since < 0.045) & (log["t"] > 0.5)
    return float(np.std((log["tau_j"] - still["tau_j"])[part]))


def test_the_slew_stays_within_the_limiters_rate() -> None:
    assert slew_without_ringing(0.9, 100.0, 200.0) == 90.0
    assert slew_without_ringing(0.9, 400.0, 200.0) == 200.0


def test_a_slew_that_does_no_better_is_said_not_to_be_taken() -> None:
    rings = ringing([rig(97.7, 250.0)], actuator(), 2.0 * FRICTION / 250.0)
    assert rings is not None
    taken, left = Turn(120.0, 86.0, rings, 0.06, 0.05), Turn(120.0, 86.0, rings, 0.05, 0.06)
    assert taken.better
    assert taken.note.endswith(": taken")
    assert not left.better
    assert left.note.endswith(": not taken")
    assert taken.interval().low < 86.0 < taken.interval().high
