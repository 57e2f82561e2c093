"""Whether compensation ever moves a joint by itself: loads, set-points and sudden changes, in virtual time.

Usage: tools/run campaign/runaway [--sample N] [--rows FILE] [--delays 1 3] [--compensation 0.95] [--json]
       [--loads free ...] [--set-points constant ...] [--missed FILE] [--healthy SECONDS [--slices N]]

Each case is one run of the real loop on distributed tendons, whose model file is true until 1.2 s: then pretension,
friction or bending step to a share of what they were, and a joint that stands is nudged (a limb's hand lets go). Judged
by the plant's truth from then on:

  work    most that the joint was given beyond the set-point's work within any window, J/2 (1 rad/s)^2 at most; where it
          is more, the same run without compensation is made, and what is given there, too, is not the compensation's
  late    the same, counted from 1 s after the first `FELT` on: at most `FELT`
  told    the guard said so where more than it allows was given, and latched where it happened again

With nothing changed the set-point ends instead: 3 s later the joint must stand (0.02 rad/s RMS) and the motor be quiet
(0.02 N*m peak to peak). --sample N: N cases spread over all, the same ones each time. --missed FILE: those alone that
missed a goal in that file of rows. --rows FILE: cases that are in the file are not run again, new ones are added, and
the table is that of the file. --healthy SECONDS: instead, that long of gait (of a sine on weight, free and wearer) on
each load with nothing wrong, in slices of `SLICE` s with noise of their own: the guard must say nothing. With --rows
it goes on where it was, by --slices of each load at most. Exit code 1: a goal was missed.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import math
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from tools import command
from tools.bench.control import true_model
from tsa_ctrl.demo import rig
from tsa_ctrl.demo.bus_choice import VIRTUAL
from tsa_ctrl.demo.motion import gait, play_for
from tsa_ctrl.model.parameters import save_model
from tsa_ctrl.virtual.result import Simulation
from tsa_ctrl.virtual.script import Change, Fault
from tsa_ctrl.virtual.simulation import simulate_loop

LOADS = {"weight": 0.02, "spring": 0.02, "free": 0.02, "limb": 0.05}  # kg*m^2
HEALTHY = ("imposed", *LOADS, "wearer")
SET_POINTS = ("zero", "constant", "sine", "gait")
CHANGES = {
    "pretension": (0.1, 0.3, 0.5, 0.7, 0.9),
    "friction": (0.5, 0.75, 1.25, 1.5),
    "bending": (0.8, 0.9, 1.1, 1.2),
}
GAIT_SHARE = {"weight": 0.4, "free": 0.4}  # of the gait's torque: a joint of 0.02 kg*m^2 stays below 5 rad/s
CONSTANT, SINE = 0.3, 0.5  # N*m
AT, SECONDS = 1.2, 2.1  # s of the log: of the change, and from it to the end
LET_GO = 0.2  # s after it
FELT = 1e-3  # J: three times what a healthy reversal leaves
ALLOWED = 3e-3  # J, [axis.passivity] energy as shipped
TO_REST, REST, MEASURED = (
    2.0,
    3.0,
    1.0,
)  # s: the set-point's gain goes to 0, then all must come to rest, then it is seen
SLICE = 120.0  # s of a healthy run at once: a log of an hour does not fit into memory
TOLD = ("passivity", "oscillation")  # how what the guard says begins
QUIET_SPEED, QUIET_TORQUE = 0.02, 0.02  # rad/s RMS, N*m peak to peak


@dataclasses.dataclass(frozen=True)
class Case:
    """What is played; `change` "" is nothing."""

    load: str
    set_point: str
    change: str
    share: float
    delay: int

    @property
    def name(self) -> str:
        what = f"{self.change} {self.share:g}" if self.change else "nothing"
        return f"{self.load}, {self.set_point}, {what}, delay {self.delay}"


def cases(delays: Sequence[int]) -> list[Case]:
    """All of them."""
    changes = [("", 1.0)] + [(name, share) for name, shares in CHANGES.items() for share in shares]
    return [
        Case(load, set_point, *change, delay)
        for load, set_point, change, delay in itertools.product(LOADS, SET_POINTS, changes, delays)
    ]


def play(case: Case, compensation: float) -> Simulation:
    """Run a case."""
    motion = gait()
    scaled = dataclasses.replace(motion, tau_j_des=GAIT_SHARE.get(case.load, 1.0) * motion.tau_j_des)
    with tempfile.TemporaryDirectory(prefix="runaway-") as name:
        folder = Path(name)
        save_model(true_model("uniform"), folder / "true.toml")
        rig.write(folder, scaled, _plant(case), {"run": _controller(case, compensation)})
        seconds, faults, changes = AT + SECONDS, [], []
        if not case.change:
            seconds = AT + TO_REST + REST + MEASURED
            changes = [Change("setpoint_gain", 0.0, AT)]
        else:
            faults = [Fault(f"{case.change} value={case.share:g}", AT)]
            if case.set_point in ("zero", "constant"):
                faults.append(Fault("push value=0.5 duration=0.05", AT))
        return simulate_loop(
            folder / "controller-run.toml", folder / "plant.toml", seconds, faults=faults, changes=changes
        )


def _plant(case: Case) -> rig.Tables:
    axis: dict[str, Any] = {"drive": {"delay_periods": case.delay - 1}, "motor": {"inertia": rig.MOTOR_INERTIA}}
    tables = rig.plant(VIRTUAL, "distributed", axis, case.load)
    if case.load == "limb":
        go = AT + LET_GO
        tables["axis"][0]["joint"] |= {
            "hand": [[0.0, 0.0, 1.0, 0.0], [go, 0.0, 1.0, 0.0], [go + 0.01, 0.0, 0.0, 0.0]],
            "hand_repeat": False,
        }
    return tables


def _controller(case: Case, compensation: float) -> rig.Tables:
    tables = rig.controller(VIRTUAL, "run", 1000.0, "true.toml", compensation)
    axis = tables["axis"][0]
    axis["law"]["fade_in"] = 0.5
    if compensation > 0.0:
        axis["law"]["delay"] = (case.delay + 1.0) * 1e-3  # transport, half a period of hold, the torque loop
    if case.set_point in ("zero", "constant"):
        axis["setpoint"] = {"kind": "constant", "offset": CONSTANT if case.set_point == "constant" else 0.0}
    elif case.set_point == "sine":
        axis["setpoint"] = {"kind": "sine", "amplitude": SINE, "frequency": 0.5}
    return tables


def healthy(load: str, number: int, seconds: float, compensation: float) -> dict[str, Any]:
    """A slice with nothing wrong, its number the seed: gait or, on a load that it would throw about, a sine."""
    played = play_for(load) if load in ("weight", "free", "wearer") else gait()
    with tempfile.TemporaryDirectory(prefix="runaway-") as name:
        folder = Path(name)
        save_model(true_model("uniform"), folder / "true.toml")
        controller = rig.controller(VIRTUAL, "run", 1000.0, "true.toml", compensation)
        rig.write(folder, played, rig.plant(VIRTUAL, "distributed", None, load), {"run": controller})
        run, plant = folder / "controller-run.toml", folder / "plant.toml"
        result = simulate_loop(run, plant, seconds, seed=number)
    said = [event.text for event in result.summary.events if event.text.startswith(TOLD)]
    faults = list(result.axes[0].faults)
    return {"healthy": load, "slice": number, "seconds": seconds, "compensation": compensation, "said": said + faults}


def all_healthy(options: argparse.Namespace) -> int:
    """Slices of each load up to what is asked for, a slice of each in turn; 1 if the guard said anything."""
    rows = [row for row in _known(options) if "healthy" in row and row["compensation"] == options.compensation]
    loads = [load for load in HEALTHY if load in options.loads]
    for _, load in itertools.product(range(min(options.slices, math.ceil(options.healthy / SLICE))), loads):
        done = [row for row in rows if row["healthy"] == load]
        left = options.healthy - sum(row["seconds"] for row in done)
        if left > 0.0:
            rows.append(healthy(load, 1 + len(done), min(SLICE, left), options.compensation))
            _keep(options, rows[-1])
    for load in loads:
        done = [row for row in rows if row["healthy"] == load]
        texts = [text for row in done for text in row["said"]]
        print(f"{load}: {sum(row['seconds'] for row in done):g} s, the guard said {'; '.join(texts) or 'nothing'}")
    return 1 if any(row["said"] for row in rows) else 0


def power(result: Simulation) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Times from the change on, s of the log, and the work per row beyond the set-point's, J."""
    axis, truth = result.axes[0], result.truth
    t = truth["clock"] - axis.start
    on = (t >= AT) & (t < axis.until)
    wanted = np.interp(t, axis.log["t"], axis.log["tau_j_des"])
    step = np.diff(t, prepend=t[0])
    return t[on], ((truth["tau_j"] - wanted) * truth["omega_j"] * step)[on]


