"""Runs of `tsa tune` alone on rigs drawn by number, in virtual time: nothing of the nominal file is quite true.

Usage: tools/run bench/tune [--rigs 1..20] [--seed 1] [--curvature any] [--without-sensor] [--write] [-- OPTION]
A rig has its own friction, pretension, stiffness of the tendons, shape of the sheath, inertia of the motor and delay of
one to three periods (tests/virtual/rigs.py); the controller's file says nothing of motor and delay. Prints, for each
rig, the truth against the nominal file; by how much compensation reduces the RMS joint torque error with the given
file, with what tune wrote and with all that is true (model, shape, motor, delay), on a motion not used for the fit;
what tune measured over what is true; the gain margin. The last lines sum up by where the sheath bends, and over all.
With --results FILE each rig is appended to it as it ends; those that it holds are not run again, unless they failed, so
that a long list is done in slices; --write takes the reductions over into the manual's figures. With --without-sensor
the rig has none of the joint torque: the file says where the sheath bends, and the runs that are compared are made once
more with a sensor that nothing is learned from. What stands after -- are options of tsa tune.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from tests.tune import rig
from tests.virtual.rigs import CURVATURES, Drawn, draw
from tools import command
from tools.bench.results import Results, Row
from tools.manual.measure import note
from tsa_ctrl.demo.bus_choice import VIRTUAL
from tsa_ctrl.demo.rig import FADE_IN
from tsa_ctrl.errors import BusError
from tsa_ctrl.model.curvature import Points
from tsa_ctrl.model.parameters import TendonSheath, save_model
from tsa_ctrl.plant.axis import CURVATURES as SHAPES
from tsa_ctrl.system.processes import tsa
from tsa_ctrl.tune.run import read_run
from tsa_ctrl.virtual.stage import play

ASKED = ("seed", "rate", "curvature", "without_sensor", "seconds", "verify_seconds", "more")
TORQUE_LOOP = 0.5e-3  # s, of the plant's drive
SENSOR = {"node_id": 64, "heartbeat_timeout": 4.0}  # as tests/tune/rig.py has it
UNKNOWN = {"compensation": rig.COMPENSATION, "fade_in": FADE_IN}  # [axis.law] of a file that knows nothing of the motor


def drawn_by(number: int, arguments: argparse.Namespace) -> Drawn:
    """The rig of a number."""
    return draw(arguments.seed, number, None if arguments.curvature == "any" else arguments.curvature)


def asked(number: int, arguments: argparse.Namespace) -> list[Any]:
    """What a result is the answer to: options of another value make another."""
    return [number, *(getattr(arguments, name) for name in ASKED)]


def one(number: int, arguments: argparse.Namespace) -> Row:
    """Draw a rig by its number, tune it, and return what came out."""
    drawn = drawn_by(number, arguments)
    row: Row = {
        "number": number,
        "asked": asked(number, arguments),
        "truth": dict(drawn.factors),
        "curvature": drawn.curvature,
        "stiffness": drawn.stiffness,
        "inertia": drawn.inertia,
        "delay": drawn.delay,
    }
    with tempfile.TemporaryDirectory(prefix="bench-tune-") as name:
        folder = Path(name)
        controller = rig.write(folder, VIRTUAL, arguments.rate, "distributed", drawn.axis(), {"law": UNKNOWN})
        nominal = drawn.nominal
        if arguments.without_sensor:
            nominal = nominal.with_effects({"elongation_coupling": {"curvature_profile": profile_of(drawn)}})
            rig.without(controller, "torque_sensor")
            save_model(drawn.nominal, folder / "actuator.toml")  # the plant's own
            plant = (folder / "plant.toml").read_text(encoding="utf-8").replace(rig.MODEL, "actuator.toml")
            (folder / "plant.toml").write_text(plant, encoding="utf-8")
        save_model(nominal, folder / rig.MODEL)
        spans = ("--seconds", f"{arguments.seconds:g}", "--verify-seconds", f"{arguments.verify_seconds:g}")
        verb = tsa("tune", str(controller), "--virtual", "plant.toml", "--json", "--yes", *spans, "--out", "out")
        begin = time.monotonic()
        run = subprocess.run([*verb, *arguments.more], capture_output=True, text=True, check=False, cwd=folder)
        if run.returncode != 0:
            return {**row, "error": run.stderr.strip().splitlines()[-1]}
        seconds = time.monotonic() - begin
        try:
            limit = with_truth(folder, drawn, arguments.verify_seconds)
        except BusError as error:
            return {**row, "error": f"true parameters: {error}"}
        row |= {"seconds": seconds, "true": limit, **json.loads(run.stdout)}
        if arguments.without_sensor:
            row["verification"] = once_more(folder / "out", folder / "plant.toml", nominal, arguments.verify_seconds)
        return row


def profile_of(drawn: Drawn) -> Points:
    """Where the sheath of a rig bends."""
    return tuple((float(place), float(share)) for place, share in SHAPES[drawn.curvature])


def once_more(out: Path, plant: Path, nominal: TendonSheath, seconds: float) -> dict[str, dict[str, float]]:
    """The verifying runs with a sensor that only measures: RMS errors in N*m and reductions in %."""
    rms = {}
    save_model(nominal, out / "given.toml")
    for name in ("without", "before", "after"):
        data = tomllib.loads((out / f"controller-{name}.toml").read_text(encoding="utf-8"))
        model = f"new-{rig.MODEL}" if name == "after" else "given.toml"
        setpoint = {"kind": "file", "file": f"{name}.csv"}
        data["axis"][0].update(model=model, setpoint=setpoint, torque_sensor=SENSOR)
        (out / f"controller-{name}-measured.toml").write_text(tomlkit.dumps(data), encoding="utf-8")
        summary = play(out, f"{name}-measured", seconds, lambda share: None, plant)
        rms[name] = read_run(name, out / str(summary["log"]), "joint", FADE_IN, seconds).rms
    reduction = {name: 100.0 * (1.0 - rms[name] / rms["without"]) for name in ("before", "after")}
    return {"rms": rms, "reduction_percent": reduction}


def with_truth(folder: Path, drawn: Drawn, seconds: float) -> float:
    """RMS error (N*m) of the verifying motion with true parameters, form, motor and delay, all of it compensated."""
    profile = [list(point) for point in SHAPES[drawn.curvature]]
    out = folder / "out"
    save_model(drawn.truth.with_effects({"elongation_coupling": {"curvature_profile": profile}}), out / "true.toml")
    data = tomllib.loads((out / "controller-after.toml").read_text(encoding="utf-8"))
    law = {**UNKNOWN, "compensation": 1.0, "motor_inertia": drawn.inertia, "delay": true_delay(drawn)}
    data["axis"][0].update(model="true.toml", setpoint={"kind": "file", "file": "after.csv"}, law=law)
    data["axis"][0].setdefault("torque_sensor", SENSOR)
    (out / "controller-true.toml").write_text(tomlkit.dumps(data), encoding="utf-8")
    save_model(drawn.nominal, folder / rig.MODEL)  # the plant reads it, too, and tune has written it anew
    summary = play(out, "true", seconds, lambda share: None, folder / "plant.toml")
    return read_run("true", out / str(summary["log"]), "joint", FADE_IN, seconds).rms


def true_delay(drawn: Drawn, rate: float = 1000.0) -> float:
    """s from a measurement to the torque that acts: periods, half a period of hold, the drive's torque loop."""
    return (drawn.delay + 0.5) / rate + TORQUE_LOOP


