"""Write controller, plant and actuator files of a small rig for runs in virtual time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit

from tests.plant.bench import ACTUATOR

Tables = dict[str, Any]


def merged(tables: Tables, changes: Mapping[str, Any]) -> Tables:
    """Return `tables` with `changes` applied recursively. A value None removes a key."""
    result = dict(tables)
    for key, value in changes.items():
        inner = result.pop(key, None)
        if value is not None:
            result[key] = merged(inner, value) if isinstance(inner, dict) and isinstance(value, Mapping) else value
    return result


def controller(**changes: Any) -> Tables:
    """Return a controller with one axis and a set-point of 0.5 N*m.

    `changes` go to its [[axis]], `file` to the other tables.
    """
    file = changes.pop("file", {})
    axis = {
        "name": "knee",
        "model": "actuator.toml",
        "drive": {"node_id": 1, "max_torque": 3.0},
        "encoder": {"node_id": 32},
        "torque_sensor": {"node_id": 64},
        "setpoint": {"kind": "sine", "amplitude": 0.5, "frequency": 0.5},
        "law": {"fade_in": 0.2},
        "limits": {"torque": 2.5},
    }
    return merged({"controller": {"settle_cycles": 20}, "axis": [merged(axis, changes)]}, file)


def plant(**changes: Any) -> Tables:
    """Return the plant of that axis, which moves as in a gait. `changes` go to its [[axis]]."""
    return {"physics": {"start": "first_enable"}, "axis": [merged({"name": "joint"}, changes)]}


def write(
    folder: Path, controller_tables: Tables | None = None, plant_tables: Tables | None = None
) -> tuple[Path, Path]:
    """Write the three files, and return the paths of controller and plant."""
    (folder / "actuator.toml").write_text(ACTUATOR, encoding="utf-8")
    paths = folder / "controller.toml", folder / "plant.toml"
    for path, tables in zip(paths, (controller_tables or controller(), plant_tables or plant()), strict=True):
        path.write_text(tomlkit.dumps(tables), encoding="utf-8")
    return paths


def write_provenance(path: Path, **provenance: Any) -> None:
    """Write this `[provenance]` to a model file."""
    document = tomlkit.parse(path.read_text(encoding="utf-8"))
    document["provenance"] = provenance
    path.write_text(tomlkit.dumps(document), encoding="utf-8")
