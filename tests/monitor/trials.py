"""Runs of the real loop on the real plant in virtual time, with a monitor and a fault."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.virtual.files import controller, plant, write
from tsa_ctrl.config import load_configuration
from tsa_ctrl.daemon.monitoring import watched_of
from tsa_ctrl.monitor.watched import Frame, Stop
from tsa_ctrl.plant.process import check
from tsa_ctrl.virtual.lockstep import End
from tsa_ctrl.virtual.result import Simulation
from tsa_ctrl.virtual.script import Fault
from tsa_ctrl.virtual.simulation import Run, VirtualMonitor

AT = 0.8  # s of the log, start of the fault

Spoil = Callable[[Run], None]


class Trial:
    """One run with a fault at `AT`.

    `stop` is the finding of the monitor. `late` is its delay after the fault (s).
    """

    def __init__(
        self,
        folder: Path,
        spoil: Spoil = lambda run: None,
        acts: bool = True,
        seconds: float = 1.2,
        faults: tuple[Fault, ...] = (),
        load: str = "limb",
        drive: dict[str, Any] | None = None,
        **axis: Any,
    ) -> None:
        files = write(folder, controller(**axis), plant(joint={"load": load}, drive=drive or {}))
        configuration = load_configuration(files[0])
        run = Run(configuration, check(files[1]), seconds)
        self.monitor = VirtualMonitor(run._wire, watched_of(configuration), acts)
        run._beginning = lambda begin: lambda now: spoil(run) if begin is spoil else begin(now)  # type: ignore[assignment, method-assign]
        schedule = run._schedule
        run._schedule = lambda script, settings: schedule([*script, (spoil, AT)], settings)  # type: ignore[list-item, method-assign]
        try:
            self.result: Simulation = run.play(faults, (), lambda share: None)
        finally:
            run.close()
        self.stop: Stop | None = self.monitor.monitor.stop
        self.late = np.nan if self.stop is None else self.stop.time - self.result.axes[0].start - AT

    def torque(self, after: float) -> float:
        """Return the largest motor torque (N*m) from `after` s after the fault on."""
        truth = self.result.truth
        return float(np.abs(truth["tau_m"][truth["clock"] >= self.result.axes[0].start + AT + after]).max(initial=0.0))


def intruder(*frames: Frame) -> Spoil:
    def spoil(run: Run) -> None:
        end = End(run._wire)
        for frame in frames:
            run._wire.send(end, *frame)

    return spoil


def killed(run: Run) -> None:
    """Suppress all frames of the loop."""
    wire, send = run._wire, run._wire.send
    wire.send = lambda sender, i, data: sender is wire.host or send(sender, i, data)  # type: ignore[method-assign]


def commanding(torque: Callable[[], float]) -> Spoil:
    def spoil(run: Run) -> None:
        axis = run.rig.axes[0]
        command = axis.command
        axis.command = lambda controlword, wanted: command(controlword, torque())  # type: ignore[method-assign]

    return spoil


TRIALS: dict[str, tuple[str, Spoil, float]] = {
    "loop killed": ("silent", killed, 0.022),
    "torque jumps": ("command_step", commanding(lambda: -1.5), 0.001),
    "NMT of an intruder": ("nmt", intruder((0x000, b"\x80\x00")), 0.001),
}
