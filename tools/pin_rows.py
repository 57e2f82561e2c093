"""Define the jobs of `tools/run pins`. Each job returns a tree of numbers, names and sentences for each of its rows.

The jobs mostly use the command line, `simulate_loop`, `diagnose` and the generators in tests/blind. Therefore they also
run on other revisions.
"""

from __future__ import annotations

import itertools
import json
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from tests.blind import FAMILIES, Case, case
from tests.blind.two_encoders import names as two_encoder_names
from tests.blind.two_encoders import two_encoder_case
from tools import command

Values = dict[str, Any]

CASES = tomllib.loads((command.ROOT / "tools" / "pins.toml").read_text(encoding="utf-8"))
EVERY = 20  # samples; a row keeps every 20th value of a column, and the mean and RMS of all values
BUS_LOAD = "bus load"  # the check of `tsa doctor` that does not depend on the machine


@dataclass(frozen=True)
class Job:
    """The names of the rows, and the function that returns their values. None means that measured data are missing."""

    rows: tuple[str, ...]
    work: Callable[[Path], Sequence[Values | None]]  # receives an empty folder

    def __call__(self) -> dict[str, Values | None]:
        """Return the values of each row. If an exception occurs, its text is the value."""
        try:
            with tempfile.TemporaryDirectory(prefix="pins-") as name:
                folder = Path(name).resolve()
                text = json.dumps(self.work(folder)).replace(str(folder), "FOLDER")
            return dict(zip(self.rows, json.loads(text), strict=True))
        except Exception as error:
            return {row: {"error": f"{type(error).__name__}: {error}"} for row in self.rows}