def windows(work: NDArray[np.float64]) -> NDArray[np.float64]:
    """Most work of any window that ends in each row, J."""
    total = np.cumsum(work)
    least = np.minimum.accumulate(np.concatenate(([0.0], total[:-1])))
    return total - least if work.size else work


def judge(case: Case, compensation: float) -> dict[str, Any]:
    """Run a case and what it is compared with."""
    result = play(case, compensation)
    row: dict[str, Any] = {**dataclasses.asdict(case), "compensation": compensation}
    texts = [event.text for event in result.summary.events]
    row["told"] = any(text.startswith(TOLD) for text in texts)
    row["latched"] = any("latched at" in text for text in texts)
    row["faults"] = list(result.axes[0].faults)
    if not case.change:
        truth, axis = result.truth, result.axes[0]
        t = truth["clock"] - axis.start
        rest = (t > AT + TO_REST + REST) & (t < axis.until)
        row["speed"] = float(np.sqrt(np.mean(np.square(truth["omega_j"][rest]))))
        row["torque"] = float(np.ptp(truth["tau_m"][rest]))
        row["good"] = row["speed"] <= QUIET_SPEED and row["torque"] <= QUIET_TORQUE and not row["told"]
        return row
    t, work = power(result)
    given = windows(work)
    felt = np.flatnonzero(given > FELT)
    row["work"] = float(given.max(initial=0.0))
    row["late"] = _late(t, work, float(t[felt[0]]) + 1.0) if felt.size else 0.0
    row["onset"] = float(t[felt[0]]) - AT if felt.size else None
    most = 0.5 * LOADS[case.load]
    if row["work"] > most or row["late"] > FELT:
        t, without = power(play(case, 0.0))
        row["work_without"] = float(windows(without).max(initial=0.0))
        row["late_without"] = _late(t, without, AT + (row["onset"] or 0.0) + 1.0)
    row["added"] = max(0.0, row["work"] - row.get("work_without", 0.0))
    row["late_added"] = max(0.0, row["late"] - row.get("late_without", 0.0))
    row["silent"] = row["added"] > ALLOWED + FELT and not row["told"]
    row["good"] = row["added"] <= most and row["late_added"] <= FELT and not row["silent"]
    return row


