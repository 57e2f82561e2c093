"""A plant and a controller for tuning: the joint is moved from outside, and the plant differs from the nominal file."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit

from tsa_ctrl.demo import rig
from tsa_ctrl.demo.rig import BusChoice, gait
from tsa_ctrl.model.parameters import TendonSheath

MODEL = "nominal.toml"
CONTROLLER = "controller-tune.toml"
TRUTH = {"friction_coefficient": 1.15, "pretension": 0.88, "axial_stiffness": 0.9}  # factors on nominal
COMPENSATION = 0.95


def without(controller: Path, *tables: str) -> None:
    """Remove these tables from the axis in a controller's file."""
    data = tomllib.loads(controller.read_text(encoding="utf-8"))
    for table in tables:
        del data["axis"][0][table]
    controller.write_text(tomlkit.dumps(data), encoding="utf-8")


def true_half_loop(nominal: TendonSheath) -> float:
    """Return the friction torque of the plant with even curvature (N*m at the joint). `nominal`: the file's model."""
    x = nominal.friction_angle * TRUTH["friction_coefficient"]
    return 2.0 * nominal.joint_pulley_radius * nominal.pretension * TRUTH["pretension"] * x


def write(
    folder: Path,
    bus: BusChoice,
    rate: float,
    tendon: str = "full",
    axis: Mapping[str, Mapping[str, Any]] | None = None,
    controller_axis: Mapping[str, Any] | None = None,
) -> Path:
    """Write nominal.toml, plant.toml and the controller's file, and return the path of the controller's file.

    `axis`: changes of the tables of the plant's axis. `controller_axis`: tables and values of the controller's axis.
    """
    plant = rig.plant(bus, tendon, {"perturbation": TRUTH, **(axis or {})})
    controller = rig.controller(bus, "tune", rate, MODEL, COMPENSATION)
    controller["bus"]["supervision"] = {"tolerated_misses": 100, "tolerated_drops": 100, "lost_share": 1.0}
    drive = controller["axis"][0]["drive"]
    drive.update(host_timeout=2.0, rpdo_timeout=1.0, heartbeat_timeout=4.0)  # a shared machine may stall
    for node in ("encoder", "torque_sensor"):
        controller["axis"][0][node]["heartbeat_timeout"] = 4.0
    controller["axis"][0].update(controller_axis or {})
    rig.write(folder, gait(), plant, {"tune": controller})
    return folder / CONTROLLER
