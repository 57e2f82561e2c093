"""Test the permitted share of the friction compensation for an uncertain friction."""

from __future__ import annotations

from pathlib import Path

import pytest

from tsa_ctrl.control.compensation_limit import Bound, bending_share, bound_of, interval_share
from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.model.parameters import TendonSheath, load_tendon_sheath, save_model

UNIFORM = NOMINAL.with_effects({"elongation_coupling": {"curvature_profile": "uniform"}})


def of(
    model: TendonSheath, *, bending_range: float = 0.0, bending_known: bool = False, sees: bool = True, c: float = 0.95
) -> Bound:
    return bound_of(model, bending_range=bending_range, bending_known=bending_known, sees=sees, compensation=c)


def calibrated(folder: Path, low: float, high: float) -> TendonSheath:
    intervals = {"intervals": {"half_loop_torque": [low, high]}}
    save_model(UNIFORM, folder / "model.toml", provenance=intervals)
    return load_tendon_sheath(folder / "model.toml")


def test_a_bending_of_ten_per_cent_costs_28() -> None:
    """If x is 10 % lower, the pretension of 45 N falls by 0.26 rad * 35 N/rad. This permits 0.9 * (45 - 9.1) / 45."""
    expected = 0.9 * (45.0 - 0.26 * 35.0) / 45.0
    assert bending_share(UNIFORM, 0.1) == pytest.approx(expected, rel=1e-6)
    bound = of(UNIFORM, bending_range=0.1)
    assert bound.seen == pytest.approx(expected, rel=1e-6)
    assert any("that costs 28 % of the compensation" in note for note in bound.notes)


def test_a_bending_that_is_followed_costs_nothing() -> None:
    assert of(UNIFORM, bending_range=0.3, bending_known=True).seen == 1.0
    assert bending_share(UNIFORM, 0.0) == 1.0


def test_the_calibrations_interval_bounds(tmp_path: Path) -> None:
    """The file's friction torque is 0.585 N*m.

    A calibrated interval of 0.5 to 0.7 N*m permits 85 %, with and without sensors that observe the friction.
    """
    half_loop = 2.0 * 45.0 * 0.025 * 0.26
    model = calibrated(tmp_path, 0.5, 0.7)
    assert interval_share(model) == pytest.approx(0.5 / half_loop, rel=1e-6)
    bound = of(model)
    assert bound.seen == bound.unseen == interval_share(model)
    assert any("begins at 85 % of its value" in note for note in bound.notes)
    narrow = calibrated(tmp_path, 0.58, 0.59)
    assert of(narrow).notes == ()


@pytest.mark.parametrize(
    "intervals", [{}, {"half_loop_torque": "wide"}, {"half_loop_torque": [0.5]}, {"half_loop_torque": [0.7, 0.5]}]
)
def test_an_interval_that_is_none_is_no_calibration(tmp_path: Path, intervals: dict[str, object]) -> None:
    save_model(UNIFORM, tmp_path / "model.toml", provenance={"intervals": intervals or {"slope": [1.0, 1.1]}})
    assert interval_share(load_tendon_sheath(tmp_path / "model.toml")) is None


def test_a_recalibrated_model_forgets_the_interval_of_the_old_one(tmp_path: Path) -> None:
    assert calibrated(tmp_path, 0.5, 0.7).recalibrated(0.2).half_loop_low is None


def test_what_was_never_calibrated_is_bounded_where_nothing_sees_it() -> None:
    """With an [uncertainty] of 0.25 for both parameters, the true friction may be only 64 % of the file's value.

    The share is limited to this value if no sensor observes the friction.
    """
    bound = of(UNIFORM)
    assert bound.seen == 1.0
    assert bound.unseen == pytest.approx(0.64)
    assert any("never calibrated" in note for note in bound.notes)
    blind = of(UNIFORM, sees=False)
    assert any("At most 64 % of it is compensated" in note for note in blind.notes)
    assert of(UNIFORM, sees=False, c=0.0).notes == ()


def test_more_than_the_friction_is_not_compensated_and_that_is_said() -> None:
    bound = of(UNIFORM, bending_known=True, c=1.1)
    assert bound.seen == 1.0
    assert "law.compensation 1.1 asks for more" in bound.notes[0]
