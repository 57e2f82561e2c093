"""Intervals where they are hard: numbers that hang on single moments, and motor torques that compensate friction."""

from __future__ import annotations

import pytest

from .test_gate import SEED, asked, likely

none = pytest.mark.xdist_group("gate none")
single = pytest.mark.xdist_group("gate single")


@pytest.mark.slow
@none
def test_a_torque_that_only_compensates_friction_does_not_hide_slope_and_half_loop() -> None:
    inside = []
    for seed in range(SEED, SEED + 5):
        inside += list(asked("none", "free", seed).marks.covered.values())
    assert len(inside) >= 8
    assert likely(sum(inside), len(inside), 0.93), f"{sum(inside)} of {len(inside)}"


@pytest.mark.slow
@single
@pytest.mark.parametrize(
    ("effect", "parameter"),
    [("velocity_lag", "time_constant"), ("backlash", "gap"), ("transport_delay", "delay")],
)
def test_moments_and_widths_have_an_interval_that_holds_them(effect: str, parameter: str) -> None:
    inside = []
    for seed in range(SEED, SEED + 3):  # one of which may be outside
        answer = asked("single", effect, seed)
        found = [cause for cause in answer.report["causes"] if cause["effect"] == effect]
        truth = answer.effects[effect][parameter]
        for cause in found:
            quantity = cause["parameters"][parameter]
            assert 0.0 < quantity["high"] - quantity["low"] < 0.3 * truth
            inside.append(quantity["low"] <= truth <= quantity["high"])
    assert len(inside) >= 3
    assert likely(sum(inside), len(inside), 0.93), f"{sum(inside)} of {len(inside)}"