def _late(t: NDArray[np.float64], work: NDArray[np.float64], begin: float) -> float:
    return float(windows(work[t >= begin]).max(initial=0.0))


def table(rows: Sequence[dict[str, Any]]) -> Table:
    """One line for each load and set-point, and the sum."""
    heads = ("load", "set-point", "runs", "work, worst (mJ)", "of", "late, worst (mJ)", "told", "latched", "missed")
    found = Table(*heads, "at rest (rad/s; N·m)", title="runaway", title_justify="left")
    for load, set_point in itertools.product(LOADS, SET_POINTS):
        those = [row for row in rows if (row["load"], row["set_point"]) == (load, set_point)]
        changed = [row for row in those if row["change"]]
        if not those:
            continue
        resting = [row for row in those if not row["change"]]
        rest = f"{max(r['speed'] for r in resting):.3f}; {max(r['torque'] for r in resting):.3f}" if resting else "-"
        found.add_row(
            load,
            set_point,
            str(len(those)),
            f"{1e3 * max((row['added'] for row in changed), default=0.0):.1f}",
            f"{0.5e3 * LOADS[load]:.0f}",
            f"{1e3 * max((row['late_added'] for row in changed), default=0.0):.1f}",
            str(sum(row["told"] for row in changed)),
            str(sum(row["latched"] for row in changed)),
            str(sum(not row["good"] for row in those)),
            rest,
        )
    return found


