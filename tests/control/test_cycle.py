"""Test one cycle of all axes on simulated nodes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.daemon.machine import Machine
from tsa_ctrl.control.cycle import after_commands, run_cycle


@pytest.fixture
def machine(tmp_path: Path) -> Iterator[Machine]:
    made = Machine(tmp_path)
    yield made
    made.close()


def test_nothing_of_the_law_is_asked_without_permission(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without permission for torque, the law is not called, so an error in it has no effect."""

    def asked(*arguments: float) -> float:
        raise AssertionError("asked")

    monkeypatch.setattr(machine.axis.law, "update", asked)
    for _ in range(20):
        run_cycle(machine.rig, machine.axes, machine.bus.clock.now, machine.bus.clock.now + 6e-4)
        after_commands(machine.rig, machine.axes, machine.bus.clock.now)
    assert len(machine.drive.commands) == 20


def test_a_drive_that_obeys_hears_no_nmt(machine: Machine) -> None:
    """If the drive follows its commands, no NMT command is sent during the whole run."""
    machine.run(seconds=0.5)
    assert any(machine.drive.torques)
    assert all(can_id != 0x000 for can_id, _ in machine.bus.sent)
