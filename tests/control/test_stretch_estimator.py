"""Test the estimator kind "stretch": its use of the observer, and its response to an increased wrap angle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from tests.control.sliding import PERIOD, actuator
from tests.virtual.joints import GAIT, play, sine
from tsa_ctrl.control.estimator import EstimateState, Sample
from tsa_ctrl.control.settings import Attribution, EstimatorSettings
from tsa_ctrl.control.stretch_estimator import StretchEstimator
from tsa_ctrl.observer.stretch import StretchObserver, StretchState

X, TENSION = 0.26, 45.0


@dataclass
class Seen:
    """An observer with prescribed results."""

    friction_angle: float = X
    pretension: float = TENSION
    friction_deviation: float = 0.02
    innovation: float = 0.0
    at_bound: bool = False
    state: StretchState = StretchState.ESTIMATED


def estimator(seen: Seen, **settings: Any) -> StretchEstimator:
    return StretchEstimator(
        actuator(), EstimatorSettings(kind="stretch", **settings), cast(StretchObserver, seen), PERIOD
    )


def run(chosen: StretchEstimator, seconds: float, admit: bool = True, turns: float = 0.2) -> None:
    """Run the estimator while the joint moves back and forth, for `turns` s in each direction."""
    for cycle in range(round(seconds / PERIOD)):
        way = 1.0 if cycle * PERIOD % (2.0 * turns) < turns else -1.0
        chosen.update(Sample(way, way, math.nan, 0.0, math.nan, admit))


def test_the_product_goes_where_the_user_says() -> None:
    """If changes are attributed to the pretension, 30 % more friction torque results in 30 % more pretension."""
    chosen = estimator(Seen(friction_angle=math.asinh(1.3 * math.sinh(X))), attribute=Attribution.PRETENSION)
    run(chosen, 5.0)
    assert chosen.state is EstimateState.ESTIMATED
    assert (chosen.friction_angle, chosen.pretension) == pytest.approx((X, 1.3 * TENSION), rel=1e-3)


def half_loop(chosen: StretchEstimator) -> float:
    """Return the friction torque divided by the model file's value."""
    return chosen.pretension * math.sinh(chosen.friction_angle) / (TENSION * math.sinh(X))


@pytest.mark.parametrize("factor", [1.3, 0.7])
def test_one_way_alone_shows_less_friction_but_not_more(factor: float) -> None:
    """During a long motion in one direction, the estimate decreases but does not rise above the file's value.

    A torque error cannot be distinguished from friction in this case.
    """
    chosen = estimator(Seen(factor * X))
    run(chosen, 5.0, turns=10.0)
    assert chosen.state is EstimateState.ESTIMATED
    expected = 1.0 if factor > 1.0 else math.sinh(factor * X) / math.sinh(X)
    assert half_loop(chosen) == pytest.approx(expected, rel=2e-3)


def test_of_two_ways_the_lesser_counts_beyond_the_file() -> None:
    """With 40 % more friction in one direction and 20 % in the other, the estimate exceeds the lower value by 5 %.

    With 40 % in both directions it reaches 40 %.
    """
    seen = Seen()
    chosen = estimator(seen, bounds=1.0)
    for cycle in range(12_000):
        way = 1.0 if cycle // 500 % 2 else -1.0
        seen.friction_angle = (1.4 if way > 0.0 or cycle >= 6000 else 1.2) * X
        chosen.update(Sample(way, way, math.nan, 0.0, math.nan, True))
        if cycle == 5999:
            assert half_loop(chosen) == pytest.approx(1.05 * math.sinh(1.2 * X) / math.sinh(X), rel=2e-3)
    assert half_loop(chosen) == pytest.approx(math.sinh(1.4 * X) / math.sinh(X), rel=2e-3)


def test_less_friction_is_followed_five_times_as_fast_as_more() -> None:
    chosen = estimator(Seen(1.4 * X), attribute=Attribution.FRICTION, rate=0.1)
    run(chosen, 3.0)
    begin = chosen.friction_angle
    chosen._observer = cast(StretchObserver, Seen(0.7 * X))
    run(chosen, 0.5)
    assert begin - chosen.friction_angle == pytest.approx(5.0 * 0.1 * X * 0.5, rel=0.2)


def test_it_moves_no_faster_than_its_rate() -> None:
    chosen = estimator(Seen(friction_angle=1.4 * X), attribute=Attribution.FRICTION, rate=0.1)
    run(chosen, 1.0)
    assert 0.05 * X < chosen.friction_angle - X <= 0.1 * X + 1e-9


