"""Runs of `tsa tune` on simulated rigs: nominal parameters off by up to 20 %, noise, quantisation.

Usage: tools/vcan tools/run bench/tune [--runs 20] [--seed 1] [--rate 1000] [--tendon distributed] [--seconds 20] ...
Prints, for each run, the truth against the nominal file, and by how much compensation reduces the RMS joint torque
error with the given, with the new file and with the true parameters, on a motion not used for the fit; and the form of
model that tune chose. The last lines sum up by where the sheath bends.
With --results FILE each run is appended to it as it ends; those that it holds are not made again, unless they failed.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import tempfile
import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from tests.tune import rig
from tools import command
from tools.bench.results import Results, Row
from tsa_ctrl.demo.bus_choice import choose
from tsa_ctrl.demo.rig import FADE_IN, NOMINAL
from tsa_ctrl.errors import BusError
from tsa_ctrl.model.parameters import save_model
from tsa_ctrl.system.processes import daemon, plant, tsa
from tsa_ctrl.tune.run import read_run

OFF = 0.2  # nominal over true, minus 1
PERTURBED = ("friction_coefficient", "pretension", "axial_stiffness")
CURVATURES = ("uniform", "motor_end", "joint_end")
ENCODER_LAG = 1.0 / (2.0 * math.pi * 50.0)  # s, of the controller's own low-pass, [axis.encoder] velocity_cutoff


def one(number: int, arguments: argparse.Namespace) -> Row:
    """Draw a rig by its number, tune it, and return what came out."""
    rng = np.random.default_rng([arguments.seed, number])
    truth = {name: float(1.0 / (1.0 + rng.uniform(-OFF, OFF))) for name in PERTURBED}
    curvature = str(rng.choice(CURVATURES)) if arguments.curvature == "any" else arguments.curvature
    drawn = {"number": number, "truth": truth, "curvature": curvature}
    with tempfile.TemporaryDirectory(prefix="bench-tune-") as name:
        folder = Path(name)
        changes: dict[str, dict[str, Any]] = {"perturbation": truth, "tendon": {"curvature": curvature}}
        controller = rig.write(folder, choose(arguments.bus), arguments.rate, arguments.tendon, changes)
        spans = ("--seconds", f"{arguments.seconds:g}", "--verify-seconds", f"{arguments.verify_seconds:g}")
        verb = tsa("tune", str(controller), "--json", "--yes", *spans, "--out", str(folder / "out"), *arguments.more)
        begin = time.monotonic()
        with plant(folder):
            run = subprocess.run(verb, capture_output=True, text=True, check=False, cwd=folder)
            if run.returncode != 0:
                return {**drawn, "error": run.stderr.strip().splitlines()[-1]}
            seconds = time.monotonic() - begin
            try:
                limit = with_truth(folder / "out", truth, curvature, arguments.verify_seconds)
            except BusError as error:
                return {**drawn, "error": f"true parameters: {error}"}
        return {**drawn, "seconds": seconds, "true": limit, **json.loads(run.stdout)}


def with_truth(folder: Path, truth: dict[str, float], curvature: str, seconds: float) -> float:
    """RMS error (N*m) of the verifying motion with the true parameters, form and lag, and the slew that was found."""
    angle, tension = truth["friction_coefficient"], truth["pretension"]
    effects: dict[str, dict[str, object]] = {"velocity_lag": {"time_constant": ENCODER_LAG}}
    if curvature != "joint_end":
        effects["elongation_coupling"] = {"curvature_profile": curvature}
    model = NOMINAL.recalibrated(NOMINAL.friction_angle * angle, NOMINAL.pretension * tension).with_effects(effects)
    save_model(model, folder / "true.toml")
    data = tomllib.loads((folder / "controller-after.toml").read_text(encoding="utf-8"))
    data["axis"][0].update(model="true.toml", setpoint={"kind": "file", "file": "after.csv"})
    (folder / "controller-true.toml").write_text(tomlkit.dumps(data), encoding="utf-8")
    summary = daemon(folder, "true", seconds, lambda share: None)
    return read_run("true", folder / str(summary["log"]), "joint", FADE_IN, seconds).rms


def true_reduction(found: Row) -> float:
    """Per cent by which the true parameters reduce the error."""
    return 100.0 * float(1.0 - found["true"] / found["verification"]["rms"]["without"])


def spread(runs: list[Row]) -> list[str]:
    """Median and worst reduction with the given file, the new one and the true parameters."""
    columns = [[r["verification"]["reduction_percent"][key] for r in runs] for key in ("before", "after")]
    columns.append([true_reduction(r) for r in runs])
    return [f"{np.median(column):.1f} ({min(column):.1f})" for column in columns]


def line(number: int, found: Row) -> str:
    factors = "  ".join(f"{value:.2f}" for value in found["truth"].values())
    head = f"{number:3d}  {factors}  {found['curvature']:10s}"
    if "error" in found:
        return f"{head}  {found['error']}"
    rms, reduction = found["verification"]["rms"], found["verification"]["reduction_percent"]
    effects = ", ".join(found["effects"])
    return (
        f"{head}  {1e3 * rms['without']:7.1f}  {1e3 * rms['before']:6.1f}  {1e3 * rms['after']:6.1f}"
        f"  {reduction['before']:6.1f}  {reduction['after']:6.1f}  {true_reduction(found):6.1f}"
        f"  {'yes' if found['written'] else 'no ':3s}"
        f"  {found['form']}{' + ' + effects if effects else ''}  ({found['seconds']:.0f} s)"
    )


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rate", type=float, default=1000.0, help="of the loop, Hz")
    parser.add_argument("--tendon", choices=["full", "distributed"], default="distributed", help="the plant's")
    parser.add_argument("--curvature", choices=["any", *CURVATURES], default="any", help="where the sheath bends")
    parser.add_argument("--seconds", type=float, default=20.0, help="of excitation")
    parser.add_argument("--verify-seconds", type=float, default=8.0, help="of each of the three verifying runs")
    parser.add_argument("--bus", help="CAN interface, or INTERFACE:CHANNEL of python-can; default: the best there is")
    parser.add_argument("--results", type=Path, help="a JSON object per run; those that it holds are not made again")
    parser.add_argument("--at-most", type=int, help="make so many new runs, then stop; with --results")
    parser.add_argument("more", nargs="*", help="further options of tsa tune, after --")
    arguments = parser.parse_args()
    print(
        f"{arguments.runs} runs, seed {arguments.seed}, {arguments.tendon} tendons, {arguments.rate:g} Hz; "
        "truth as a factor on nominal; RMS joint torque error in mN*m"
    )
    print(
        f"{'':3s}  {'mu':4s}  {'T_p':4s}  {'EA':4s}  {'curvature':10s}  {'without':>7s}  {'given':>6s}  {'new':>6s}"
        f"  {'given%':>6s}  {'new%':>6s}  {'true%':>6s}  new  form",
        flush=True,
    )
    results, made = [], 0
    known = Results(arguments.results, lambda row: row["number"], lambda row: "error" not in row)
    for number in range(1, arguments.runs + 1):
        if number not in known:
            if made == arguments.at_most:
                continue
            known.add(one(number, arguments))
            made += 1
        print(line(number, known[number]), flush=True)
        results.append(known[number])
    good = [r for r in results if "error" not in r]
    print("reduction of the RMS error, %, median (worst): given file, new file, true parameters")
    for curvature in CURVATURES:
        part = [r for r in good if r["curvature"] == curvature]
        if part:
            print(f"  {curvature:10s} {len(part):2d} rigs  {', '.join(spread(part))}")
    print(f"{len(results) - len(good)} of {len(results)} runs failed")
    return int(len(good) < len(results))