def jobs() -> list[Job]:
    """Return all jobs, commands first. The first job compiles the plant for the others."""
    lists: list[list[str]] = list(CASES["commands"].values())
    found = [Job(tuple(f"c tsa {line}" for line in lines), partial(_commands, lines)) for lines in lists]
    found += [Job((f"a measured {name}",), partial(_measured, *files)) for name, files in CASES["measured"].items()]
    counts, virtual = dict(CASES["blind"]), CASES["virtual"]
    seed = counts.pop("seed")
    for family, count in counts.items():
        known = two_encoder_names() if family == "two_encoders" else FAMILIES[family]
        for place in range(count):
            name = known[place * len(known) // count]
            found.append(Job((f"a {family} {name} {seed + place}",), partial(_blind, family, name, seed + place)))
    axes = (virtual["joints"], virtual["set_points"], virtual["faults"])
    for (j, joint), (s, wanted), (f, fault) in itertools.product(*map(enumerate, axes)):
        sensors, shape = virtual["sensors"][(j + s + f) % 3], virtual["shapes"][(j + 2 * s + f) % 3]
        if fault != "none" or wanted == "sine":  # the time before a fault also tests a run without one
            name = f"b {joint}, {wanted}, fault {fault}, {sensors}, {shape}"
            found.append(Job((name,), partial(_loop, [joint], wanted, fault, sensors, shape)))
    two = ["weight", "limb"], "sine"
    return found + [Job((f"b two axes, fault {f}",), partial(_loop, *two, f, "sensor", "uniform")) for f in axes[2]]


def data() -> Path:
    """Return the folder of the measured sets, which may not exist."""
    return Path(os.environ.get("TSA_DATA") or command.ROOT.parent / "shared" / "data").resolve()


def _drawn(family: str, name: str, seed: int) -> Case:
    return two_encoder_case(name, seed, True) if family == "two_encoders" else case(family, name, seed, True)


def _blind(family: str, name: str, seed: int, folder: Path) -> list[Values]:
    hidden = _drawn(family, name, seed)
    (folder / "nominal.toml").write_text(hidden.model, encoding="utf-8")
    return [_diagnosis([log.columns for log in hidden.logs], folder / "nominal.toml")]


def _measured(pattern: str, model: str, _: Path) -> list[Values | None]:
    from tsa_ctrl.identify.dataset import load_logs

    files = sorted(data().glob(pattern))
    return [_diagnosis(load_logs(files), data() / model) if files else None]


def _diagnosis(logs: Sequence[Any], model: Path) -> Values:
    from tsa_ctrl.identify import diagnose
    from tsa_ctrl.model.parameters import load_model

    report: Values = json.loads(diagnose(logs, load_model(model)).to_json())
    return report


def _loop(joints: list[str], wanted: str, fault: str, sensors: str, shape: str, folder: Path) -> list[Values]:
    """Return the result of a run with its log and the plant's true values."""
    from tsa_ctrl import simulate_loop

    virtual = CASES["virtual"]
    shutil.copytree(command.CONFIG, folder, dirs_exist_ok=True)
    files = ("controller", "plant", "actuator")
    controller, plant, model = (tomllib.loads((folder / f"{file}.toml").read_text()) for file in files)
    (axis,), (rig,) = controller["axis"], plant["axis"]
    model["effects"] = {"elongation_coupling": {"curvature_profile": shape}}
    controller["controller"] |= {
        "rate": 1000.0 / len(joints),
        "settle_cycles": 20,
    }  # Hz; the bus limits the rate of two axes
    axis |= {"model": "model.toml", "setpoint": virtual["set_points"][wanted]}
    axis["law"] = {"fade_in": 0.2, "motor_inertia": 1e-4}
    rig["tendon"]["curvature"] = shape
    for part, present in (("encoder", sensors != "motor"), ("torque_sensor", sensors == "sensor")):
        rig[part] = {**rig.get(part, {}), "present": present}
        if not present:
            del axis[part]
    controller["axis"] = [_placed(axis, place, joint) for place, joint in enumerate(joints)]
    plant["axis"] = [{**_placed(rig, place, joint), "joint": {"load": joint}} for place, joint in enumerate(joints)]
    for file, tables in (("controller", controller), ("plant", plant), ("model", model)):
        (folder / f"{file}.toml").write_text(tomlkit.dumps(tables), encoding="utf-8")
    last = f"axis={joints[-1]}"
    faults, changes = ([line.format(axis=last) for line in lines] for lines in virtual["faults"][fault])
    paths = folder / "controller.toml", folder / "plant.toml"
    result = simulate_loop(*paths, virtual["seconds"], faults=faults, changes=changes)
    axes = {each.name: {"log": _columns(each.log), "truth": _columns(each.truth)} for each in result.axes}
    return [{"result": result.to_dict(), **axes}]


def _placed(axis: Values, place: int, name: str) -> Values:
    """Return the tables of an axis with the nodes of its place on the bus."""
    nodes = {"drive": 1 + place, "encoder": 32 + place, "torque_sensor": 64 + place}
    tables = {part: {**axis[part], "node_id": n, "serial_number": n} for part, n in nodes.items() if part in axis}
    return {**axis, "name": name, **tables}


def _columns(table: Mapping[str, Any]) -> Values:
    """Return, for each column, the number, mean and RMS of its finite values, and every 20th value."""
    found = {}
    for name, column in table.items():
        finite = column[np.isfinite(column)]
        mean, square = (float(np.mean(each)) if finite.size else 0.0 for each in (finite, np.square(finite)))
        found[name] = {"finite": finite.size, "mean": mean, "rms": square**0.5, "values": column[::EVERY].tolist()}
    return found


def _table(text: str) -> Values:
    """Return the columns of a CSV file, with nan for text."""
    table = np.genfromtxt(text.splitlines(), delimiter=",", names=True)
    return _columns({name: table[name].reshape(-1) for name in table.dtype.names or ()})


READERS: dict[str, Callable[[str], Values]] = {".toml": tomllib.loads, ".json": json.loads, ".csv": _table}


def _commands(lines: Sequence[str], folder: Path) -> list[Values | None]:
    """Run the commands one after another in one folder, and return output and files of each command."""
    leg = data() / "legactuator" / "torqueripple1.txt"
    if "leg.txt" in lines[0] and not leg.is_file():
        return [None] * len(lines)
    shutil.copytree(command.CONFIG, folder / "config")
    (folder / "two").mkdir()
    for path, name in (("one", "stribeck_friction"), ("two/a", "viscous_friction"), ("two/b", "gravity_load")):
        hidden = _drawn("single", name, CASES["blind"]["seed"])
        (folder / f"{path[:3]}.toml").write_text(hidden.model, encoding="utf-8")
        table = hidden.logs[0].columns
        rows = np.column_stack(list(table.values()))
        np.savetxt(folder / f"{path}.csv", rows, "%.9g", ",", header=",".join(table), comments="")
    t = np.arange(0.0, 10.0, 0.01)
    foreign = np.column_stack([t, np.sign(np.cos(t)), np.degrees(np.sin(t))])
    np.savetxt(folder / "foreign.txt", foreign, "%.4f", ";", header="Zeit;Moment;Winkel", comments="")
    if leg.is_file():
        shutil.copy(leg, folder / "leg.txt")
    (folder / "drive.toml").write_text('[actuator]\nkind = "rigid_drive"\ncoulomb_friction = 0.1\n', encoding="utf-8")
    return [_command(folder, line) for line in lines]


def _command(folder: Path, line: str) -> Values:
    """Return exit code, output and written files of a command."""
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    fixed = {"PYTHONPATH": str(command.ROOT), "TSA_DATA": "none", "COLUMNS": "200", "LC_ALL": "C.UTF-8"}
    call, environment = [sys.executable, "-m", "tsa_ctrl", *line.split()], {**os.environ, **fixed}
    done = subprocess.run(call, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    printed: Any = json.loads(done.stdout) if "--json" in line and done.stdout else done.stdout.splitlines()
    if line.startswith("doctor"):
        return {"checks": [check for check in printed["checks"] if check["name"] == BUS_LOAD]}
    notes = [each for each in done.stderr.splitlines() if not each.startswith("tsa: compiling")]
    paths = [path for path in folder.rglob("*.*") if path.is_file() and path.stat().st_mtime_ns != before.get(path)]
    texts = {
        path: path.read_text(encoding="utf-8")
        for path in sorted(paths)
        if path.suffix in READERS and path.name != "verdicts.csv"
    }
    files = {str(p.relative_to(folder)): READERS[p.suffix](t) for p, t in texts.items()}
    return {"exit": done.returncode, "printed": printed, "notes": notes, "files": files}