def true_reduction(found: Row) -> float:
    """Per cent by which the true parameters reduce the error."""
    return 100.0 * float(1.0 - found["true"] / found["verification"]["rms"]["without"])


def spread(runs: list[Row]) -> str:
    """Median and worst reduction with the given file, the new one and the true parameters."""
    columns = [[r["verification"]["reduction_percent"][key] for r in runs] for key in ("before", "after")]
    columns.append([true_reduction(r) for r in runs])
    return ", ".join(f"{np.median(column):.1f} ({min(column):.1f})" for column in columns)


def shares(found: Row, drawn: Drawn) -> str:
    """Motor inertia, stiffness and delay that were measured, over the truth; the centre of the bending; the margin."""
    law, parameters = found["law"], found["parameters"]
    if law is None or "motor_inertia" not in law["quantities"]:
        return "motor not measured"
    stiffness = parameters["axial_stiffness"]["value"] / drawn.truth.axial_stiffness
    inertia = law["quantities"]["motor_inertia"]["value"] / drawn.inertia
    delay = law["quantities"]["delay"]["value"] / true_delay(drawn)
    centre = parameters.get("centre of the bending", {"value": float("nan")})["value"]
    margin = "none" if law["gain_margin"] is None else f"{law['gain_margin']:.1f}"
    return f"{inertia:4.2f} {stiffness:4.2f} {delay:4.2f}  {centre:4.2f}  {margin:>6s}"


