"""Run the real loop on distributed tendons with a given rig, sensors, set-point, faults and changes.

The controller's model file is true, except for the tendon stiffness, which comes from a data sheet. The file does not
contain the plant's smaller `friction` or `pretension`, or its later faults.
"""

from __future__ import annotations

import dataclasses
import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tsa_ctrl.config import load_configuration
from tsa_ctrl.control.settings import LawSettings
from tsa_ctrl.demo import rig
from tsa_ctrl.demo.rig import VIRTUAL, gait
from tsa_ctrl.ipc.protocol import Event
from tsa_ctrl.model.curvature import NAMED, Points, Profile, centred
from tsa_ctrl.model.parameters import TendonSheath, save_model
from tsa_ctrl.plant.axis import COLUMNS, Record
from tsa_ctrl.plant.process import check
from tsa_ctrl.tune.mechanics import FEEDBACK
from tsa_ctrl.virtual.result import Simulation
from tsa_ctrl.virtual.script import Change, Fault
from tsa_ctrl.virtual.simulation import Run

INERTIA = {"weight": 0.02, "spring": 0.02, "free": 0.02, "limb": 0.05, "wearer": 0.05}  # kg*m^2 of the joint, by load
SET_POINTS = ("zero", "constant", "sine", "gait")
SHARE = 0.95  # of the friction term, [axis.law] compensation as shipped
CONSTANT, SINE, FREQUENCY = 0.3, 0.5, 0.5  # N*m, N*m, Hz
GAIT_SHARE = {"weight": 0.4, "free": 0.4}  # of the gait's torque, to keep a joint of 0.02 kg*m^2 below 5 rad/s
_PLACES = {name: place for place, (name, _) in enumerate(COLUMNS)}

ENCODER_LAG = 1.0 / (2.0 * math.pi * 50.0)  # s, lag of the controller's own low-pass, [axis.encoder] velocity_cutoff

Ended = Callable[[float, float, Sequence[Event]], bool]  # s of the log, rad/s of the joint, events; True ends the run


def true_model(
    shape: str | Points, nominal: TendonSheath = rig.NOMINAL, factors: Mapping[str, float] = rig.TRUTH
) -> TendonSheath:
    """Return the plant's model with friction, pretension and stiffness times `factors`, the shape and the encoder lag.

    (3.55) is exact with all bends at the joint, but the law also needs the shape to plan a reversal of the motor.
    """
    effects: dict[str, dict[str, Any]] = {
        "velocity_lag": {"time_constant": ENCODER_LAG},
        "elongation_coupling": {"curvature_profile": shape},
    }
    x = nominal.friction_angle * factors["friction_coefficient"]
    model = nominal.recalibrated(x, nominal.pretension * factors["pretension"]).with_effects(effects)
    return dataclasses.replace(model, axial_stiffness=nominal.axial_stiffness * factors["axial_stiffness"])


