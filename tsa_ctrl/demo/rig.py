"""The demo's files as data: a plant whose parameters are NOT the controller's, and controllers to compare on it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit

from tsa_ctrl.demo.bus_choice import BusChoice
from tsa_ctrl.demo.motion import Play
from tsa_ctrl.model.parameters import TendonSheath, save_model

MOST_TORQUE = 1.1  # N*m at the joint: within the tendons' domain at the pretension below
FADE_IN = 1.0  # s
MOTOR_INERTIA = 1e-4  # kg*m^2, the plant's own: a motor's data sheet says it

NOMINAL = TendonSheath(
    motor_pulley_radius=0.020,
    joint_pulley_radius=0.025,
    axial_stiffness=60e3,
    unstrained_length=1.2,
    diameter=0.6e-3,
    contact_offset=0.4e-3,
    friction_coefficient=0.10,
    bending_angle=2.6,
    pretension=45.0,
    bending_centre=0.5,
    source="nominal.toml",
)
TRUTH = {"friction_coefficient": 1.08, "pretension": 0.95, "axial_stiffness": 0.9}  # factors: the truth is not nominal

Tables = dict[str, Any]


def plant(
    bus: BusChoice, tendon: str, axis: Mapping[str, Mapping[str, Any]] | None = None, load: str = "imposed"
) -> Tables:
    """The plant's configuration; `tendon` is its kind, `axis` changes or adds tables of its one axis."""
    tables: Tables = {
        "name": "joint",
        "actuator": "nominal.toml",
        "perturbation": dict(TRUTH),
        "tendon": {"kind": tendon, "curvature": "uniform"},
        "joint": {"load": load},
        "motion": {"kind": "file", "file": "motion.csv", "repeat": True},
    }
    for name, values in (axis or {}).items():
        tables[name] = {**tables.get(name, {}), **values}
    return {
        "bus": {"interface": bus.interface, "channel": bus.channel},
        # The same motion in every run; and a real machine does not wait for the controller either.
        "physics": {"start": "first_enable", "priority": 90},
        "axis": [tables],
    }


def controller(
    bus: BusChoice, name: str, rate: float, model: str, compensation: float, estimator: Mapping[str, Any] | None = None
) -> Tables:
    """A controller's configuration that bears a busy machine: stalls of 10 ms and more, no real-time rights.

    `estimator`: its [axis.estimator]; what is left out is the loop's default.
    """
    law: Tables = {"compensation": compensation, "fade_in": FADE_IN}
    if compensation > 0.0:  # without compensation is tau_J* r_M/r_J, and nothing for the motor's own motion
        law["motor_inertia"] = MOTOR_INERTIA
    return {
        "controller": {"name": "demo", "rate": rate, "settle_cycles": 20, "after_fault": "exit"},
        "bus": {
            "interface": bus.interface,
            "channel": bus.channel,
            "supervision": {"tolerated_misses": 50, "tolerated_drops": 50, "lost_share": 0.5},
        },
        "realtime": {"allow_without": True},
        "log": {"folder": "."},
        "socket": {"path": f"{name}.sock"},
        "axis": [
            {
                "name": "joint",
                "model": model,
                "drive": {
                    "node_id": 1,
                    "max_torque": 3.0,
                    "host_timeout": 0.5,
                    "rpdo_timeout": 0.2,
                    "heartbeat_timeout": 1.0,
                },
                "encoder": {"node_id": 32, "heartbeat_timeout": 1.0},
                "torque_sensor": {"node_id": 64, "heartbeat_timeout": 1.0},
                "setpoint": {"kind": "file", "file": "setpoint.csv", "loop": True},
                "law": law,
                "estimator": dict(estimator or {}),
                "limits": {"torque": 2.5},
            }
        ],
    }


def write(folder: Path, play: Play, plant_tables: Tables, controllers: Mapping[str, Tables]) -> None:
    """Write nominal model, set-point, motion, `plant.toml` and one `controller-NAME.toml` each."""
    save_model(NOMINAL, folder / "nominal.toml")
    play.write_setpoint(folder / "setpoint.csv")
    play.write_motion(folder / "motion.csv")
    (folder / "plant.toml").write_text(tomlkit.dumps(plant_tables), encoding="utf-8")
    for name, tables in controllers.items():
        (folder / f"controller-{name}.toml").write_text(tomlkit.dumps(tables), encoding="utf-8")
