"""Run the full circle: nominal model, calibration, diagnosis of this run's log, and runs with the results.

The estimates use only the daemon's log of the nominal run, that is, data from the bus and the sensors. The true
parameters of the plant are used only in the run that shows the limit.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tsa_ctrl.demo import rig
from tsa_ctrl.demo.example import Hidden, motion
from tsa_ctrl.demo.rig import BusChoice
from tsa_ctrl.demo.run import runs_on
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.identify.calibrate import calibrate
from tsa_ctrl.identify.diagnosis import Diagnosis, diagnose
from tsa_ctrl.identify.diagnosis.report.page import write
from tsa_ctrl.identify.provenance import provenance
from tsa_ctrl.model.feedforward import Feedforward
from tsa_ctrl.model.parameters import TendonSheath, save_model
from tsa_ctrl.tune.run import Run, read_run

STAGES = ("none", "nominal", "calibrated", "extended", "true")
MODEL_ALONE = {"kind": "fixed"}  # each stage shows its model: no estimate compensates for model errors
COMPENSATION = 1.0  # of the friction term; with a prescribed motion nothing can oscillate

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Circle:
    """Result of a full circle: hidden and identified effects, the run of each stage, and notes for display."""

    bus: str
    hidden: Hidden
    diagnosis: Diagnosis
    runs: dict[str, Run]
    notes: tuple[str, ...]

    def rms(self, stage: str) -> float:
        """Return the RMS error of the joint torque, N*m."""
        return self.runs[stage].rms

    @property
    def found(self) -> str:
        """Return the identified effects, each with the competing hypotheses that the log does not exclude."""
        names = (" or ".join((cause.effect, *cause.alternatives)) for cause in self.diagnosis.causes)
        return " + ".join(names) or "nothing"

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready object."""
        return {
            "schema": 1,
            "bus": self.bus,
            "hidden": {name: dict(values) for name, values in self.hidden.effects.items()},
            "factors": dict(self.hidden.factors),
            "found": [{"effect": c.effect, "alternatives": list(c.alternatives)} for c in self.diagnosis.causes],
            "verdict": self.diagnosis.verdict.value,
            "rms": {**{stage: self.rms(stage) for stage in STAGES}, "unit": "N*m"},
            "share_of_reachable": {"from_none": self.share("none"), "from_nominal": self.share("nominal")},
            "notes": list(self.notes),
        }

    def share(self, reference: str) -> float:
        """Return the share of the possible error reduction from `reference` that the extended model reaches."""
        reachable = self.rms(reference) - self.rms("true")
        return (self.rms(reference) - self.rms("extended")) / reachable if reachable > 0.0 else 1.0


def circle(folder: Path, bus: BusChoice, hidden: Hidden, seconds: float, rate: float, say: Progress) -> Circle:
    """Run all stages in `folder`, each with a new plant; `seconds` of torque per run, `rate` in Hz.

    Raises:
        BusError: the plant or the daemon failed.
        UsageError: the log of the nominal run contains too little information.
    """
    nominal = rig.NOMINAL
    controllers = {name: rig.controller(bus, name, rate, f"{name}.toml", COMPENSATION, MODEL_ALONE) for name in STAGES}
    controllers["none"] = rig.controller(bus, "none", rate, "nominal.toml", 0.0, MODEL_ALONE)
    rig.write(folder, motion(), rig.plant(bus, "full", hidden.axis()), controllers)
    save_model(hidden.truth(nominal), folder / "true.toml")
    runs: dict[str, Run] = {}

    run = runs_on(bus)

    def play(stage: str) -> None:
        summary = run(folder, stage, seconds, lambda share: say(stage, (STAGES.index(stage) + share) / 5.0))
        runs[stage] = _read(folder, stage, seconds, summary)

    play("none")
    play("nominal")
    logs = list(runs["nominal"].learnable())
    say("calibrate", 0.4)
    found = calibrate(logs, nominal)
    source = provenance("demo --full", logs, folder / "nominal.toml", found.quantities, split=found.split)
    save_model(found.model, folder / "calibrated.toml", template=folder / "nominal.toml", provenance=source)
    say("diagnose", 0.4)
    diagnosis = diagnose(logs, nominal)
    write(diagnosis, folder / "diagnosis", folder / "nominal.toml")
    usable, notes = _controllable(diagnosis, 1.0 / rate)
    shutil.copy(folder / ("diagnosis/extended.toml" if usable else "calibrated.toml"), folder / "extended.toml")
    for stage in STAGES[2:]:
        play(stage)
    return Circle(bus.name, hidden, diagnosis, runs, notes)


def _read(folder: Path, stage: str, seconds: float, summary: dict[str, Any]) -> Run:
    if summary["log"] is None or summary["failed"]:
        raise BusError(f"demo: the run '{stage}' failed: {summary['cause']}")
    log = (folder / str(summary["log"])).rename(folder / f"{stage}.mcap")
    return read_run(stage, log, "joint", rig.FADE_IN, seconds)


def _controllable(diagnosis: Diagnosis, period: float) -> tuple[bool, tuple[str, ...]]:
    """Return True if a controller can use the extended model, and notes on effects that it does not compensate."""
    if not isinstance(diagnosis.model, TendonSheath):
        return False, ("the diagnosis returned no tendon-sheath model: the calibrated model is used",)
    try:
        return True, Feedforward(diagnosis.model, period).notes
    except UsageError as error:
        return False, (f"the extended model cannot be inverted ({error}): the calibrated model is used",)
