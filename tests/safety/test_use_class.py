"""Limits that follow from the wearer, and the drive's clamps that follow from the limits."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsa_ctrl.bus.settings import DriveSettings
from tsa_ctrl.safety.limiter import LimiterSettings
from tsa_ctrl.safety.use_class import SafetySettings, drive_clamps, wearer_limits, with_torque

SPEEDS = st.floats(0.1, 20.0)
RATIOS = st.floats(0.2, 5.0)
ENDS = st.floats(-3.0, 3.0)
ONE = LimiterSettings(torque=1.0)


def limits_of(
    safety: SafetySettings, limits: LimiterSettings = ONE, geared: float = 1.0, reversal: float = 0.0
) -> LimiterSettings:
    """Return the limits of a wearer. The keys of `limits` that differ from the defaults are written in the file."""
    written = {key for key in limits.__struct_fields__ if getattr(limits, key) != getattr(ONE, key)}
    return wearer_limits(limits, {"torque", *written}, safety, geared, reversal)


@given(SPEEDS, RATIOS, st.just(0.0) | st.floats(0.0, 20.0))
def test_the_limits_lie_above_the_wearer_and_in_order(speed: float, geared: float, reversal: float) -> None:
    """A wearer at full speed gets full torque. Each further limit is a quarter higher.

    The motor may also reverse its friction at a joint at rest.
    """
    limits = limits_of(SafetySettings(wearer_speed=speed), geared=geared, reversal=reversal)
    assert 0.8 * limits.joint_speed == pytest.approx(speed)
    assert limits.over_speed == pytest.approx(1.25 * limits.joint_speed)
    assert limits.motor_over_speed >= max(1.5 * reversal, geared * limits.over_speed)
    assert reversal > 0.0 or limits.motor_over_speed == pytest.approx(geared * limits.over_speed)


@given(SPEEDS, RATIOS, st.floats(0.01, 10.0))
def test_the_clamps_of_the_drive_are_the_limits(speed: float, geared: float, torque: float) -> None:
    limits = limits_of(SafetySettings(wearer_speed=speed), LimiterSettings(torque=torque), geared)
    drive = drive_clamps(DriveSettings(node_id=1, max_torque=10.0), {"node_id", "max_torque"}, limits)
    assert (drive.max_torque, drive.max_speed) == (limits.torque, limits.motor_over_speed)


def test_a_share_gives_no_torque_above_the_largest_limit_of_a_file() -> None:
    drive = DriveSettings(node_id=1, rated_torque=300.0, gear_ratio=2.0, max_torque=5000.0)
    assert with_torque(LimiterSettings(torque_share=0.5), drive).torque == pytest.approx(300.0)
    with pytest.raises(ValueError, match=r"torque_share 2 is 1200 N\*m; allowed are up to 1000 N\*m"):
        with_torque(LimiterSettings(torque_share=2.0), drive)


@given(st.tuples(ENDS, ENDS), st.tuples(ENDS, ENDS))
def test_travel_of_an_axis_narrows_that_of_the_file_and_never_widens_it(
    whole: tuple[float, float], own: tuple[float, float]
) -> None:
    if min(whole[1] - whole[0], own[1] - own[0]) < 0.3:
        return
    safety, limits = SafetySettings(travel=whole), LimiterSettings(torque=1.0, travel=own)
    if whole[0] <= own[0] and own[1] <= whole[1]:
        assert limits_of(safety, limits).travel == own
    else:
        with pytest.raises(ValueError, match="is not inside"):
            limits_of(safety, limits)


def test_a_file_s_travel_fills_in_and_a_written_limit_stays() -> None:
    assert limits_of(SafetySettings(travel=(-1.0, 2.0))).travel == (-1.0, 2.0)
    limits = limits_of(SafetySettings(wearer_speed=4.0), LimiterSettings(torque=1.0, joint_speed=3.0))
    assert (limits.joint_speed, limits.over_speed) == (3.0, 6.25)
    assert limits_of(SafetySettings(), geared=2.0) == ONE


def test_a_written_limit_above_a_derived_one_is_a_contradiction() -> None:
    with pytest.raises(ValueError, match=r"over_speed 6\.25 rad/s is not above joint_speed 10 rad/s"):
        wearer_limits(ONE, {"torque", "joint_speed"}, SafetySettings(wearer_speed=4.0), 1.0, 0.0)


def test_an_empty_travel_is_rejected() -> None:
    with pytest.raises(ValueError, match="is empty"):
        SafetySettings(travel=(1.0, 1.0))
