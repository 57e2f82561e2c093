"""Test the whole loop with a joint encoder of 12 bit and a motor encoder of 20 bit."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.virtual.joints import GAIT, error, play, rms

COARSE = {"encoder": {"counts_per_revolution": 1 << 12}}


@pytest.mark.slow
def test_the_motor_makes_up_for_a_coarse_joint_encoder(tmp_path: Path) -> None:
    """The error is 16 mN*m. It is 38 without the motor's angle, and 5 with a joint encoder of 20 bit."""
    assert rms(error(play(tmp_path, "imposed", GAIT, 5.0, axis=COARSE, plant=COARSE))) < 20.0
