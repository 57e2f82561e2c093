"""Test that nearly indistinguishable effects are detected, so that each random case has one right answer."""

from __future__ import annotations

import numpy as np
import pytest

from . import case
from .bench import Recipe, draw_bench
from .rivals import is_unique, nearest


def test_a_weak_weight_over_a_small_angle_has_a_spring_for_a_rival() -> None:
    bench = draw_bench(
        np.random.default_rng(0), Recipe(motion="multisine", amplitude=0.05, joint_angle=True, short=True)
    )
    rival, left = nearest(bench, {"gravity_load": {"amplitude": 0.2 * bench.scale, "phase": 0.1}}, "gravity_load")
    assert rival in ("joint_stiffness", "torque_ripple")
    assert left < 1e-4 * bench.scale


def test_a_late_sensor_is_not_unique_when_the_noise_is_large() -> None:
    bench = draw_bench(np.random.default_rng(1), Recipe(short=True))
    effects = {"transport_delay": {"delay": 0.02}}
    left = nearest(bench, effects, "transport_delay")[1]
    assert is_unique(bench, effects, 0.1 * left)
    assert not is_unique(bench, effects, 100.0 * left)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.soak) for seed in (1, 2))])  # more trials
def test_drawn_single_effects_are_unique(seed: int) -> None:
    drawn = case("single", "elongation_coupling", seed, short=True)
    assert drawn.bench is not None
    assert is_unique(drawn.bench, drawn.truth.effects, drawn.truth.noise)


def test_the_true_effect_is_not_its_own_rival() -> None:
    bench = draw_bench(np.random.default_rng(2), Recipe(short=True))
    rival, left = nearest(
        bench, {"viscous_friction": {"coefficient": 0.1 * bench.scale / bench.speed}}, "viscous_friction"
    )
    assert rival != "viscous_friction"
    assert left > 0.0
