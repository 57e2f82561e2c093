"""Test intervals in difficult cases: parameters that depend on few samples, and compensated friction."""

from __future__ import annotations

import pytest

from .test_gate import EACH_CHANGE, SEED, asked, likely

none = pytest.mark.xdist_group("gate none")
single = pytest.mark.xdist_group("gate single")
# Each change only runs the cases of the gate. One log is sufficient to detect an interval that is too wide.
AND_SOAK = pytest.mark.soak


@pytest.mark.slow
@none
@pytest.mark.parametrize(("draws", "fewest"), [(2, 3), pytest.param(5, 8, marks=AND_SOAK)])
def test_a_torque_that_only_compensates_friction_does_not_hide_slope_and_half_loop(draws: int, fewest: int) -> None:
    inside = []
    for seed in range(SEED, SEED + draws):
        inside += list(asked("none", "free", seed).marks.covered.values())
    assert len(inside) >= fewest
    assert likely(sum(inside), len(inside), 0.93), f"{sum(inside)} of {len(inside)}"


@pytest.mark.slow
@single
@pytest.mark.parametrize(
    ("effect", "parameter"),
    [("velocity_lag", "time_constant"), ("backlash", "gap"), ("transport_delay", "delay")],
)
@pytest.mark.parametrize("draws", [1, pytest.param(3, marks=AND_SOAK)])  # one of three intervals may miss the value
def test_moments_and_widths_have_an_interval_that_holds_them(effect: str, parameter: str, draws: int) -> None:
    inside = []
    for seed in range(SEED, SEED + draws):
        answer = asked("single", effect, seed)
        found = [cause for cause in answer.report["causes"] if cause["effect"] == effect]
        truth = answer.effects[effect][parameter]
        for cause in found:
            quantity = cause["parameters"][parameter]
            assert 0.0 < quantity["high"] - quantity["low"] < 0.3 * truth
            inside.append(quantity["low"] <= truth <= quantity["high"])
    assert len(inside) >= draws
    assert likely(sum(inside), len(inside), 0.93, EACH_CHANGE.unlikely), f"{sum(inside)} of {len(inside)}"
