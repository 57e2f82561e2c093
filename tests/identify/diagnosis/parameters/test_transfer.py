"""A cause is shown with what it does on halves of the logs that it was not fitted on. Data written by hand."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tsa_ctrl.identify.diagnosis import diagnose
from tsa_ctrl.identify.diagnosis.parameters.transfer import Transfer, local, taken, upper_half
from tsa_ctrl.identify.diagnosis.report.page import page
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import RigidDrive

RATE = 100.0  # Hz
OFFSET, NOISE = 0.08, 0.02  # N*m
DRIVE = RigidDrive(coulomb_friction=0.3, viscous_friction=0.1)


def _log(seed: int) -> dict[str, Array]:
    """A plain drive with an offset that its file does not have; each log as fast as its number says."""
    rng = np.random.default_rng(seed)
    t = np.arange(1600) / RATE
    fast = 1.0 + 0.5 * seed
    omega = fast * (np.sin(2.0 * np.pi * 0.31 * t + seed) + 0.5 * np.sin(2.0 * np.pi * 0.73 * t))
    tau_m = 0.3 * np.sign(omega) + 0.1 * omega + OFFSET + NOISE * rng.standard_normal(len(t))
    return {"t": t, "tau_m": tau_m, "omega_m": omega}


@pytest.mark.slow
def test_a_cause_that_acts_everywhere_does_its_part_on_every_half() -> None:
    result = diagnose({f"log_{k}": _log(k) for k in range(6)}, DRIVE)
    assert [cause.effect for cause in result.causes] == ["torque_offset"]
    shares = result.causes[0].transfer
    assert {"speed", "time"} <= set(shares)
    without = OFFSET**2 + NOISE**2
    assert all(share > 1.0 - 2.0 * NOISE**2 / without for share in shares.values())
    assert result.to_dict()["causes"][0]["transfer"].keys() == shares.keys()
    assert "Its own numbers fitted on one half of the logs and tried on the other, it takes" in page(result, {})


def _fit(residual: Array, *columns: Array) -> Any:
    """Free coordinates that the bounds leave alone, at their least squares."""
    jacobian = np.array(columns).reshape(len(columns), len(residual)).T
    left = residual - jacobian @ np.linalg.lstsq(jacobian, residual, rcond=None)[0] if columns else residual
    count = len(columns)
    bounds = SimpleNamespace(low=np.full(count, -1e9), high=np.full(count, 1e9))
    free = np.ones(count, dtype=np.bool_)
    rss = float(left @ left)
    return SimpleNamespace(
        jacobian=jacobian, residual=left, point=np.zeros(count), free=free, hypothesis=bounds, rss=rss
    )


WAVE = np.sin(np.arange(2000) * 0.1)
NOISY = 0.1 * np.random.default_rng(3).standard_normal(2000)
SECOND = np.repeat([0, 1], 1000).astype(np.int64)


def _taken(torque: Array, column: Array, *others: Array) -> float | None:
    """Share that the column takes on halves that it was not fitted on, beside others; None where none is a test."""
    found = taken(_fit(torque, column, *others), _fit(torque, *others), slice(1), {"time": SECOND})
    assert math.isnan(found.everywhere) if not found.shares else found.everywhere == found.shares["time"]
    return found.shares.get("time")


def test_what_acts_everywhere_takes_its_share() -> None:
    share = _taken(WAVE + NOISY, WAVE)
    assert share is not None
    assert 1.0 - share == pytest.approx(0.01 / 0.51, rel=0.1)  # the noise's, of the mean square without it


def test_a_number_that_belongs_to_one_half_takes_nothing_off_the_other() -> None:
    """What acts in the first half alone: fitted there it makes the second worse, and the second shows nothing."""
    first = np.where(SECOND == 0, WAVE, 0.0) + NOISY
    assert _taken(first, WAVE) == 0.0
    assert _taken(first - 0.5 * SECOND * WAVE, WAVE) == 0.0  # nor does one of another sign there


def test_a_half_that_others_explain_as_well_is_no_test() -> None:
    """An offset beside friction in logs of one direction each."""
    offset, direction = np.ones(2000), np.where(SECOND == 0, -1.0, 1.0)
    torque = offset + 0.3 * direction + NOISY
    assert _taken(torque, offset, direction) is None
    assert _taken(torque, offset, np.sign(WAVE)) is not None


def test_a_cause_is_not_blamed_for_numbers_that_a_half_does_not_part() -> None:
    """Two others that are nearly the same within a half: it alone gives them sizes that the other contradicts."""
    level = np.ones(2000)
    step = 1.0 + SECOND + 1e-3 * np.random.default_rng(4).standard_normal(2000)
    share = _taken(WAVE + 0.5 * step + NOISY, WAVE, level, step)
    assert share is not None
    assert 1.0 - share == pytest.approx(0.01 / 0.51, rel=0.1)


def test_a_half_in_which_it_cannot_act_is_no_test() -> None:
    assert _taken(SECOND * WAVE + NOISY, SECOND * WAVE) is None


def test_a_half_that_throws_it_far_off_is_no_test() -> None:
    """At the second half's speed it acts not quite twice as much, or ten times."""
    twice, tenfold = (np.where(SECOND == 1, factor, 1.0) * WAVE for factor in (1.9, 10.0))
    assert _taken(twice + NOISY, twice) is not None
    assert _taken(tenfold + NOISY, tenfold) is None


def test_the_claim_that_is_local_is_found() -> None:
    """By all halves together: one kind of them may be against it."""
    assert local(()) is None
    assert local((Transfer({"load": 0.0, "time": 0.4}, 0.1), Transfer({}, math.nan))) is None
    assert local((Transfer({"time": 0.4}, 0.4), Transfer({"load": 0.2, "time": 0.0}, 0.0))) == 1


def test_all_halves_together_count() -> None:
    """What is less in the second half of the time carries further between halves that have some of both times."""
    torque = np.where(SECOND == 1, 0.4, 1.0) * WAVE + NOISY
    mixed = (np.arange(2000) // 100 % 2).astype(np.int64)
    found = taken(_fit(torque, WAVE), _fit(torque), slice(1), {"time": SECOND, "load": mixed})
    assert 0.0 < found.shares["time"] < found.everywhere < found.shares["load"] < 1.0


def test_halves_are_of_the_larger_and_the_smaller() -> None:
    assert upper_half(np.array([3.0, 1.0, 2.0, 5.0])).tolist() == [1, 0, 0, 1]
    assert upper_half(np.array([1.0, 1.0, 1.0])).tolist() == [0, 0, 1]
