"""Measure the error of the delivered torque for each load, curvature profile of the sheath and law.

Usage: tools/run bench/control [--joints held weight ...] [--shapes uniform ...] [--delay 1] [--inertia 1e-4] [--json]
       [--rows FILE] [--brief] [--angles 0.05 0.8 ...] [--off 0.2]

The real loop runs on the plant with distributed tendons in virtual time, so a repeated command prints the same figures.
The laws are: none (compensation 0, true file), (3.55) with the nominal file, the files of `tsa tune` and `tsa tune
--extended` for a prescribed motion, and the true parameters. Errors are the plant's joint torque minus the set-point
after the fade-in. "jerk" is the RMS rate of the error around reversals. "at rest" is the joint's RMS speed at set-point
0 after the motion. A fault that ended a run is printed below the table.

  --rows FILE   rows of the file are not run again, and the table has old and new rows
  --brief       one row for each shape and joint with "RMS, 99 %, peak; jerk" of each law
  --angles      friction angles x of the plant, each with sufficient limits of torque and rate
  --off         relative error of friction and stiffness in the nominal file; the pretension has the opposite error
"""

from __future__ import annotations

import argparse
import itertools
import json
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from rich.console import Console
from rich.table import Table

from tests.virtual.joints import rms
from tools import command
from tools.bench.rigs import confine, plant_drive
from tools.campaign.passive.experiment import true_model
from tools.command import Results, Row
from tsa_ctrl.control.law_design import LAG
from tsa_ctrl.demo import rig
from tsa_ctrl.demo.rig import VIRTUAL, gait, play_for
from tsa_ctrl.model.curvature import Points
from tsa_ctrl.model.feedforward import Feedforward
from tsa_ctrl.model.parameters import TendonSheath, load_tendon_sheath, save_model
from tsa_ctrl.system.process_supervisor import tsa
from tsa_ctrl.virtual.result import AxisResult
from tsa_ctrl.virtual.script import Change
from tsa_ctrl.virtual.simulation import simulate_loop

JOINTS = ("imposed", "held", "spring", "weight", "free", "limb", "wearer")
SHAPES = {  # name of the option -> name in the tables
    "uniform": "uniform",
    "motor_end": "motor end",
    "last_tenth": "last 10 %",
    "joint_end": "point bend at the joint",
    "s_bent": "S-bent",
}
LAST_TENTH: Points = ((0.0, 0.0), (0.9, 0.0), (1.0, 1.0))  # evenly bent within the last 10 % of the length
LAWS = ("none", "(3.55)", "tuned", "extended", "true")
NOMINAL_SHARE, TRUE_SHARE = 0.95, 1.0  # of the friction term: as shipped, and with the true parameters
TO_REST, REST = 3.0, 2.0  # s; the set-point gain fades to 0 within 2 s, and the speed is measured after 3 s
WIDTH = 190  # characters of a table
WINDOW = 0.05  # s on each side of a reversal, longer than the reversal of the friction term
LEAST_SPEED = 0.05  # rad/s of a joint on both sides of a reversal; slower motion is creep


@dataclass(frozen=True)
class Case:
    """Friction angle `x` of the plant, and relative error `off` of the nominal file. None is the demo's value."""

    x: float | None = None
    off: float | None = None

    @property
    def factors(self) -> dict[str, float]:
        """Return the true parameters over the nominal ones."""
        if self.off is None:
            return dict(rig.TRUTH)
        more, less = 1.0 + self.off, 1.0 - self.off
        return {"friction_coefficient": 1.0 / more, "pretension": 1.0 / less, "axial_stiffness": 1.0 / more}

    @property
    def nominal(self) -> TendonSheath:
        """Return the model of the controller's file."""
        x = rig.NOMINAL.friction_angle if self.x is None else self.x / self.factors["friction_coefficient"]
        return rig.NOMINAL.recalibrated(x, rig.NOMINAL.pretension * (1.0 - (self.off or 0.0)))

    def torque(self, model: TendonSheath) -> float:
        """Return a limit of the motor torque, N*m, that is sufficient for 1 N*m at the joint."""
        most = max(abs(Feedforward(model, 1e-3).update(tau, way, way)) for tau in (-1.0, 1.0) for way in (-1.0, 1.0))
        return 2.5 if self.x is None else max(2.5, 1.3 * most)

    def confine(self, tables: rig.Tables, model: TendonSheath) -> None:
        """Set the torque limits in a controller's tables."""
        if self.x is not None:
            confine(tables["axis"][0], self.torque(model))


DEMO = Case()


def controller(folder: Path, law: str, rate: float) -> rig.Tables:
    """Return the controller tables of one law. The results of tuning are in `folder`/LAW/out."""
    if law in ("tuned", "extended"):
        tables = tomlkit.parse((folder / law / "out" / "controller-tune.toml").read_text(encoding="utf-8")).unwrap()
        tables["axis"][0]["model"] = f"{law}/out/nominal.toml"
        return dict(tables)
    shares = {"none": 0.0, "(3.55)": NOMINAL_SHARE, "true": TRUE_SHARE}
    return rig.controller(VIRTUAL, "run", rate, "nominal.toml" if law == "(3.55)" else "true.toml", shares[law])