@dataclass(frozen=True)
class Experiment:
    """A rig and its set-point.

    Args:
        friction, pretension: The plant's values as shares of the file's values, 1.
        centre: s_c, centre of the bends along the sheath, from 0 (motor) to 1 (joint).
        delay: Delay of the drive, periods.
        motor_bits, joint_bits: Resolution of the encoders.
        true_stiffness: True if the controller's file has the true stiffness instead of the data sheet's value.
        file_model: Model that replaces the controller's model.
        hand: Script of a hand on the joint. By default, a wearer has its own script.
        axis, file, plant: Tables that replace values of the controller's [[axis]], of its other tables, and of the
            plant's [[axis]].
    """

    load: str
    set_point: str
    sensors: str = "sensor"
    friction: float = 1.0
    pretension: float = 1.0
    centre: float = 0.5
    delay: int = 1
    motor_bits: int = 16
    joint_bits: int = 20
    compensation: float = SHARE
    fade_in: float = 0.5
    true_stiffness: bool = False
    file_model: TendonSheath | None = None
    seed: int = 1
    hand: Sequence[Sequence[float]] | None = None
    axis: dict[str, Any] = dataclasses.field(default_factory=dict)
    file: dict[str, Any] = dataclasses.field(default_factory=dict)
    plant: dict[str, Any] = dataclasses.field(default_factory=dict)

    def play(
        self,
        seconds: float,
        faults: Sequence[Fault] = (),
        changes: Sequence[Change] = (),
        ended: Ended | None = None,
    ) -> Simulation:
        """Run for `seconds` of torque, or until `ended` returns True for a row of the plant's truth."""
        motion = gait()
        scaled = dataclasses.replace(motion, tau_j_des=GAIT_SHARE.get(self.load, 1.0) * motion.tau_j_des)
        with tempfile.TemporaryDirectory(prefix="experiment-") as name:
            folder = Path(name)
            save_model(self.file_model or self.model(), folder / "true.toml")
            rig.write(folder, scaled, self._plant(), {"run": self._controller()})
            configuration = load_configuration(folder / "controller-run.toml")
            run = Run(configuration, check(folder / "plant.toml"), seconds)
            if ended is not None:
                _end_early(run, ended)
            try:
                return run.play(faults, changes, lambda share: None)
            finally:
                run.close()

    def model(self) -> TendonSheath:
        """Return the controller's model, with true friction, pretension and shape, and the selected stiffness."""
        true = true_model(self._curvature())
        return true if self.true_stiffness else dataclasses.replace(true, axial_stiffness=rig.NOMINAL.axial_stiffness)

    def _curvature(self) -> str | Points:
        if self.centre == 0.5:
            return "uniform"
        return centred(Profile(NAMED["uniform"]), self.centre).points

    def _plant(self) -> rig.Tables:
        curvature = self._curvature()
        axis: dict[str, dict[str, Any]] = {
            "perturbation": {
                "friction_coefficient": self.friction * rig.TRUTH["friction_coefficient"],
                "pretension": self.pretension * rig.TRUTH["pretension"],
            },
            "tendon": {"curvature": curvature if isinstance(curvature, str) else [list(p) for p in curvature]},
            "drive": {"delay_periods": self.delay - 1, "counts_per_revolution": 1 << self.motor_bits},
            "motor": {"inertia": rig.MOTOR_INERTIA},
            "encoder": {"present": self.sensors != "motor", "counts_per_revolution": 1 << self.joint_bits},
            "torque_sensor": {"present": self.sensors == "sensor"},
        }
        tables = rig.plant(VIRTUAL, "distributed", axis, self.load)
        tables["physics"]["seed"] = self.seed
        if self.hand is not None:
            tables["axis"][0]["joint"] |= {"hand": [list(line) for line in self.hand], "hand_repeat": False}
        _over(tables["axis"][0], self.plant)
        return tables

    def _controller(self) -> rig.Tables:
        tables = rig.controller(VIRTUAL, "run", 1000.0, "true.toml", self.compensation)
        axis = tables["axis"][0]
        axis["law"]["fade_in"] = self.fade_in
        axis["drive"]["counts_per_revolution"] = 1 << self.motor_bits
        axis["encoder"]["counts_per_revolution"] = 1 << self.joint_bits
        if self.compensation > 0.0:
            axis["law"] |= {"motor_inertia": rig.MOTOR_INERTIA, "delay": (self.delay + 1.0) * 1e-3}  # hold, torque loop
        if self.set_point in ("zero", "constant"):
            axis["setpoint"] = {"kind": "constant", "offset": CONSTANT if self.set_point == "constant" else 0.0}
        elif self.set_point == "sine":
            axis["setpoint"] = {"kind": "sine", "amplitude": SINE, "frequency": FREQUENCY}
        if self.sensors == "motor":
            del axis["encoder"]
        if self.sensors != "sensor":
            del axis["torque_sensor"]
        elif self.compensation > 0.0 and hasattr(LawSettings, "feedback"):  # an older revision may not have it
            axis["law"]["feedback"] = FEEDBACK
        _over(axis, self.axis)
        _over(tables, self.file)
        return tables


def _over(tables: rig.Tables, changes: dict[str, Any]) -> None:
    for name, values in changes.items():
        tables[name] = {**tables.get(name, {}), **values} if isinstance(values, dict) else values


class _Seen:
    """Forward the plant's truth to the recorder, and stop the loop once `ended` returns True."""

    def __init__(self, run: Run, record: Record, ended: Ended) -> None:
        self._run, self._record, self._ended = run, record, ended
        self.due, self.flush = record.due, record.flush

    def row(self, values: Sequence[float]) -> None:
        self._record.row(values)
        loop = self._run.loop
        t = values[_PLACES["clock"]] - loop.start
        if loop.start and self._ended(t, values[_PLACES["omega_j"]], loop.events.all):
            loop.stop("all has been seen")


def _end_early(run: Run, ended: Ended) -> None:
    record = run.machine.recorder
    assert record is not None
    run.machine.recorder = _Seen(run, record, ended)
