"""Tune random rigs with the effects of real rigs by `tsa tune`, and evaluate the controllers on other runs.

Usage: tools/run bench/rigs [--rigs 6] [--seed N] [--first 0] [--rate 1000] [--rows FILE] [--keep FOLDER] [--json]

Seed and number determine a random rig: friction angle (0.05 to 1.2), curvature profile, motor inertia, delay, noise and
encoders (12 to 20 bit). A rig also has a random choice of torque ripple, friction of the motor's gear, backlash, an
eccentric pulley, and drift by temperature or relaxation. The controller's file is wrong by up to 20 % and has none of
the effects. `tsa tune --virtual` uses no other information on the plant. The tuned controller then runs without changes
on a prescribed motion, a locked joint and a human-in-the-loop load, and with a sine of 20 mN*m on the locked joint.

Reduction = 1 - RMS error / RMS error without compensation. The error is the plant's joint torque minus the set-point
after the fade-in. The last column is the RMS error of the small sine, whose RMS is 14.1 mN*m. Without --seed every run
has other rigs, and prints its seed. --keep writes the files of each rig to a folder and keeps them.

"ratio" compares the error with a prescribed motion to the limit of this rig: the larger of 5 % of the error without
compensation and the error that remains after learning. If the error exceeds 5 %, a periodic correction of the set-point
is learned in `ITERATIONS` runs from the plant's joint torque, which no controller knows. The smallest error of these
runs counts.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import subprocess
import tempfile
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from rich.table import Table
from scipy.ndimage import gaussian_filter1d

from tests.virtual.joints import rms
from tools import command
from tools.command import Row
from tsa_ctrl.demo import rig as demo
from tsa_ctrl.demo.rig import VIRTUAL, gait, play_for
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.model.curvature import Points, Profile
from tsa_ctrl.model.feedforward import Feedforward
from tsa_ctrl.model.parameters import TendonSheath, save_model
from tsa_ctrl.system.process_supervisor import tsa
from tsa_ctrl.virtual.result import AxisResult
from tsa_ctrl.virtual.simulation import simulate_loop

X = (0.05, 1.2)  # 1, friction angle
THETA = 6.0  # rad, largest wrap angle: a friction coefficient of 0.2 at the largest x
LEAST_FRICTION = 0.03  # 1, friction coefficient of a lubricated polymer; a rig with a smaller x is bent less
OFF = 0.2  # file over truth minus 1, largest magnitude: friction, pretension, stiffness
INERTIA = (3e-5, 6e-4)  # kg*m^2 at the motor pulley
STIFFNESS = (0.6, 1.8)  # of the demo's tendons
PRESENT = 0.5  # probability of each effect
SMALL = 0.02  # N*m, amplitude of the small sine
SECONDS = {"imposed": 4.4, "held": 4.4, "wearer": 9.0, "small": 5.2}  # s of torque, including 1 s of fade-in
SHARE = 0.05  # of the error without compensation; a rig below it needs no comparison with a learned command
ITERATIONS = 12  # runs; on the three rigs that were watched, none after the third had a clearly smaller error
STEP, SMOOTH = 0.5, 4e-3  # 1 and s: share of the error that a run corrects, and the width of its smoothing
MOST_LEARNED = 0.25  # N*m of set-point; an error within the backlash cannot be corrected, and its correction would grow
TUNING = ("--seconds", "20", "--verify-seconds", "8")


def rated_torque(torque: float) -> float:
    """Return a rated torque of the drive, N*m, for a limit of `torque` N*m.

    A drive accepts a max torque (0x6072) up to a few times its rated torque, so both must grow together.
    """
    return max(1.0, torque / 3.0)


def plant_drive(torque: float) -> dict[str, float]:
    """Return the keys of the plant's drive that a controller's limit of `torque` N*m requires."""
    return {"peak_torque": 1.5 * torque, "rated_torque": rated_torque(torque)}


def confine(axis: dict[str, Any], torque: float) -> None:
    """Set the limits in a controller's table of an axis to `torque` N*m; the plant's drive needs `plant_drive`."""
    axis["limits"] |= {"torque": torque, "rate": 80.0 * torque}
    axis["drive"] |= {"max_torque": 1.2 * torque, "rated_torque": rated_torque(torque)}


@dataclass(frozen=True)
class Rig:
    """One rig. `effects` are the plant's effects. `temperature` has rows of s, deg C. `bits` is for both encoders."""

    seed: int
    number: int
    truth: TendonSheath
    nominal: TendonSheath
    profile: Points
    inertia: float  # kg*m^2
    delay: int  # periods
    noise: float  # N*m, of the joint torque sensor
    bits: tuple[int, int]
    rate: float  # Hz of the loop
    effects: dict[str, dict[str, Any]]
    temperature: list[list[float]]

    @property
    def torque(self) -> float:
        """Return a limit of the motor torque, N*m, that is sufficient for 1 N*m at the joint."""
        model = self.truth.with_effects({"elongation_coupling": {"curvature_profile": self.profile}})
        most = max(abs(Feedforward(model, 1e-3).update(tau, way, way)) for tau in (-1.0, 1.0) for way in (-1.0, 1.0))
        return max(2.5, 1.4 * most)

    def plant(self, joint: str) -> dict[str, Any]:
        """Return the plant's tables with the load `joint`."""
        axis: dict[str, dict[str, Any]] = {
            "tendon": {"curvature": [list(point) for point in self.profile]},
            "motor": {"inertia": self.inertia},
            "drive": {
                "delay_periods": self.delay - 1,
                "counts_per_revolution": 2 ** self.bits[0],
                **plant_drive(self.torque),
            },
            "encoder": {"counts_per_revolution": 2 ** self.bits[1]},
            "torque_sensor": {"noise": self.noise},
            "environment": {"temperature": self.temperature},
        }
        tables = demo.plant(VIRTUAL, "distributed", axis, joint)
        tables["axis"][0] |= {"actuator": "truth.toml", "perturbation": {}, "effects": self.effects}
        tables["physics"]["seed"] = (self.seed + self.number) % 2**31
        return tables

    def controller(self) -> dict[str, Any]:
        """Return the controller's tables, with the true data of encoders and drive and the inaccurate model file."""
        tables = demo.controller(VIRTUAL, "tune", self.rate, "nominal.toml", 0.95)
        axis = tables["axis"][0]
        axis["law"] = {"compensation": 0.95, "fade_in": demo.FADE_IN}
        confine(axis, self.torque)
        axis["drive"]["counts_per_revolution"] = 2 ** self.bits[0]
        axis["encoder"]["counts_per_revolution"] = 2 ** self.bits[1]
        return tables

    def write(self, folder: Path) -> None:
        """Write the model files, the motions, one plant per joint and the controller."""
        folder.mkdir(parents=True, exist_ok=True)
        save_model(self.truth, folder / "truth.toml")
        save_model(self.nominal, folder / "nominal.toml")
        gait().write_motion(folder / "motion.csv")
        for joint in ("imposed", "held", "wearer"):
            play_for(joint).write_setpoint(folder / f"{joint}.csv")
            (folder / f"plant-{joint}.toml").write_text(tomlkit.dumps(self.plant(joint)), encoding="utf-8")
        (folder / "setpoint.csv").write_bytes((folder / "imposed.csv").read_bytes())
        (folder / "controller.toml").write_text(tomlkit.dumps(self.controller()), encoding="utf-8")


