"""A computer that is too slow for its rate is reported from 1 % on, and is a fault from `lost_share` on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.virtual.files import controller, plant, write
from tests.virtual.test_two_axes import pair
from tsa_ctrl import simulate_loop
from tsa_ctrl.virtual.result import Simulation

CONSTANT = {"kind": "constant", "offset": 0.3}
SLOW = "slow_loop value=0.0014"  # s; every second period is skipped


def run(folder: Path, *faults: str, seconds: float = 2.2, **more: Any) -> Simulation:
    two = more.pop("two", False)
    axis = {"setpoint": CONSTANT, **({"drive": {"serial_number": 1}} if two else {})}
    tables = controller(file=more, **axis), plant(joint={"load": "held"})
    return simulate_loop(*write(folder, *(map(pair, tables) if two else tables)), seconds, faults=faults)


def skipping(result: Simulation) -> list[str]:
    return [event.text for event in result.summary.events if "had no cycle" in event.text]


def spread(share: float, seconds: float = 1.5) -> list[str]:
    """Return single slow cycles, evenly distributed from 0.5 s on, that skip this share of the periods."""
    return [f"{SLOW} duration=0.001@{0.5 + 1e-3 * n / share}" for n in range(round(1e3 * share * seconds))]


def test_a_loop_that_skips_every_second_period_is_a_fault_that_names_a_rate(tmp_path: Path) -> None:
    result = run(tmp_path, f"{SLOW}@0.5")
    fault = next(event for event in result.summary.events if event.fault)
    assert result.summary.failed
    assert 0.85 < fault.t < 0.95
    assert fault.text == (
        "skipped periods: 200 of 1000 periods had no cycle: a cycle takes 1.4 ms; "
        "set rate = 500 in [controller], which this machine reaches"
    )


def test_a_machine_that_is_slow_from_the_start_is_found_before_half_a_second(tmp_path: Path) -> None:
    result = run(tmp_path, f"{SLOW}@0", seconds=1.0)
    fault = next(event for event in result.summary.events if event.fault)
    assert fault.text.startswith("skipped periods: ")
    assert fault.t < 0.45


@pytest.mark.parametrize(("share", "reported"), [(0.005, False), (0.012, True), (0.15, True)])
def test_a_loop_that_skips_fewer_periods_goes_on_and_is_reported_from_one_in_a_hundred(
    tmp_path: Path, share: float, reported: bool
) -> None:
    result = run(tmp_path, *spread(share))
    assert not result.summary.failed
    assert [
        text.endswith("set rate = 500 in [controller], which this machine reaches") for text in skipping(result)
    ] == ([True] if reported else [])


def test_both_axes_stop_when_their_loop_skips_periods(tmp_path: Path) -> None:
    result = run(tmp_path, "slow_loop value=0.0028@0.5", two=True, seconds=1.5, controller={"rate": 500.0})
    assert [axis.faults[0].startswith("skipped periods: 100 of 500 ") for axis in result.axes] == [True, True]
    for axis in result.axes:
        assert not axis.log["tau_m_cmd"][(axis.log["t"] > 1.0) & (axis.log["t"] < 1.4)].any()
