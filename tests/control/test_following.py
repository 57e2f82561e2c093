"""Test that the estimate follows a wrap angle that increases by 40 %, and that the torque error stays small."""

from __future__ import annotations

import pytest

from tests.control.following import MU, THETA, Change, rms, run

CHANGE = Change(share=0.4, at=5.0, within=4.0)
SECONDS = 20.0


def test_the_friction_angle_follows_the_bending() -> None:
    _, _, angle = run(CHANGE, SECONDS, use=True)
    assert angle[-1] == pytest.approx(1.4 * MU * THETA, rel=0.05)


@pytest.mark.slow
def test_the_torque_error_stays_small_with_the_estimate_and_grows_without() -> None:
    t, with_estimate, _ = run(CHANGE, SECONDS, use=True)
    _, without, _ = run(CHANGE, SECONDS, use=False)
    after = (SECONDS - 6.0, SECONDS)
    assert rms(t, without, *after) > 3.0 * rms(t, without, 3.0, 5.0)
    assert rms(t, with_estimate, *after) < 0.35 * rms(t, without, *after)


def test_without_a_change_the_estimate_does_no_harm() -> None:
    still = Change(share=0.0)
    t, with_estimate, _ = run(still, 12.0, use=True)
    _, without, _ = run(still, 12.0, use=False)
    assert rms(t, with_estimate, 6.0, 12.0) < 1.15 * rms(t, without, 6.0, 12.0)