def draw(seed: int, number: int, rate: float = 1000.0) -> Rig:
    """Return the rig of this seed and number, whose loop has the rate `rate` (Hz)."""
    rng = np.random.default_rng([seed, number])
    x = float(rng.uniform(*X))
    stiffness = demo.NOMINAL.axial_stiffness * math.exp(rng.uniform(*np.log(STIFFNESS)))
    tension = float(rng.uniform(35.0, 55.0))
    theta = min(THETA, x / LEAST_FRICTION)
    bent = dataclasses.replace(demo.NOMINAL, bending_angle=theta, bending_centre=None, axial_stiffness=stiffness)
    truth = bent.recalibrated(x, tension)
    off = 1.0 + rng.uniform(-OFF, OFF, 3)
    nominal = truth.recalibrated(float(off[0]) * x, float(off[1]) * tension)
    nominal = dataclasses.replace(nominal, axial_stiffness=float(off[2]) * stiffness)
    effects, temperature = drawn_effects(rng)
    return Rig(
        seed=seed,
        number=number,
        truth=truth,
        nominal=nominal,
        profile=drawn_profile(rng),
        inertia=math.exp(rng.uniform(*np.log(INERTIA))),
        delay=int(rng.integers(1, 4)),
        noise=math.exp(rng.uniform(math.log(2e-3), math.log(2e-2))),
        bits=(int(rng.integers(12, 21)), int(rng.integers(12, 21))),
        rate=rate,
        effects=effects,
        temperature=temperature,
    )


def drawn_profile(rng: np.random.Generator) -> Points:
    """Return a profile of one to three random bends, as points (share of the length, share of the wrap angle)."""
    count = int(rng.integers(1, 4))
    begins = rng.uniform(0.0, 0.98, count)
    ends = np.minimum(1.0, begins + np.exp(rng.uniform(math.log(0.02), 0.0, count)))
    weights = rng.dirichlet(np.ones(count))
    places = np.unique(np.concatenate([[0.0, 1.0], begins, ends]).round(6))
    shares = sum(w * np.clip((places - a) / (b - a), 0.0, 1.0) for w, a, b in zip(weights, begins, ends, strict=True))
    values = np.maximum.accumulate(np.asarray(shares).round(9))
    values[0], values[-1] = 0.0, 1.0
    return tuple((float(u), float(b)) for u, b in zip(places, values, strict=True))


