"""Test the time until a drive has no torque, from samples of its reports."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsa_ctrl.drills.listener import Said, Sample, timing, watchdog

ZERO = 0.02


def seen(torques: Sequence[float], node: int = 1, period: float = 0.002, source: str = "tpdo") -> list[Sample]:
    return [Sample(n * period, node, torque, source) for n, torque in enumerate(torques)]  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("torques", "stopped", "last_torque", "zero_after"),
    [
        ([0.1] * 10 + [0.01] * 10, 0.005, 0.013, 0.015),  # the first sample without torque counts
        ([0.1] * 5 + [0.0] * 5 + [-0.1] * 5 + [0.0] * 5, 0.005, 0.023, 0.025),  # the torque came back
        ([0.1] * 20, 0.005, 0.033, None),
        ([0.1] * 10, 0.0101, 0.0079, None),  # a drive that falls silent with torque has not stopped
    ],
)
def test_time_until_the_torque_stays_zero(
    torques: list[float], stopped: float, last_torque: float, zero_after: float | None
) -> None:
    found = timing(seen(torques), 1, stopped, ZERO)
    assert found.torque_before == 0.1
    assert found.last_torque == pytest.approx(last_torque)
    assert found.zero_after == (None if zero_after is None else pytest.approx(zero_after))


def test_a_drive_never_heard_is_not_safe() -> None:
    found = timing(seen([0.0] * 10, node=2), 1, 0.005, ZERO)
    assert (found.torque_before, found.zero_after) == (None, None)


@given(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=50), st.floats(0.0, 0.1))
def test_zero_after_is_late_enough(torques: list[float], stopped: float) -> None:
    """All samples after the reported time have zero torque."""
    samples = seen(torques)
    found = timing(samples, 1, stopped, ZERO)
    if found.zero_after is not None:
        assert all(abs(s.torque) <= ZERO for s in samples if s.clock - stopped >= found.zero_after)


RPDO, HEARTBEAT = 0x8250, 0x8130


@pytest.mark.parametrize(
    ("said", "armed", "dead", "acted", "warned"),
    [
        ([(0.021, RPDO)], {"rpdo": 20, "heartbeat": 100}, True, "rpdo", False),
        ([(0.021, RPDO), (0.101, HEARTBEAT)], {"rpdo": 20, "heartbeat": 100}, True, "rpdo", False),
        ([(0.505, HEARTBEAT)], {"rpdo": 300, "heartbeat": 500}, True, "heartbeat", True),
        ([(0.102, HEARTBEAT)], {"rpdo": 90, "heartbeat": 100}, True, "heartbeat", False),  # too close to order
        ([(0.505, HEARTBEAT)], {"rpdo": 100, "heartbeat": 500}, False, "heartbeat", False),  # the loop still sends
        ([(0.505, HEARTBEAT)], {"heartbeat": 500}, True, "heartbeat", False),
        ([(0.505, HEARTBEAT)], {"guarding": 500}, True, "heartbeat", False),
        ([(0.505, 0x3220)], {"rpdo": 100}, True, None, False),
        ([], {"rpdo": 100}, True, None, False),
    ],
)
def test_which_watchdog_acted_and_which_did_not(
    said: list[tuple[float, int]], armed: dict[str, int], dead: bool, acted: str | None, warned: bool
) -> None:
    found = watchdog([Said(10.0 + after, 1, code) for after, code in said], 1, 10.0, armed, dead)
    assert (found.acted, bool(found.warning)) == (acted, warned)


def test_the_warning_names_the_watchdog_that_did_not_act() -> None:
    found = watchdog([Said(10.505, 1, HEARTBEAT)], 1, 10.0, {"rpdo": 20, "heartbeat": 500}, True)
    assert found.warning == (
        "the RPDO event timer (0x1400:5) is armed with 20 ms and did not act: the heartbeat consumer (0x1016) did, "
        "after 505 ms; the torque lasts that long when this computer dies"
    )
