"""Bus load in bits."""

from __future__ import annotations

import pytest

from tsa_ctrl.bus.drive.budget import check, frame_bits, load
from tsa_ctrl.bus.settings import AxisNodes, BusSettings, DriveSettings, EncoderSettings, TorqueSensorSettings
from tsa_ctrl.errors import UsageError


def axis(number: int, sensors: bool = True) -> AxisNodes:
    return AxisNodes(
        name=f"axis{number}",
        drive=DriveSettings(node_id=1 + number),
        encoder=EncoderSettings(node_id=32 + number) if sensors else None,
        torque_sensor=TorqueSensorSettings(node_id=64 + number) if sensors else None,
    )


@pytest.mark.parametrize(("length", "bits"), [(0, (47, 55)), (4, (79, 95)), (8, (111, 135))])
def test_bits_of_a_frame(length: int, bits: tuple[int, int]) -> None:
    assert frame_bits(length) == bits


def test_cycle_of_one_axis() -> None:
    # SYNC, RPDO 4, TPDO1 8, TPDO2 7, encoder 4, torque sensor 4 bytes
    assert load(BusSettings(), [axis(0)], 1000.0).cycle_bits == (
        47 + 79 + 111 + 103 + 79 + 79,
        55 + 95 + 135 + 125 + 95 + 95,
    )


def test_one_axis_at_1_khz_fits_1_mbit() -> None:
    assert 0.4 < check(BusSettings(), [axis(0)], 1000.0).worst < 0.7


@pytest.mark.parametrize(("bitrate", "rate"), [(500_000, 1000.0), (250_000, 500.0)])
def test_rate_beyond_the_bit_rate_is_refused_with_figures(bitrate: int, rate: float) -> None:
    with pytest.raises(UsageError, match=rf"bitrate {bitrate}: {rate:g} Hz .* needs \d+ to \d+ % .* at most \d+ Hz"):
        check(BusSettings(bitrate=bitrate), [axis(0)], rate)


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