def tune(folder: Path, law: str, axis: dict[str, Any], rate: float, case: Case) -> str:
    """Tune the nominal file with a prescribed motion in `folder`/LAW. Return the last error line, or "" on success."""
    place = folder / law
    place.mkdir()
    tables = {"tune": rig.controller(VIRTUAL, "tune", rate, "nominal.toml", NOMINAL_SHARE)}
    case.confine(tables["tune"], load_tendon_sheath(folder / "true.toml"))
    rig.write(place, gait(), rig.plant(VIRTUAL, "distributed", axis), tables)
    save_model(case.nominal, place / "nominal.toml")
    options = ["--extended"] if law == "extended" else []
    verb = tsa("tune", "controller-tune.toml", "--virtual", "plant.toml", "--yes", "--json", "--out", "out", *options)
    run = subprocess.run(verb, cwd=place, capture_output=True, text=True, check=False)
    return "" if run.returncode == 0 else run.stderr.strip().splitlines()[-1]


def play(folder: Path, joint: str, axis: dict[str, Any], law: str, rate: float, cycles: int, case: Case = DEMO) -> Row:
    """Run one law with one load, first for some periods of the set-point and then at 0. Return the measured errors."""
    played = play_for(joint)
    seconds = played.seconds if joint == "wearer" else rig.FADE_IN + cycles * float(played.t[-1])
    tables = controller(folder, law, rate)
    tables["axis"][0]["setpoint"] = {"kind": "file", "file": "setpoint.csv", "loop": True}
    if law == "true":
        late = (axis["drive"]["delay_periods"] + 1.5) / rate + axis["drive"].get("torque_time_constant", LAG)
        tables["axis"][0]["law"] |= {"motor_inertia": axis["motor"]["inertia"], "delay": late}
    case.confine(tables, load_tendon_sheath(folder / "true.toml"))
    rig.write(folder, played, rig.plant(VIRTUAL, "distributed", axis, joint), {"run": tables})
    save_model(case.nominal, folder / "nominal.toml")
    rest = 0.5 if joint in ("imposed", "held") else REST  # their speed at rest is not evaluated
    end = seconds + 0.2  # the first cycles have no torque yet
    result = simulate_loop(
        folder / "controller-run.toml",
        folder / "plant.toml",
        seconds + TO_REST + rest,
        changes=[Change("setpoint_gain", 0.0, end)],
    )
    run = result.axes[0]
    found: Row = {"stopped": f"at {run.until:.2f} s: {run.faults[0]}"} if run.faults else {}
    if not run.error.size:  # a fault during the fade-in
        return found
    return {**measure(run, end, end + TO_REST), **found}


def measure(axis: AxisResult, playing: float, rests: float) -> Row:
    """Return RMS, 99th percentile and peak of the error, N*m, its jerk, N*m/s, and the joint's speed at rest, rad/s.

    The set-point is played until the time `playing` (s) of the log. The speed at rest is evaluated after the time
    `rests` (s). The jerk is None if the joint never reverses, or if the joint rests and its set-point never reverses.
    """
    log, truth = axis.log, axis.truth
    counted = axis.counted & (log["t"] < playing)
    t, omega, wanted = (log[name][counted] for name in ("t", "omega_j", "tau_j_des"))
    error = axis.delivered[counted] - wanted
    direction = omega if np.abs(omega).max() > LEAST_SPEED else np.gradient(wanted, t)
    fast = np.flatnonzero(np.abs(direction) > LEAST_SPEED)
    reversed_ = np.diff(np.sign(direction[fast])) != 0
    near = np.zeros(t.size, dtype=bool)
    for before, after in zip(t[fast[:-1][reversed_]], t[fast[1:][reversed_]], strict=True):
        near |= (t >= before - WINDOW) & (t <= after + WINDOW)
    resting = (truth["clock"] - axis.start >= rests) & (truth["clock"] - axis.start < axis.until)
    return {
        "rms": rms(error),
        "p99": float(np.percentile(np.abs(error), 99.0)),
        "peak": float(np.abs(error).max()),
        "jerk": rms(np.gradient(error, t)[near]) if near.any() else None,
        "resting_speed": rms(truth["omega_j"][resting]),
    }


