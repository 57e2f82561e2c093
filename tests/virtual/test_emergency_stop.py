"""Test the emergency stop at a drive's digital inputs, in virtual time: pressed, released and unreadable."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.virtual.files import controller, merged, plant, write
from tsa_ctrl import simulate_loop
from tsa_ctrl.virtual.result import Simulation

PRESSED = "digital_input value=3@0.6"
WITHIN = 0.05  # s; two SDO requests and their answers


def run(folder: Path, *faults: str, seconds: float = 1.2, changes: tuple[str, ...] = (), **more: Any) -> Simulation:
    tables = controller(file={"safety": {"emergency_stop": 3, **more.pop("safety", {})}}, **more.pop("axis", {}))
    return simulate_loop(*write(folder, tables, plant(**more)), seconds, faults=faults, changes=changes)


def latest_torque(result: Simulation) -> float:
    """Return the last time of the log with a torque command, s."""
    log = result.axes[0].log
    return float(log["t"][np.flatnonzero(log["tau_m_cmd"] != 0.0)[-1]])


@pytest.mark.parametrize("fault", [PRESSED, "digital_input value=3 duration=0.1@0.6"], ids=["pressed", "released"])
def test_a_pressed_stop_takes_the_torque_and_latches(tmp_path: Path, fault: str) -> None:
    result = run(tmp_path, fault)
    assert result.axes[0].faults == ("emergency stop: drive node 1: bit 3 of 0x60FD:0 digital inputs",)
    assert 0.6 <= latest_torque(result) < 0.6 + WITHIN


def test_another_bit_is_no_stop_and_without_the_key_nothing_is_read(tmp_path: Path) -> None:
    assert not run(tmp_path, "digital_input value=4@0.6").axes[0].faults
    assert not simulate_loop(*write(tmp_path), 1.0, faults=[PRESSED]).axes[0].faults


def test_an_input_that_is_high_while_released_stops_when_it_goes_low(tmp_path: Path) -> None:
    """The simulated inputs are low, so the stop is pressed from the beginning, and there is never torque."""
    result = run(tmp_path, safety={"emergency_stop_level": 0})
    assert "emergency stop" in result.axes[0].faults[0]
    assert not result.axes[0].log["tau_m_cmd"].any()


def test_a_node_that_answers_no_question_counts_as_pressed(tmp_path: Path) -> None:
    """The drive answers an SDO only after 0.4 s, so the state of the stop is unknown."""
    result = run(tmp_path, drive={"answer_time": 0.4})
    assert "no answer for 0x60FD:0 digital inputs within 0.25 s" in result.axes[0].faults[0]


@pytest.mark.parametrize("bitrate", [1_000_000, 500_000])
def test_the_stop_is_found_on_slower_buses(tmp_path: Path, bitrate: int) -> None:
    tables = controller(
        file={"safety": {"emergency_stop": 3}, "bus": {"bitrate": bitrate}, "controller": {"rate": 400.0}}
    )
    result = simulate_loop(*write(tmp_path, tables), 1.2, faults=[PRESSED])
    assert latest_torque(result) < 0.6 + 2.0 * WITHIN


def test_each_axis_reads_the_stop_of_its_own_drive(tmp_path: Path) -> None:
    """One device has two axes. The objects of the second axis are offset by 0x800."""
    tables = controller(file={"safety": {"emergency_stop": 3}, "controller": {"rate": 400.0}})
    tables["axis"].append(
        merged(
            tables["axis"][0],
            {"name": "hip", "drive": {"slot": 2}, "encoder": {"node_id": 33}, "torque_sensor": {"node_id": 65}},
        )
    )
    machine = plant()
    machine["axis"].append(merged(machine["axis"][0], {"name": "other", "drive": {"node_id": 1, "slot": 2}}))
    result = simulate_loop(*write(tmp_path, tables, machine), 1.2, faults=["digital_input axis=other value=3@0.6"])
    assert "emergency stop: drive node 1: bit 3 of 0x68FD:0 digital inputs" in result.axes[1].faults