def write(runs: list[Row], arguments: argparse.Namespace) -> None:
    """Take over what `tsa tune` wrote, and what all that is true gives, by where the sheath bends."""
    blind = arguments.without_sensor
    asked = f"tools/run bench/tune --rigs {arguments.rigs[0]}..{arguments.rigs[-1]} --seed {arguments.seed}"
    asked += " --without-sensor" if blind else ""
    for curvature in CURVATURES:
        part = [r for r in runs if r["curvature"] == curvature]
        tuned = [float(r["verification"]["reduction_percent"]["after"]) for r in part]
        ways = (
            ("tuned", "tuned by `tsa tune` alone", tuned),
            ("true", "true parameters", list(map(true_reduction, part))),
        )
        for key, said, values in (("blind", "tuned without a joint torque sensor", tuned),) if blind else ways:
            if values:
                words = f"rigs that bend {curvature.replace('_', ' ')}, {said}: error of the joint torque less"
                note(f"tune-{curvature}-{key}", words, values, "%", asked)


def line(number: int, found: Row, drawn: Drawn) -> str:
    factors = "  ".join(f"{value:.2f}" for value in found["truth"].values())
    motor = f"{1e4 * found['inertia']:4.2f}  {1e-3 * found['stiffness']:4.0f}  {found['delay']}"
    head = f"{number:3d}  {factors}  {motor}  {found['curvature']:10s}"
    if "error" in found:
        return f"{head}  {found['error']}"
    rms, reduction = found["verification"]["rms"], found["verification"]["reduction_percent"]
    return (
        f"{head}  {1e3 * rms['without']:7.1f}  {1e3 * rms['before']:6.1f}  {1e3 * rms['after']:6.1f}"
        f"  {reduction['before']:6.1f}  {reduction['after']:6.1f}  {true_reduction(found):6.1f}"
        f"  {shares(found, drawn)}  {'yes' if found['written'] else 'no'}  ({found['seconds']:.0f} s)"
    )


def rigs(text: str) -> range:
    """ "A..B", both included."""
    first, _, last = text.partition("..")
    if not (first.isdigit() and last.isdigit() and 0 < int(first) <= int(last)):
        raise argparse.ArgumentTypeError(f"'{text}' is no range; give two numbers as 1..20")
    return range(int(first), int(last) + 1)


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--rigs", type=rigs, default=rigs("1..20"), metavar="A..B")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rate", type=float, default=1000.0, help="of the loop, Hz")
    parser.add_argument("--curvature", choices=["any", *CURVATURES], default="any", help="where the sheath bends")
    parser.add_argument("--without-sensor", action="store_true", help="of the joint torque; the shape is told then")
    parser.add_argument("--seconds", type=float, default=20.0, help="of excitation")
    parser.add_argument("--verify-seconds", type=float, default=8.0, help="of each of the three verifying runs")
    parser.add_argument("--results", type=Path, help="a JSON object per run; those that it holds are not made again")
    parser.add_argument("--at-most", type=int, help="make so many new runs, then stop; with --results")
    parser.add_argument("--write", action="store_true", help="the reductions, as figures of the manual")
    parser.add_argument("more", nargs="*", help="further options of tsa tune, after --")
    arguments = parser.parse_args()
    print(
        f"rigs {arguments.rigs[0]}..{arguments.rigs[-1]}, seed {arguments.seed}, {arguments.rate:g} Hz; "
        "truth as a factor on nominal, J_M in 1e-4 kg*m^2, EA in kN, delay in periods; RMS joint torque error in mN*m"
    )
    columns = [f"{'':3s}", f"{'mu':4s}", f"{'T_p':4s}", f"{'EA':4s}", f"{'J_M':4s}", f"{'kN':>4s}", "d"]
    columns += [f"{'curvature':10s}", f"{'without':>7s}", f"{'given':>6s}", f"{'new':>6s}"]
    print(
        "  ".join(
            [*columns, "given%", f"{'new%':>6s}", f"{'true%':>6s}", "J_M  EA   delay", "s_c ", "margin", "written"]
        ),
        flush=True,
    )
    results, made = [], 0
    known = Results(arguments.results, lambda row: json.dumps(row.get("asked")), lambda row: "error" not in row)
    for number in arguments.rigs:
        place = json.dumps(asked(number, arguments))
        if place not in known:
            if made == arguments.at_most:
                continue
            known.add(one(number, arguments))
            made += 1
        print(line(number, known[place], drawn_by(number, arguments)), flush=True)
        results.append(known[place])
    good = [r for r in results if "error" not in r]
    print("reduction of the RMS error, %, median (worst): given file, new file, true parameters")
    for curvature in CURVATURES:
        part = [r for r in good if r["curvature"] == curvature]
        if part:
            print(f"  {curvature:10s} {len(part):2d} rigs  {spread(part)}")
    if good:
        print(f"  {'all':10s} {len(good):2d} rigs  {spread(good)}")
    print(f"{len(results) - len(good)} of {len(results)} runs failed")
    if arguments.write:
        write(good, arguments)
    return int(len(good) < len(results))