def rows(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield one row for each load, shape and law, or one row for the shape and the law if tuning failed."""
    drive = {"delay_periods": arguments.delay - 1}
    kept = Results(arguments.rows, lambda row: (row["shape"], row["joint"], row["law"], row.get("x")))
    for shape, x in itertools.product(arguments.shapes, arguments.angles or [None]):
        case, profile = Case(x, arguments.off), LAST_TENTH if shape == "last_tenth" else shape
        axis = {"tendon": {"curvature": profile}, "motor": {"inertia": arguments.inertia}}
        model = true_model(profile, case.nominal, case.factors)
        axis |= {"drive": {**drive, **plant_drive(case.torque(model))}, "perturbation": case.factors}
        missing = {law for law in arguments.laws for joint in arguments.joints if (shape, joint, law, x) not in kept}
        with tempfile.TemporaryDirectory(prefix="bench-control-") as name:
            folder = Path(name)
            save_model(model, folder / "true.toml")
            tuned = [law for law in ("tuned", "extended") if law in missing]
            failed = {law: tune(folder, law, axis, arguments.rate, case) for law in tuned}
            for law, reason in failed.items():
                if reason:
                    yield {"shape": shape, "law": law, "x": x, "failed": reason}
            for joint in arguments.joints:
                for law in arguments.laws:
                    if failed.get(law):
                        continue
                    if (shape, joint, law, x) not in kept:
                        found = play(folder, joint, axis, law, arguments.rate, arguments.cycles, case)
                        if "rms" not in found:
                            yield {"shape": shape, "law": law, "x": x, "failed": f"{joint}, stopped {found['stopped']}"}
                            continue
                        kept.add({"shape": shape, "joint": joint, "law": law, "x": x, **found})
                    yield kept[shape, joint, law, x]


def whole(found: Sequence[Row]) -> Table:
    """Return the table with a row for each shape, load and law."""
    heads = ("shape", "x", "joint", "law", "RMS (mN·m)", "99 %", "peak", "jerk (N·m/s)", "at rest (rad/s)", "reduction")
    table = Table(*heads)
    none = {(row["shape"], row["joint"], row.get("x")): row["rms"] for row in found if row["law"] == "none"}
    for row in found:
        without = none.get((row["shape"], row["joint"], row.get("x")))
        reduction = "-" if without is None else f"{100.0 * (1.0 - row['rms'] / without):.1f} %"
        errors = (f"{1e3 * row[key]:.1f}" for key in ("rms", "p99", "peak"))
        x = "-" if row.get("x") is None else f"{row['x']:g}"
        table.add_row(SHAPES[row["shape"]], x, row["joint"], row["law"], *errors, _jerk(row), _rest(row), reduction)
    return table


def brief(found: Sequence[Row]) -> Table:
    """Return a row for each shape and load, with RMS, 99th percentile, peak (mN*m) and jerk (N*m/s) of each law."""
    laws = [law for law in LAWS if any(row["law"] == law for row in found)]
    table = Table("shape", "joint", *laws, "at rest (rad/s)")
    cells: dict[tuple[str, str], dict[str, Row]] = {}
    for row in found:
        shape = SHAPES[row["shape"]] + ("" if row.get("x") is None else f", x {row['x']:g}")
        cells.setdefault((shape, row["joint"]), {})[row["law"]] = row
    for (shape, joint), of in cells.items():
        worst = max(of.values(), key=lambda row: float(row["resting_speed"]))
        table.add_row(shape, joint, *(_brief(of.get(law)) for law in laws), _rest(worst))
    return table


def _brief(row: Row | None) -> str:
    if row is None:
        return "-"
    return ", ".join(f"{1e3 * row[key]:.0f}" for key in ("rms", "p99", "peak")) + f"; {_jerk(row)}"


def _jerk(row: Row) -> str:
    return "-" if row["jerk"] is None else f"{row['jerk']:.2f}"


def _rest(row: Row) -> str:
    return "-" if row["joint"] in ("imposed", "held") else f"{row['resting_speed']:.3f}"


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--joints", nargs="+", choices=JOINTS, default=JOINTS)
    parser.add_argument(
        "--shapes", nargs="+", choices=tuple(SHAPES), default=tuple(SHAPES)[:4], help="of the sheath's bending"
    )
    parser.add_argument("--laws", nargs="+", choices=LAWS, default=LAWS)
    parser.add_argument("--rate", type=float, default=1000.0, help="of the loop, Hz (default 1000)")
    parser.add_argument("--delay", type=int, choices=range(1, 9), default=1, help="periods from measurement to torque")
    parser.add_argument("--inertia", type=float, default=1e-4, help="of the motor, kg*m^2 (default 1e-4)")
    parser.add_argument("--cycles", type=int, default=4, help="periods of the set-point (default 4)")
    parser.add_argument("--angles", nargs="+", type=float, help="friction angles x of the plant, 1")
    parser.add_argument("--off", type=float, help="relative error of the nominal file, 1")
    parser.add_argument("--rows", type=Path, help="file with the rows of earlier runs, to which new rows are added")
    parser.add_argument("--brief", action="store_true", help="a row for each shape and joint")
    parser.add_argument("--json", action="store_true", help="print one JSON object per line instead of a table")
    arguments = parser.parse_args()
    console = Console(width=WIDTH)
    found = []
    for row in rows(arguments):
        if arguments.json:
            print(json.dumps(row), flush=True)
        elif "failed" in row:
            console.print(f"{row['shape']}, {row['law']}: {row['failed']}")
        else:
            found.append(row)
    if not arguments.json:
        console.print(brief(found) if arguments.brief else whole(found))
        for row in found:
            if "stopped" in row:
                console.print(f"{row['shape']}, {row['joint']}, {row['law']}: stopped {row['stopped']}")
    return 0
