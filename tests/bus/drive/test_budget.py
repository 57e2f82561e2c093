"""Test the bus load, counted in bits."""

from __future__ import annotations

import re

import pytest
from msgspec.structs import replace

from tsa_ctrl.bus.drive.budget import check, fitted, load
from tsa_ctrl.bus.drive.plan import interpolation_period
from tsa_ctrl.bus.settings import AxisNodes, BusSettings, DriveSettings, EncoderSettings, TorqueSensorSettings
from tsa_ctrl.errors import UsageError


def axis(number: int, sensors: bool = True) -> AxisNodes:
    return AxisNodes(
        name=f"axis{number}",
        drive=DriveSettings(node_id=1 + number),
        encoder=EncoderSettings(node_id=32 + number) if sensors else None,
        torque_sensor=TorqueSensorSettings(node_id=64 + number) if sensors else None,
    )


def test_cycle_of_one_axis() -> None:
    # SYNC, RPDO 4, TPDO1 8, TPDO2 7, encoder 4, torque sensor 4 bytes
    assert load(BusSettings(), [axis(0)], 1000.0).cycle_bits == (
        47 + 79 + 111 + 103 + 79 + 79,
        55 + 95 + 135 + 125 + 95 + 95,
    )


def test_highest_rate_just_fits_and_the_next_does_not() -> None:
    settings, axes = BusSettings(), [axis(number) for number in range(4)]
    highest = load(settings, axes, 1.0).highest_rate(settings.max_load)
    check(settings, axes, highest - 1e-6)
    with pytest.raises(UsageError):
        check(settings, axes, highest + 0.01)
    assert 380.0 < highest < 420.0


def test_heartbeats_count() -> None:
    slow = BusSettings(host_heartbeat_period=0.1)
    fast = BusSettings(host_heartbeat_period=0.01)
    difference = load(fast, [axis(0)], 100.0).worst - load(slow, [axis(0)], 100.0).worst
    assert difference == pytest.approx((100 - 10) * (47 + 8 + 10) / 1e6)


def leaner(number: int, torque_sensor: bool = False) -> AxisNodes:
    nodes = axis(number)
    return replace(
        nodes, drive=replace(nodes.drive, pdo="lean"), torque_sensor=nodes.torque_sensor if torque_sensor else None
    )


@pytest.mark.parametrize(("torque_sensor", "rates"), [(False, (2350, 1261, 859, 650)), (True, (1872, 989, 670, 505))])
def test_limits_of_lean_axes(torque_sensor: bool, rates: tuple[int, ...]) -> None:
    """The rates were calculated by hand for 1 Mbit/s. A 3-byte frame on every 50th SYNC changes them by 0.4 %."""
    for number, rate in enumerate(rates, start=1):
        axes = [leaner(each, torque_sensor) for each in range(number)]
        assert load(BusSettings(), axes, 1.0).highest_rate(0.9) == pytest.approx(rate, rel=4e-3)


def test_torque_sensors_answer_every_second_sync_only_where_the_bit_rate_needs_it() -> None:
    two = [leaner(0, True), leaner(1, True)]
    assert [each.torque_sensor.every for each in fitted(BusSettings(), two, 500.0) if each.torque_sensor] == [1, 1]
    needed = fitted(BusSettings(), two, 1000.0)
    assert [each.torque_sensor.every for each in needed if each.torque_sensor] == [2, 2]
    check(BusSettings(), needed, 1000.0)
    chosen = [replace(each, torque_sensor=replace(each.torque_sensor, every=1)) for each in two]
    assert list(fitted(BusSettings(), chosen, 1000.0)) == chosen


def followed(suggestion: str, settings: BusSettings, axes: list[AxisNodes], rate: float) -> None:
    """Apply one suggestion. `check` raises an error if the bus load is still too high."""
    if found := re.search(r"bitrate = (\d+)", suggestion):
        settings = replace(settings, bitrate=int(found[1]))
    if found := re.search(r"rate = (\d+) in \[controller\]", suggestion):
        rate = float(found[1])
        assert interpolation_period(1.0 / rate)
    if 'pdo = "lean"' in suggestion:
        axes = [replace(each, drive=replace(each.drive, pdo="lean")) for each in axes]
    if "every = 2" in suggestion:
        axes = [replace(each, torque_sensor=replace(each.torque_sensor, every=2)) for each in axes]
    check(settings, fitted(settings, axes, rate), rate)


@pytest.mark.parametrize("bitrate", [125_000, 250_000, 500_000, 800_000, 1_000_000])
@pytest.mark.parametrize("number", [1, 2, 3, 4, 6])
@pytest.mark.parametrize("sensors", [False, True])
def test_every_suggestion_works(bitrate: int, number: int, sensors: bool) -> None:
    settings, axes = BusSettings(bitrate=bitrate), [axis(each, sensors) for each in range(number)]
    refused = 0
    for rate in (250.0, 400.0, 500.0, 1000.0, 2000.0, 4000.0):
        try:
            check(settings, fitted(settings, axes, rate), rate)
        except UsageError as error:
            refused += 1
            suggestions = str(error).split("; choose ")[1].split(", or ")
            assert any("rate = " in each for each in suggestions)
            for suggestion in suggestions:
                followed(suggestion, settings, axes, rate)
    assert refused > 0


def test_two_axes_with_encoders_at_1_khz_need_lean_drives() -> None:
    axes = [replace(axis(number), torque_sensor=None) for number in range(2)]
    with pytest.raises(UsageError, match=r'at most 933 Hz; choose pdo = "lean" in \[axis.drive\], or rate = 800 in'):
        check(BusSettings(), axes, 1000.0)
