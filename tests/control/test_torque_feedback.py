"""Test the correction by the torque sensor on a locked and on a moving joint, with tendons as a play operator."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tsa_ctrl.control.torque_feedback import CREEP, FAST, LESS, MORE, TorqueFeedback

PERIOD = 1e-3
RATIO = 0.8  # r_M/r_J
LOOP = 0.5  # N*m at the motor, friction torque of the file
TURN = 0.02  # s, duration of a reversal
STROKE = 1.0  # s, time between two reversals


class Rig:
    """A feedforward of `LOOP` on tendons with `true` times this friction. The motor adds `offset` (N*m)."""

    def __init__(self, true: float, offset: float = 0.0, bandwidth: float = 3.0, most: float = MORE) -> None:
        self.feedback = TorqueFeedback(bandwidth, RATIO, PERIOD)
        self.true, self.offset, self.most = true * LOOP, offset, most * LOOP
        self.delivered = 0.0  # N*m, converted to the motor
        self.raised: list[float] = []  # N*m, increase of the friction term by the correction in each cycle

    def run(self, seconds: float, amplitude: float, moving: bool, noise: float = 0.0) -> np.ndarray:
        """Return the error of the joint torque (N*m) over time. A reversal begins every `STROKE` seconds."""
        rng = np.random.default_rng(3)
        errors = []
        for n in range(round(seconds / PERIOD)):
            t = n * PERIOD
            wanted = -amplitude * math.cos(math.pi * t / STROKE)
            way = 1.0 if (t / STROKE) % 2.0 < 1.0 else -1.0
            since = t % STROKE
            force = way * min(1.0, 2.0 * since / TURN - 1.0) if t >= STROKE else way
            turning = t >= STROKE and since < TURN
            correction = self.feedback.torque(force, LOOP, self.most)
            self.raised.append(math.copysign(correction, correction * force))
            command = RATIO * wanted + LOOP * force + correction
            pull = command + self.offset
            if moving:
                self.delivered = pull - way * self.true
            else:  # sticking tendons follow the motor only if their friction is exceeded
                self.delivered = min(max(self.delivered, pull - self.true), pull + self.true)
            error = self.delivered / RATIO - wanted
            errors.append(error)
            measured = error + noise * float(rng.standard_normal())
            if self.feedback.used:
                self.feedback.update(
                    measured,
                    force,
                    turning,
                    moving,
                    False,
                    False,
                    RATIO * wanted,
                    LOOP * force + correction,
                    correction,
                    LOOP,
                )
        return np.array(errors)


def last(errors: np.ndarray) -> float:
    """Return the RMS error (N*m) over the last two strokes, without their reversals."""
    strokes = errors[-round(2 * STROKE / PERIOD) :].reshape(2, -1)[:, round(TURN / PERIOD) :]
    return float(np.sqrt(np.mean(np.square(strokes))))


@pytest.mark.parametrize("true", [0.85, 1.08])
@pytest.mark.parametrize("offset", [-0.01, 0.01])
def test_a_small_signal_arrives_at_a_locked_joint(true: float, offset: float) -> None:
    """For a small set-point of 0.02 N*m, the correction reduces the error to less than half or below 7 mN*m."""
    without = last(Rig(true, offset, bandwidth=0.0).run(8.0, 0.02, False))
    assert last(Rig(true, offset).run(8.0, 0.02, False, noise=0.005)) < 0.5 * max(without, 0.014)


@pytest.mark.parametrize("true", [0.8, 1.09])
@pytest.mark.parametrize("moving", [True, False])
def test_wrong_friction_is_corrected_on_a_large_signal(true: float, moving: bool) -> None:
    without = last(Rig(true, bandwidth=0.0).run(8.0, 0.5, moving))
    assert last(Rig(true).run(8.0, 0.5, moving, noise=0.005)) < 0.4 * without


def test_the_term_is_raised_by_no_more_than_is_proven() -> None:
    for most in (0.03, 0.0):
        rig = Rig(1.2, most=most)
        rig.run(6.0, 0.5, True)
        assert max(rig.raised) == pytest.approx(most * LOOP)


def fed(
    error: float,
    cycles: int = 1000,
    feedback: TorqueFeedback | None = None,
    limited: bool = False,
    moving: bool = True,
) -> TorqueFeedback:
    """Return the feedback after cycles in which the sensor shows `error` (N*m)."""
    found = feedback or TorqueFeedback(3.0, RATIO, PERIOD)
    for _ in range(cycles):
        found.update(error, 1.0, False, moving, False, limited, 0.0, LOOP, 0.0, LOOP)
    return found


@pytest.mark.parametrize(("error", "faster"), [(-0.002, FAST), (-0.01, CREEP * LOOP / (6.0 * math.pi * RATIO * 0.01))])
def test_missing_torque_of_a_resting_joint_is_added_faster_up_to_a_limit(error: float, faster: float) -> None:
    moving, resting = (fed(error, 100, moving=moving).torque(1.0, LOOP, LOOP) for moving in (True, False))
    assert resting / moving == pytest.approx(faster, rel=0.02)
    assert fed(0.01, 100, moving=False).torque(1.0, LOOP, LOOP) == 0.0


def test_a_sensor_that_shows_too_much_takes_back_a_part_only() -> None:
    assert fed(0.05, 20_000).torque(1.0, LOOP, MORE * LOOP) == pytest.approx(-LESS * LOOP)


def test_an_error_too_large_for_friction_does_not_count() -> None:
    assert fed(-1.0).torque(1.0, LOOP, MORE * LOOP) == 0.0


def test_without_its_sensor_the_correction_fades() -> None:
    feedback = fed(-0.05)
    before = feedback.torque(1.0, LOOP, MORE * LOOP)
    assert before > 0.02
    assert abs(fed(math.nan, 2000, feedback).torque(1.0, LOOP, MORE * LOOP)) < 0.01 * before


def test_a_limited_friction_term_is_reduced_but_not_raised() -> None:
    """The limit causes a lack of torque. A correction of it would be too large when the limit ends."""
    assert fed(-0.05, limited=True).torque(1.0, LOOP, MORE * LOOP) == 0.0
    assert fed(0.05, limited=True).torque(1.0, LOOP, MORE * LOOP) < -0.01


def test_a_correction_belongs_to_its_direction() -> None:
    feedback = fed(-0.02)
    assert feedback.torque(1.0, LOOP, MORE * LOOP) > 0.01
    assert feedback.torque(-1.0, LOOP, MORE * LOOP) == 0.0


@pytest.mark.parametrize("offset", [0.0, 0.01])
@pytest.mark.parametrize("true", [0.8, 0.95])
def test_a_fade_in_ends_at_the_friction_of_a_locked_joint(true: float, offset: float) -> None:
    """If the file's friction is too large, the fade-in overshoots. The correction reduces this by more than 70 %."""

    def overshoot(bandwidth: float) -> float:
        feedback, rng, delivered = TorqueFeedback(bandwidth, RATIO, PERIOD), np.random.default_rng(5), 0.0
        for n in range(2000):
            fade = min(1.0, n * PERIOD)
            correction = fade * feedback.torque(1.0, LOOP, 0.0)
            term = fade * LOOP + correction
            delivered = max(delivered, term + offset - true * LOOP)
            if feedback.used:
                measured = delivered / RATIO + 0.005 * float(rng.standard_normal())
                feedback.update(measured, 1.0, False, False, fade < 1.0, False, 0.0, term, correction, LOOP)
        return delivered

    assert overshoot(3.0) < 0.3 * overshoot(0.0)
