"""A new bring-up that fails leaves the fault latched and the loop alive; a stop that comes in one ends it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from tests.bus.fake import FakeBus
from tests.daemon.machine import Machine
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.config import load_configuration
from tsa_ctrl.daemon import lifecycle
from tsa_ctrl.daemon.build import LoopPhase
from tsa_ctrl.daemon.lifecycle import Lifecycle
from tsa_ctrl.daemon.monitoring import SecondChannel
from tsa_ctrl.errors import BusError, TsaError, UsageError

CONFIG = Path(__file__).resolve().parents[2] / "config" / "controller.toml"


class Loop:
    """Stands in for the loop: what it was told."""

    def __init__(self) -> None:
        self.told: list[Any] = []
        self.channel = SecondChannel()

    def note(self, text: str) -> None:
        self.told.append(text)

    def run(self, seconds: float, first: LoopPhase) -> None:
        self.told.append(first)

    def reset_faults(self) -> None:
        self.told.append("reset")


@pytest.mark.parametrize("error", [BusError("node 1 is silent"), UsageError("rated torque is 2 N*m, not 1 N*m")])
def test_a_bring_up_that_fails_again_leaves_the_fault_latched(error: TsaError, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*arguments: object) -> None:
        raise error

    monkeypatch.setattr(lifecycle, "bring_up", fails)
    loop = Loop()
    configuration = load_configuration(CONFIG)
    file = configuration.file
    rig = Rig(FakeBus(), file.bus, file.axes, configuration.profiles)
    Lifecycle(configuration, rig, (), loop)._recover(math.inf)  # type: ignore[arg-type]
    assert loop.told == [f"recovery failed: {error}", LoopPhase.FAULTED]


@pytest.mark.parametrize("who", ["tsa stop", "SIGINT"])
def test_a_stop_while_it_starts_ends_it_without_a_fault(tmp_path: Path, who: str) -> None:
    """Nothing was sent, no drive is said to be on, and the summary of no cycle at all can be shown."""
    machine = Machine(tmp_path)
    said: list[str] = []
    if who == "tsa stop":
        machine.mailbox.request_stop()
    else:
        machine.loop.stop(who)
    begin = machine.bus.clock.now
    file = machine.configuration.file
    rig = Rig(machine.bus, file.bus, file.axes, machine.configuration.profiles)  # one that never commanded
    run = Lifecycle(machine.configuration, rig, machine.axes, machine.loop, said.append)
    run.run(math.inf, ready=lambda: pytest.fail("the loop begins"))
    assert machine.bus.clock.now - begin < 1.0
    assert machine.bus.sent == []
    assert said == [f"{who}: the start ends here; no drive was enabled"]
    summary = run.summary(machine.mailbox, "none")
    assert (summary.cause, summary.failed, summary.sent) == (who, False, 0)
    summary.show(Console(quiet=True))
    machine.close()