@pytest.mark.parametrize(
    "seen",
    [
        Seen(1.4 * X, friction_deviation=0.3),
        Seen(1.4 * X, state=StretchState.UNSLID),
        Seen(1.4 * X, state=StretchState.SLACK),
    ],
    ids=["uncertain", "unslid", "slack"],
)
def test_what_is_not_known_moves_nothing(seen: Seen) -> None:
    chosen = estimator(seen)
    run(chosen, 1.0)
    assert chosen.state is EstimateState.UNESTIMATED
    assert chosen.friction_angle == X


@pytest.mark.parametrize(
    "seen",
    [Seen(3.5 * X), Seen(1.2 * X, innovation=1e-3), Seen(1.2 * X, at_bound=True)],
    ids=["bounds", "residual", "stiffness"],
)
def test_beyond_its_bounds_or_unlike_the_model_is_invalid(seen: Seen) -> None:
    """A value beyond the bounds, a large residual or a stiffness at its bound makes the estimate invalid.

    The friction angle then returns to the model file's value.
    """
    chosen = estimator(Seen(1.2 * X))
    run(chosen, 2.0)
    assert chosen.friction_angle > 1.05 * X
    chosen._observer = cast(StretchObserver, seen)
    run(chosen, 3.0)
    assert chosen.state is EstimateState.INVALID
    assert chosen.friction_angle == pytest.approx(X)


@pytest.mark.parametrize("wrong", [Seen(0.2 * X), Seen(0.7 * X, innovation=1e-3)], ids=["bounds", "residual"])
def test_what_is_invalid_does_not_raise_what_is_compensated(wrong: Seen) -> None:
    """An estimate of less friction is kept when it becomes invalid, because the file's friction may be too high."""
    chosen = estimator(Seen(0.7 * X))
    run(chosen, 2.0)
    before = half_loop(chosen)
    assert before < 0.75
    chosen._observer = cast(StretchObserver, wrong)
    run(chosen, 3.0)
    assert chosen.state is EstimateState.INVALID
    assert half_loop(chosen) == pytest.approx(before, rel=1e-3)


def test_a_torque_sensor_that_contradicts_makes_it_invalid() -> None:
    """If the torque sensor contradicts the estimate, either may be wrong, so the model file's value is used again."""
    wrong = [False]
    settings = EstimatorSettings(kind="stretch", use=True)
    seen = cast(StretchObserver, Seen(1.2 * X))
    chosen = StretchEstimator(actuator(), settings, seen, PERIOD, lambda: wrong[0])
    run(chosen, 2.0)
    assert chosen.state is EstimateState.ESTIMATED
    wrong[0] = True
    run(chosen, 3.0)
    assert chosen.state is EstimateState.INVALID
    assert chosen.friction_angle == pytest.approx(X)


def test_a_reset_is_the_model_file() -> None:
    chosen = estimator(Seen(1.3 * X))
    run(chosen, 2.0)
    chosen.reset()
    assert (chosen.friction_angle, chosen.state) == (X, EstimateState.UNESTIMATED)


def late_error(folder: Path, kind: str, load: str, setpoint: dict[str, Any]) -> float:
    """Return the RMS error of the joint torque (mN*m) from 4.5 to 6.5 s after the wrap angle was increased by 40 %."""
    folder.mkdir()
    bending = [[0.0, 1.0], [1.5, 1.0], [2.5, 1.4]]
    axis = {"estimator": {"kind": kind, "use": kind != "fixed"}}
    result = play(folder, load, setpoint, 9.0, axis=axis, plant={"environment": {"bending": bending}})
    seen, log = result.axes[0], result.log
    late = (log["t"] > 7.0) & (log["t"] < 9.0)
    return 1e3 * float(np.sqrt(np.mean(np.square((seen.delivered - log["tau_j_des"])[late]))))


@pytest.mark.slow
# Each change runs the test of the elongation below and of the sensor in tests/daemon/test_bending_change.py.
@pytest.mark.soak
def test_a_bending_change_is_followed_as_well_as_by_a_torque_sensor(tmp_path: Path) -> None:
    """With a wrap angle that rises by 40 %, the error without a torque sensor is at most 1.5 times the one with it."""
    by_sensor = late_error(tmp_path / "sensor", "sensor", "imposed", GAIT)
    by_stretch = late_error(tmp_path / "stretch", "stretch", "imposed", GAIT)
    assert by_stretch <= 1.5 * by_sensor
    assert by_stretch <= 25.0  # 900 without an estimate


@pytest.mark.slow
def test_it_is_followed_on_a_joint_that_the_torque_moves(tmp_path: Path) -> None:
    assert late_error(tmp_path / "weight", "stretch", "weight", sine(0.5, 0.5)) <= 25.0