def spread(all_cases: list[Case], number: int) -> list[Case]:
    """`number` of them, in steps that meet every load, set-point and change alike."""
    stride = 37  # prime to any count of cases here
    count = len(all_cases)
    return [all_cases[(k * stride) % count] for k in range(min(number, count))]


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--sample", type=int, default=0, help="so many cases; 0: all")
    parser.add_argument("--rows", type=Path, help="JSON lines of what was run, kept and added to")
    parser.add_argument("--missed", type=Path, help="JSON lines of an earlier run: only what missed a goal there")
    parser.add_argument("--loads", nargs="+", choices=HEALTHY, default=HEALTHY)
    parser.add_argument("--set-points", nargs="+", choices=SET_POINTS, default=SET_POINTS)
    parser.add_argument("--delays", type=int, nargs="+", default=(1, 3), help="periods from measurement to torque")
    parser.add_argument("--compensation", type=float, default=0.95, help="share of the friction term (default 0.95)")
    parser.add_argument("--json", action="store_true", help="a JSON object a case, instead of the table")
    parser.add_argument("--healthy", type=float, metavar="SECONDS", help="gait with nothing wrong, on each load")
    parser.add_argument("--slices", type=int, default=1000, help="of a healthy run, of each load at most")
    options = parser.parse_args()
    if options.healthy:
        return all_healthy(options)
    wanted = cases(options.delays)
    chosen = spread(wanted, options.sample) if options.sample else wanted
    chosen = [case for case in chosen if case.load in options.loads and case.set_point in options.set_points]
    if options.missed is not None:
        missed = {_key(row) for row in _read(options.missed) if not row["good"]}
        chosen = [case for case in chosen if _key_of(case, options) in missed]
    rows = [row for row in _known(options) if "healthy" not in row]
    done = {_key(row) for row in rows}
    for case in chosen:
        if _key_of(case, options) in done:
            continue
        row = judge(case, options.compensation)
        rows.append(row)
        _keep(options, row)
        if options.json:
            print(json.dumps(row), flush=True)
        elif not row["good"]:
            print(f"missed: {case.name}: {_words(row)}", flush=True)
    if not options.json:
        Console(width=130).print(table(rows))
        count = sum(not row["good"] for row in rows)
        print(f"{len(rows)} runs, {len(rows) - count} as they must be, {count} missed")
    return 0 if all(row["good"] for row in rows) else 1


def _read(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def _known(options: argparse.Namespace) -> list[dict[str, Any]]:
    return _read(options.rows) if options.rows is not None and options.rows.is_file() else []


def _keep(options: argparse.Namespace, row: dict[str, Any]) -> None:
    if options.rows is not None:
        with options.rows.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")


def _key_of(case: Case, options: argparse.Namespace) -> tuple[Any, ...]:
    return _key(dataclasses.asdict(case) | {"compensation": options.compensation})


def _key(row: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(row[name] for name in ("load", "set_point", "change", "share", "delay", "compensation"))


def _words(row: dict[str, Any]) -> str:
    if not row["change"]:
        return f"{row['speed']:.3f} rad/s, {row['torque']:.3f} N*m at rest" + (", told" if row["told"] else "")
    silent = ", and nobody said so" if row["silent"] else ""
    return f"{1e3 * row['added']:.1f} mJ added, {1e3 * row['late_added']:.1f} mJ of it late{silent}"
