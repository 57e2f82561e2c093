"""Test the damping of the motor's oscillation on its tendons by a delayed torque, and its gain margin."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tsa_ctrl.control.damping import Damping
from tsa_ctrl.control.law_design import LAG, LEAST, SHARE, gain_margin, is_stable_at_rest, largest_gain

PERIOD = 1e-3
K = 40.0  # N*m/rad
GEARING = 1.25


def swing(gain: float, inertia: float, delay: int, foretold: bool = True, stiffness: float = K) -> np.ndarray:
    """Return the motor angle (rad) once per period after a push with a locked joint, (400,).

    The oscillation is integrated independently in steps of 10 us.
    """
    total = (delay + 0.5) * PERIOD + LAG
    damping = Damping(gain, math.sqrt(K / inertia), total if foretold else 0.0, GEARING, PERIOD)
    q, omega, torque = 0.0, 1.0, 0.0
    sent = [0.0] * delay
    step = 1e-5
    found = []
    for _ in range(400):
        sent.append(damping.update(0.0, q, omega, 0.0, 0.0))
        command = sent.pop(0)
        found.append(q)
        for _ in range(round(PERIOD / step)):
            torque += (command - torque) * step / LAG
            omega += (torque - stiffness * q) / inertia * step
            q += omega * step
    return np.array(found)


@pytest.mark.parametrize("delay", [1, 3])
@pytest.mark.parametrize("inertia", [3e-5, 6e-4])
def test_a_swing_dies(inertia: float, delay: int) -> None:
    """With the largest allowed gain, less than a tenth remains after eight periods. A free oscillation persists."""
    gain = largest_gain(inertia, K, (delay + 0.5) * PERIOD + LAG, PERIOD)
    q = swing(gain, inertia, delay)
    ringing = 2.0 * math.pi * math.sqrt(inertia / K)
    late = slice(round(8.0 * ringing / PERIOD), None)
    damped, free = np.abs(np.diff(q)), np.abs(np.diff(swing(0.0, inertia, delay)))
    assert damped[late].max() < 0.1 * damped[:20].max()
    assert free[late].max() > 0.9 * free[:20].max()


def test_not_foretold_the_same_gain_drives_it() -> None:
    """A gain of 0.05 N*m*s/rad with one period of delay is stable only if the motion is predicted."""
    plain, foretold = swing(0.05, 1e-4, 1, foretold=False), swing(0.05, 1e-4, 1)
    assert np.abs(plain[-50:]).max() > 10.0 * np.abs(plain[:20]).max()
    assert np.abs(foretold[-50:]).max() < 0.05 * np.abs(foretold[:20]).max()


@pytest.mark.parametrize("delay", [1, 3])
@pytest.mark.parametrize("inertia", [3e-5, 6e-4])
def test_margin_is_where_the_swing_begins_to_grow(inertia: float, delay: int) -> None:
    """At 0.9 times the margin, all three stiffnesses are stable. At 1.1 times the margin, at least one is unstable."""
    total = (delay + 0.5) * PERIOD + LAG
    gain = SHARE * math.sqrt(K * inertia)
    margin = gain_margin(gain, inertia, K, total, PERIOD)

    def grows(factor: float) -> bool:
        courses = [swing(factor * gain, inertia, delay, stiffness=share * K) for share in (0.8, 1.0, 1.25)]
        return any(np.abs(q[-100:]).max() > np.abs(q[150:250]).max() > 1e-9 for q in courses)

    assert not grows(0.9 * margin)
    assert grows(1.1 * margin)


@pytest.mark.parametrize(("inertia", "delay", "damps"), [(6e-4, 1, True), (6e-4, 3, True), (1e-4, 3, False)])
def test_a_resting_joint_is_damped_unless_the_swing_grows_by_more_than_a_fifth_in_a_period(
    inertia: float, delay: int, damps: bool
) -> None:
    """Friction locks a tendon at its first bend, here after 62, 40 or 20 % of the length."""
    total = (delay + 0.5) * PERIOD + LAG
    gain = largest_gain(inertia, K, total, PERIOD)
    growth = []  # 1, in one period of the oscillation
    for share in (0.62, 0.4, 0.2):
        q = np.abs(swing(gain, inertia, delay, stiffness=K / share))
        periods = 0.2 / (2.0 * math.pi * math.sqrt(inertia * share / K))
        growth.append((q[300:].max() / q[100:200].max()) ** (1.0 / periods))
    assert is_stable_at_rest(gain, inertia, K, total, PERIOD) is damps
    assert bool(max(growth) <= 1.2) is damps


def test_the_gain_keeps_the_margin_and_goes_where_there_is_none() -> None:
    gains = [largest_gain(1e-4, K, late * PERIOD, PERIOD) for late in (2.0, 6.0, 40.0)]
    assert gains[0] == pytest.approx(SHARE * math.sqrt(K * 1e-4))
    assert 0.0 < gains[1] < gains[0]
    assert gains[2] == 0.0
    for late, gain in zip((2.0, 6.0), gains, strict=False):
        assert gain_margin(gain, 1e-4, K, late * PERIOD, PERIOD) >= 0.999 * LEAST


def test_a_swing_that_is_planned_is_none() -> None:
    """The damping does not act on a motor that follows the plan with the delay of the command."""
    delay = 2e-3
    damping = Damping(0.02, 632.0, delay, GEARING, PERIOD)
    torques = []
    for n in range(400):
        t = n * PERIOD
        stretch, speed = 0.01 * math.sin(20.0 * t), 0.2 * math.cos(20.0 * t)
        planned = 0.01 * math.sin(20.0 * (t + delay))
        q_j, omega_j = math.sin(3.0 * t), 3.0 * math.cos(3.0 * t)
        torques.append(damping.update(planned, stretch + GEARING * q_j, speed + GEARING * omega_j, q_j, omega_j))
    assert np.abs(torques[10:]).max() < 0.02 * 0.2 * 0.05


def test_a_zero_of_the_encoders_and_a_missing_value_do_no_harm() -> None:
    damping = Damping(0.02, 632.0, 2e-3, GEARING, PERIOD)
    torques = [damping.update(0.0, 0.7, 0.0, 0.1, 0.0) for _ in range(50)]
    assert np.abs(torques).max() == 0.0
    assert damping.update(0.0, math.nan, 0.0, 0.1, 0.0) == 0.0


def test_the_guard_takes_its_share_of_it() -> None:
    """The torque is proportional to the share that the guard permits."""
    whole, half, none = (Damping(0.02, 600.0, 2e-3, GEARING, PERIOD) for _ in range(3))
    half.share, none.share = 0.5, 0.0
    for n in range(20):
        motion = (0.0, 1e-3 * n, 0.3 * n, 0.0, 0.0)
        torque = whole.update(*motion)
        assert half.update(*motion) == pytest.approx(0.5 * torque)
        assert none.update(*motion) == 0.0
    assert torque != 0.0


@pytest.mark.parametrize("cut", [0.5, 0.0])
def test_a_plan_that_a_limit_cut_asks_for_no_torque(cut: float) -> None:
    """If a limit reduces the torque, the plan is reduced as well, so the damping torque stays small."""
    corrected, uncorrected = (Damping(0.02, 632.0, 2.0 * PERIOD, GEARING, PERIOD) for _ in range(2))
    torques = []
    for n in range(100):
        planned = 0.01 * math.sin(30.0 * n * PERIOD)
        late = 30.0 * (n - 2) * PERIOD
        motor = (cut * 0.01 * math.sin(late), cut * 0.3 * math.cos(late), 0.0, 0.0)
        torques.append([damping.update(planned, *motor) for damping in (corrected, uncorrected)])
        corrected.replace_plan(cut * planned)
    with_it, without = np.abs(torques[10:]).max(axis=0)
    assert with_it < 0.1 * without
