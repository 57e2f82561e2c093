"""A new bring-up that fails leaves the fault latched and the loop alive, whoever is to blame for it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from tests.bus.fake import FakeBus
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.config import load_configuration
from tsa_ctrl.daemon import operation
from tsa_ctrl.daemon.operation import Operation
from tsa_ctrl.daemon.phase import LoopPhase
from tsa_ctrl.errors import BusError, TsaError, UsageError

CONFIG = Path(__file__).resolve().parents[2] / "config" / "controller.toml"


class Loop:
    """Stands in for the loop: what it was told."""

    def __init__(self) -> None:
        self.told: list[Any] = []

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

    monkeypatch.setattr(operation, "bring_up", fails)
    loop = Loop()
    configuration = load_configuration(CONFIG)
    file = configuration.file
    rig = Rig(FakeBus(), file.bus, file.axes, configuration.profiles)
    Operation(configuration, rig, (), loop)._recover(math.inf)  # type: ignore[arg-type]
    assert loop.told == [f"recovery failed: {error}", LoopPhase.FAULTED]