def drawn_effects(rng: np.random.Generator) -> tuple[dict[str, dict[str, Any]], list[list[float]]]:
    """Return the plant's effects, each with the probability `PRESENT`, and the temperature over time."""
    phase = float(rng.uniform(-math.pi, math.pi))
    cycles = int(rng.choice([6, 12, 24, 36]))
    gap = float(rng.uniform(0.5e-3, 3e-3))  # rad of the joint
    choices: dict[str, dict[str, Any]] = {
        "torque_ripple": {
            "amplitude": float(rng.uniform(5e-3, 4e-2)),
            "cycles_per_revolution": cycles,
            "phase": phase,
        },
        "motor_side_friction": {"coulomb": float(rng.uniform(0.01, 0.06))},
        str(rng.choice(["backlash", "joint_play"])): {"gap": gap},
        "pulley_eccentricity": {"relative_eccentricity": float(rng.uniform(2e-3, 2e-2)), "phase": phase},
    }
    drift: dict[str, dict[str, Any]] = {
        "thermal_friction_drift": {"temperature_coefficient": float(rng.uniform(-1e-2, 1e-2))},
        "pretension_relaxation": {
            "relaxed_fraction": float(rng.uniform(0.02, 0.12)),
            "time_constant": float(rng.uniform(10.0, 200.0)),
        },
    }
    name = str(rng.choice(list(drift)))
    choices[name] = drift[name]
    warm = float(rng.uniform(28.0, 45.0))  # deg C
    here = {key: values for key, values in choices.items() if rng.random() < PRESENT}
    return here, [[0.0, 25.0], [60.0, warm]] if "thermal_friction_drift" in here else []


def trial(rig: Rig, folder: Path) -> Row:
    """Write, tune and evaluate one rig. The row has the outcome, the reductions (%) and the error of the small sine."""
    rig.write(folder)
    row: Row = {
        "seed": rig.seed,
        "rig": rig.number,
        "x": rig.truth.friction_angle,
        "centre": Profile(rig.profile).centre,
    }
    row |= {"effects": rig.effects, "bits": [*rig.bits], "inertia": rig.inertia, "delay": rig.delay, "rate": rig.rate}
    options = ("--virtual", "plant-imposed.toml", "--json", "--yes", "--out", "out", *TUNING)
    verb = tsa("tune", "controller.toml", *options)
    run = subprocess.run(verb, cwd=folder, capture_output=True, text=True, check=False)
    if run.returncode != 0:
        return {**row, "outcome": (run.stderr.strip().splitlines() or [f"exit code {run.returncode}"])[-1]}
    found = json.loads(run.stdout)
    row["verified"] = found["verification"]["reduction_percent"]["after"]
    if not found["written"]:
        return {**row, "outcome": "the new file is not better, nothing is written"}
    row["outcome"] = "tuned"
    for name in SECONDS:
        try:
            row |= evaluate(folder, name)
        except (BusError, UsageError) as error:
            row["outcome"] += f"; {name}: {error}"
    return row


def evaluate(folder: Path, name: str) -> Row:
    """Run the tuned controller with and without compensation with one load, and return its reduction or error."""
    row: Row = {}
    tuned, none = (play(folder, name, law) for law in ("tuned", "none"))
    if faults := [*tuned.faults, *none.faults]:
        row[f"{name}_faults"] = faults
    if name == "imposed":
        error, limit = rms(tuned.error), SHARE * rms(none.error)
        if error > limit:
            limit = max(limit, learned(folder, tuned))
        row["ratio"] = error / limit
    row[name] = 1e3 * rms(tuned.error) if name == "small" else 100.0 * (1.0 - rms(tuned.error) / rms(none.error))
    return row


