"""Test that random cases agree with their truth, are reproducible by their seed, and are fair."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from . import FAMILIES, NAMES, case
from .bench import rms
from .drawn import drawn, together
from .outside import STRANGERS, CatalogueSpan
from .rig import model_file
from .size import UNCERTAINTY, Channels, channels, recalibrated, size

pytestmark = together


def test_the_same_seed_gives_the_same_case() -> None:
    first, second = (case("single", "viscous_friction", 4, short=True) for _ in range(2))
    assert first.model == second.model
    assert first.truth.effects == second.truth.effects
    for name, column in first.logs[0].columns.items():
        np.testing.assert_array_equal(column, second.logs[0].columns[name])


def test_another_seed_gives_another_case() -> None:
    assert case("none", "rich", 0, short=True).model != case("none", "rich", 1, short=True).model


@pytest.mark.parametrize("name", NAMES)
def test_a_single_effect_is_at_least_as_large_as_the_noise(name: str) -> None:
    """The truth contains only this effect, and its size is 1 to 8.5 times the noise."""
    given = drawn("single", name, 1)
    assert set(given.truth.effects) == {name}
    assert given.truth.size >= given.truth.noise
    assert given.truth.size <= 8.5 * given.truth.noise


@pytest.mark.parametrize("name", ["stribeck_friction", "transport_delay", "tendon_slack", "pretension_relaxation"])
def test_the_noise_is_what_the_truth_says(name: str) -> None:
    """The RMS of recorded minus ideal joint torque is 70 to 105 % of the stated noise.

    The stated noise also includes the noise of the motor torque.
    """
    given = drawn("single", name, 2)
    bench = given.bench
    assert bench is not None
    ideal = np.concatenate(bench.ideal(given.truth.effects))
    recorded = np.concatenate([log.columns["tau_j"] for log in given.logs])
    assert 0.7 * given.truth.noise < rms(recorded - ideal) < 1.05 * given.truth.noise


@pytest.mark.parametrize("seed", range(20))
def test_nominal_numbers_are_wrong_by_at_most_a_fifth(seed: int) -> None:
    """Nominal values are wrong by at most 20 %, so the true values are within the uncertainty of a recalibration."""
    given = drawn("none", "rich", seed)
    bench = given.bench
    assert bench is not None
    for true, nominal in ((bench.rig.x, bench.nominal.x), (bench.rig.pretension, bench.nominal.pretension)):
        assert abs(true / nominal - 1.0) <= 0.2 + 1e-12
        assert 1.0 / (1.0 + UNCERTAINTY) <= true / nominal <= 1.0 + UNCERTAINTY
    file = tomllib.loads(given.model)
    assert file["pretension"]["value"] == bench.nominal.pretension
    assert file["sheath"]["friction_coefficient"] == bench.nominal.mu


def test_recalibration_finds_the_true_numbers() -> None:
    """Without an effect the residual is zero, and x and T_p are recovered."""
    bench = drawn("none", "rich", 3).bench
    assert bench is not None
    x, pretension, residual = recalibrated(bench.nominal, channels(bench, {}), np.concatenate(bench.ideal({})))
    assert x == pytest.approx(bench.rig.x, rel=1e-3)
    assert pretension == pytest.approx(bench.rig.pretension, rel=1e-3)
    assert rms(residual) < 1e-4 * bench.scale


def test_size_is_what_brute_force_leaves() -> None:
    """The size agrees with the smallest RMS error over a fine grid of x and T_p within the uncertainty."""
    given = drawn("single", "viscous_friction", 0)
    bench = given.bench
    assert bench is not None
    seen: Channels = channels(bench, {})
    torque = np.concatenate(bench.ideal(given.truth.effects))
    nominal = bench.nominal
    factors = np.linspace(1.0 / (1.0 + UNCERTAINTY), 1.0 + UNCERTAINTY, 46)
    stride = 7
    few = seen.thinned(stride)
    best = min(
        rms(torque[::stride] - few.plain(fx * nominal.x, ft * nominal.pretension)) for fx in factors for ft in factors
    )
    assert given.truth.size == pytest.approx(best, rel=0.03)


def test_motor_friction_is_no_effect_at_one_pretension() -> None:
    """An effect that recalibration compensates has a size far below the noise."""
    given = drawn("confounded", "motor_friction_or_parameters", 0)
    assert given.truth.size < 0.15 * given.truth.noise


@pytest.mark.parametrize("seed", range(4))
def test_both_effects_of_a_pair_are_visible(seed: int) -> None:
    given = drawn("pair", "any", seed)
    assert len(given.truth.effects) == 2
    assert min(given.truth.sizes.values()) >= given.truth.noise


@pytest.mark.parametrize(
    "name",  # property of `cases.outside_case`; each change tests half of the kinds
    [pytest.param(name, marks=[pytest.mark.soak] if place % 2 else []) for place, name in enumerate(STRANGERS)],
)
def test_the_catalogue_cannot_imitate_a_stranger(name: str) -> None:
    """The part that the fitted catalogue cannot imitate is at least twice the noise."""
    given = drawn("outside", name, 0)
    assert given.truth.effects == {}
    assert given.truth.size >= 2.0 * given.truth.noise


def test_the_span_of_the_catalogue_holds_its_effects() -> None:
    """The span of the catalogue imitates a mixture of weak effects with a residual below 6 %.

    The residual of a cause outside the catalogue is therefore no artefact of the linearisation.
    """
    bench = case("outside", "sheath_kink", 1, short=True).bench
    assert bench is not None
    span = CatalogueSpan(bench)
    mixture = {
        "viscous_friction": {"coefficient": 0.05 * bench.scale / bench.speed},
        "torque_offset": {"offset": 0.05 * bench.scale},
        "stribeck_friction": {"static_excess": 0.1, "stribeck_velocity": 0.2 * bench.speed},
    }
    change = rms(np.concatenate(bench.ideal(mixture)) - np.concatenate(bench.ideal({})))
    assert span.leftover(bench.ideal(mixture)) < 0.06 * change


@pytest.mark.parametrize("family", FAMILIES)
def test_columns_are_finite_and_of_one_length(family: str) -> None:
    given = drawn(family, FAMILIES[family][-1], 0)
    for log in given.logs:
        assert len({column.size for column in log.columns.values()}) == 1
        assert all(np.isfinite(column).all() for column in log.columns.values())
        steps = np.diff(log.columns["t"])
        assert np.ptp(steps) < 1e-6


def test_nominal_file_states_its_uncertainty_when_asked() -> None:
    bench = case("none", "plain", 0, short=True).bench
    assert bench is not None
    assert tomllib.loads(model_file(bench.nominal, True))["uncertainty"] == {"friction_angle": 0.25, "pretension": 0.25}


def test_size_of_nothing_is_nothing() -> None:
    bench = drawn("none", "rich", 5).bench
    assert bench is not None
    assert size(bench, {}) < 1e-4 * bench.scale
