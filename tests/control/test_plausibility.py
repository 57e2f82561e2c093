"""Contradictions between command, drive, joint and model are found in time, and agreement accuses nothing."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsa_ctrl.control.plausibility import Plausibility, PlausibilitySettings

PERIOD = 0.002  # s
RADII = (0.020, 0.025)  # m
MODEL = (0.26, 45.0)
NO_SENSOR = math.nan


class Motion:
    """A joint that swings and a motor that follows it, with a torque that follows the command; lies are switched on."""

    def __init__(self, has_encoder: bool = True, **settings: float) -> None:
        chosen = PlausibilitySettings(**settings)  # type: ignore[arg-type]
        self.check = Plausibility(chosen, 2.0, 1.0, RADII, has_encoder)
        self.time = 0.0
        self.offset = 0.0  # rad of the motor
        self.stuck: tuple[float, float, float] | None = None
        self.torque: float | None = None  # N*m that the drive reports
        self.tau_j = NO_SENSOR

    def command(self) -> float:
        return 0.6 + 0.4 * math.sin(4.0 * self.time)

    def step(self) -> str | None:
        self.time += PERIOD
        q_j, omega = 0.5 * math.sin(4.0 * self.time), 2.0 * math.cos(4.0 * self.time)
        torque = self.command() if self.torque is None else self.torque
        feedback = self.stuck or (torque, 1.25 * q_j + self.offset, 1.25 * omega)
        return self.check.update(self.time, self.command(), feedback, q_j, math.copysign(1.0, omega), self.tau_j, MODEL)

    def run(self, seconds: float) -> tuple[float, str] | None:
        """When it was noticed, s from now, and the words; None within `seconds`."""
        start = self.time
        while self.time < start + seconds:
            wrong = self.step()
            if wrong is not None:
                return self.time - start, wrong
        return None


def predicted(torque: float, sigma: float) -> float:
    x, t_p = MODEL
    return 0.025 * (torque / 0.020 * math.cosh(sigma * x) - 2.0 * t_p * math.sinh(sigma * x))


def test_agreement_is_no_contradiction() -> None:
    assert Motion().run(5.0) is None


def test_frozen_feedback_is_noticed_once_the_command_moved_by_a_twentieth() -> None:
    motion = Motion()
    motion.run(1.0)
    motion.stuck = (motion.command(), 1.25 * 0.5 * math.sin(4.0 * motion.time), 0.2)
    found = motion.run(1.0)
    assert found is not None
    assert "frozen" in found[1]
    assert 0.03 < found[0] < 0.3


def test_a_drive_at_rest_with_a_resting_command_is_not_frozen() -> None:
    check = Plausibility(PlausibilitySettings(), 2.0, 1.0, RADII, True)
    assert all(
        check.update(n * PERIOD, 0.5 + 0.02 * (n % 2), (0.5, 0.0, 0.0), 0.0, 0.0, NO_SENSOR, MODEL) is None
        for n in range(2000)
    )


@pytest.mark.parametrize(("torque", "noticed"), [(0.0, True), (-1.0, True), (0.55, False)])
def test_a_torque_that_does_not_follow_is_noticed(torque: float, noticed: bool) -> None:
    """A quarter of the limit (0.5 N*m) for 0.1 s; less is a matter of calibration."""
    motion = Motion()
    motion.torque = torque
    found = motion.run(2.0)
    assert (found is not None) is noticed
    if found is not None:
        assert found[0] >= 0.1
        assert "commanded are" in found[1]


def test_a_short_torque_error_is_the_current_loop_s_lag() -> None:
    motion = Motion()
    for _ in range(20):
        motion.torque = -1.0
        assert motion.run(0.09) is None
        motion.torque = None
        assert motion.run(0.01) is None


@pytest.mark.parametrize(("offset", "noticed"), [(0.45, False), (0.55, True), (-0.55, True)])
def test_motor_and_joint_that_move_apart_are_noticed(offset: float, noticed: bool) -> None:
    motion = Motion()
    motion.run(0.5)
    motion.offset = offset
    found = motion.run(0.5)
    assert (found is not None) is noticed
    if found is not None:
        assert found[0] < 0.03
        assert "moved apart" in found[1]


def test_where_they_stood_at_the_enable_does_not_matter() -> None:
    motion = Motion()
    motion.offset = 30.0
    assert motion.run(1.0) is None
    motion.check.reset()
    motion.offset = -30.0
    assert motion.run(1.0) is None


def test_without_an_encoder_nothing_moves_apart() -> None:
    motion = Motion(has_encoder=False)
    motion.run(0.5)
    motion.offset = 3.0
    assert motion.run(0.5) is None


def test_a_reversed_joint_torque_is_noticed_and_the_model_s_is_not() -> None:
    motion = Motion()
    for sign, noticed in ((1.0, False), (-1.0, True)):
        motion.check.reset()
        found = None
        for _ in range(1000):
            sigma = math.copysign(1.0, math.cos(4.0 * (motion.time + PERIOD)))
            motion.tau_j = predicted(sign * (0.6 + 0.4 * math.sin(4.0 * (motion.time + PERIOD))), sigma)
            found = found or motion.step()
        assert (found is not None) is noticed
        assert found is None or "joint torque sensor" in found


@given(st.floats(0.0, 3.2), st.floats(0.0, 3.2))
def test_no_parameter_error_of_half_is_a_contradiction(x_share: float, t_share: float) -> None:
    """Friction angle and pretension anywhere from nothing to 1.5 times nominal: calibration, not a lie."""
    x, t_p = MODEL[0] * min(x_share, 1.5), MODEL[1] * min(t_share, 1.5)
    check = Plausibility(PlausibilitySettings(), 2.0, 1.0, RADII, True)
    for n in range(200):
        torque = 0.6 + 0.4 * math.sin(0.05 * n)
        tau_j = 0.025 * (torque / 0.020 * math.cosh(x) - 2.0 * t_p * math.sinh(x))
        assert check.update(n * PERIOD, torque, (torque, 0.0, 0.0), 0.0, 1.0, tau_j, MODEL) is None


def test_a_reset_forgets_what_was_pending() -> None:
    motion = Motion()
    motion.torque = -1.0
    assert motion.run(0.09) is None
    motion.check.reset()
    assert motion.run(0.09) is None