def learned(folder: Path, tuned: AxisResult) -> float:
    """Return the smallest RMS error with a prescribed motion and a learned set-point, N*m."""
    table = np.loadtxt(folder / "imposed.csv", delimiter=",", skiprows=1)
    desired = tuned.log["tau_j_des"]
    period = round(table[-1, 0] / (tuned.log["t"][1] - tuned.log["t"][0]))
    times = np.linspace(0.0, table[-1, 0], period, endpoint=False)
    values = np.interp(times, *table.T)
    rows = np.arange(desired.size)
    counted = tuned.counted
    shift = min(range(period), key=lambda by: rms((values[(rows + by) % period] - desired)[counted]))
    phases = (rows + shift) % period
    correction, best, run = np.zeros(period), rms(tuned.error), tuned
    for _ in range(ITERATIONS):
        counted = run.counted
        error = (run.delivered - values[phases])[counted]
        mean = np.bincount(phases[counted], error, period) / np.maximum(np.bincount(phases[counted], None, period), 1)
        smooth = gaussian_filter1d(mean, SMOOTH * period / table[-1, 0], mode="wrap")
        correction = np.clip(correction - STEP * smooth, -MOST_LEARNED, MOST_LEARNED)
        points = np.column_stack(
            [np.append(times, table[-1, 0]), np.append(values + correction, (values + correction)[0])]
        )
        np.savetxt(folder / "learned.csv", points, delimiter=",", header="t,tau_j_des", comments="")
        try:
            run = play(folder, "imposed", "learned")
        except UsageError:
            break  # a set-point beyond the limits of the rig
        if not run.faults:
            best = min(best, rms((run.delivered - values[phases])[run.counted]))
    return best


def play(folder: Path, name: str, law: str) -> AxisResult:
    """Run the tuned controller with one load.

    The law "none" has no compensation, "open" no torque feedback, and "learned" the set-point of `learned`.
    """
    joint = "held" if name == "small" else name
    tables = tomllib.loads((folder / "out" / "controller.toml").read_text(encoding="utf-8"))
    axis = tables["axis"][0]
    axis["setpoint"] = {"kind": "file", "file": f"{joint}.csv", "loop": True}
    if name == "small":
        axis["setpoint"] = {"kind": "sine", "amplitude": SMALL, "frequency": 0.5}
    axis["model"] = f"out/{Path(axis['model']).name}"
    if law == "none":
        axis["law"] = {"compensation": 0.0, "fade_in": demo.FADE_IN}
    elif law == "open":
        axis["law"]["feedback"] = 0.0
    elif law == "learned":
        axis["setpoint"]["file"] = "learned.csv"
    path = folder / f"evaluate-{name}-{law}.toml"
    path.write_text(tomlkit.dumps(tables), encoding="utf-8")
    return simulate_loop(path, folder / f"plant-{joint}.toml", SECONDS[name]).axes[0]


def report(rows: list[Row]) -> Iterator[Table | str]:
    """Yield a row for each rig, and the reductions over all rigs."""
    table = Table(
        "rig", "s_c", "x", "bits", "effects", "outcome", "imposed %", "ratio", "held %", "wearer %", "small mN·m"
    )
    names = ("imposed", "ratio", "held", "wearer", "small")
    for row in rows:
        cells = [f"{row[name]:.{2 if name == 'ratio' else 1}f}" if name in row else "-" for name in names]
        faults = [f"{name}: {row[f'{name}_faults'][0]}" for name in names if f"{name}_faults" in row]
        outcome = "; ".join([row["outcome"], *faults])
        bits = "/".join(str(value) for value in row["bits"])
        effects = ", ".join(row["effects"]) or "none"
        table.add_row(str(row["rig"]), f"{row['centre']:.2f}", f"{row['x']:.2f}", bits, effects, outcome, *cells)
    yield table
    for name, worst in (("imposed", min), ("ratio", max), ("held", min), ("wearer", min), ("small", max)):
        values = [row[name] for row in rows if name in row]
        if values:
            yield f"{name:8s} median {np.median(values):.3g}, worst {worst(values):.3g}, {len(values)} rigs"
    yield f"{sum('verified' not in row for row in rows)} of {len(rows)} tunings failed"


def main() -> int:
    parser = command.parser(__name__, __doc__)
    command.share(parser, "rigs first seed rows processes json", rigs=6)
    parser.add_argument("--keep", type=Path, help="folder for the files of each rig")
    parser.add_argument("--rate", type=float, default=1000.0, help="Hz of the loop (default: 1000)")
    arguments = parser.parse_args()
    command.seeded(arguments)
    numbers = range(arguments.first, arguments.first + arguments.rigs)
    asked = [(arguments.seed, number, arguments.rate) for number in numbers]
    work = functools.partial(made, arguments.keep)
    rows = command.run_rows(work, asked, lambda row: (row["seed"], row["rig"], row["rate"]), arguments)
    command.print_tables(rows, arguments, lambda: [f"seed {arguments.seed}", *report(rows)])
    return 0


def made(keep: Path | None, asked: tuple[int, int, float]) -> Row:
    """Generate, tune and evaluate one rig. With `keep` its files stay in a folder there."""
    seed, number, rate = asked
    with tempfile.TemporaryDirectory(prefix="bench-rigs-") as name:
        return trial(draw(*asked), Path(name) if keep is None else keep / f"rig-{seed}-{number}-{rate:g}")
