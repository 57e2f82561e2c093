"""Compare the law with other laws on random rigs in virtual time.

Usage: tools/run bench/laws [--rigs 4] [--seed N] [--first 0] [--rows FILE] [--processes 1|2] [--json]

Each rig of `tools/run bench/rigs` is used twice: "real" with its random effects, and "clean" without them. `tsa tune`
identifies it, and all laws use the tuned file, the same measurements, torque limit and plant:

- `tsa tune`: the tuned controller. "no feedback" is the same without the torque sensor's correction.
- (3.55): tau_M = (tau_d + sigma b)/a with slope a and friction torque b of the tuned file, and sigma by the velocity.
- PI: tau_M = r_M/r_J (tau_d + KP e + KI integral of e), e = tau_d - tau_J by the sensor.
- observer: tau_M = r_M/r_J (tau_d + d), where d is the low-pass of r_J/r_M tau_M - tau_J (disturbance observer).
- tanh: tau_M = r_M/r_J (tau_d + p_1 tanh(omega/OMEGA) + p_2 |tau_d| tanh(omega/OMEGA) + p_3), and the parameters p
  follow the gradient of e^2 (adaptive friction compensation).

The three laws with feedback have no plan for a reversal. For each rig and load, each of them has the gain of `GAINS`
with the smallest error, which a user could not know. A gain that ends in a fault does not count. Cells are medians over
the rigs, with the worst in parentheses: the reduction of the RMS error relative to a run without compensation, and for
the sine of 20 mN*m on the locked joint ("small") the RMS error.

The other laws replace a function of the loop, so this command requires the interpreted source (TSA_COMPILE=0).
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from rich.table import Table

from tests.virtual.joints import rms
from tools import command
from tools.bench.rigs import SECONDS, TUNING, draw, play
from tools.command import Row
from tsa_ctrl.bus.canopen.cia402 import Controlword
from tsa_ctrl.control import cycle
from tsa_ctrl.control.axis import ControlAxis
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.model.steady_sliding import sliding
from tsa_ctrl.safety.limiter import Reason
from tsa_ctrl.system.process_supervisor import tsa

PERIOD = 1e-3  # s, of the loop of these rigs
KP = 0.5  # 1, proportional gain of the PI controller on all rigs
OMEGA = 0.05  # rad/s of the joint, over which the direction changes its sign
MOST = 2.0  # N*m at the joint, limit of what a feedback may add
GAINS = {"PI": (5.0, 20.0, 60.0), "observer": (1.0, 3.0, 10.0), "tanh": (2.0, 10.0, 50.0)}  # 1/s; Hz; 1/(N*m s)
OWN = ("tsa tune", "no feedback")
LAWS = (*OWN, "(3.55)", *GAINS)
Law = Callable[[float, float, float], float]  # desired torque, sensor's torque, velocity of the joint: motor torque


def law_of(name: str, gain: float, axis: ControlAxis) -> Law:
    """Return a new law of this name; N*m and rad/s, the result in N*m at the motor."""
    ratio = axis.model.motor_pulley_radius / axis.model.joint_pulley_radius
    lines = {direction: sliding(axis.model, direction) for direction in (1.0, -1.0)}
    state = np.zeros(3)

    def steady(desired: float, sensed: float, velocity: float) -> float:
        share = min(1.0, max(-1.0, velocity / OMEGA))
        forward, backward = ((desired + direction * line.half_loop) / line.slope for direction, line in lines.items())
        return 0.5 * (1.0 + share) * forward + 0.5 * (1.0 - share) * backward

    def integral(desired: float, sensed: float, velocity: float) -> float:
        error = desired - sensed
        state[0] = np.clip(state[0] + gain * PERIOD * error, -MOST, MOST)
        return ratio * (desired + KP * error + float(state[0]))

    def observer(desired: float, sensed: float, velocity: float) -> float:
        state[0] += -math.expm1(-2.0 * math.pi * gain * PERIOD) * (axis.image.tau_m / ratio - sensed - state[0])
        return ratio * (desired + float(np.clip(state[0], -MOST, MOST)))

    def adaptive(desired: float, sensed: float, velocity: float) -> float:
        direction = math.tanh(velocity / OMEGA)
        terms = np.array([direction, abs(desired) * direction, 1.0])
        state[:] = np.clip(state + gain * PERIOD * (desired - sensed) * terms, -MOST, MOST)
        return ratio * (desired + float(state @ terms))

    return {"(3.55)": steady, "PI": integral, "observer": observer, "tanh": adaptive}[name]


@contextmanager
def replaced(name: str, gain: float, limit: float) -> Iterator[None]:
    """Let the loop command the torque of another law, limited to `limit` (N*m at the motor), within this context."""
    own, laws = cycle.command, dict[str, Law]()

    def command_of(axis: ControlAxis, now: float) -> tuple[Controlword, float]:
        controlword, torque = own(axis, now)
        terms, sensed = axis.terms, axis.instruments.tau_j
        if terms.permitted and terms.reason not in (Reason.OVER_SPEED, Reason.NOT_FINITE) and sensed == sensed:
            if axis.name not in laws:
                laws[axis.name] = law_of(name, gain, axis)
            wanted = laws[axis.name](terms.tau_j_des, sensed, terms.omega_j)
            torque = terms.tau_m_cmd = min(limit, max(-limit, wanted))
        return controlword, torque

    cycle.command = command_of
    try:
        yield
    finally:
        cycle.command = own


def trial(asked: tuple[int, int, str]) -> Row:
    """Tune one rig, and run all laws with all loads. The row has reductions (%) or errors (mN*m) by load and law."""
    seed, number, kind = asked
    rig = draw(seed, number)
    if kind == "clean":
        rig = dataclasses.replace(rig, effects={}, temperature=[])
    row: Row = {"seed": seed, "rig": number, "kind": kind, "x": rig.truth.friction_angle}
    with tempfile.TemporaryDirectory(prefix="bench-laws-") as name:
        folder = Path(name)
        rig.write(folder)
        options = ("--virtual", "plant-imposed.toml", "--yes", "--out", "out", *TUNING)
        run = subprocess.run(
            tsa("tune", "controller.toml", *options), cwd=folder, capture_output=True, text=True, check=False
        )
        if not (folder / "out" / "controller.toml").exists():
            return {**row, "failed": (run.stderr.strip().splitlines() or [f"exit code {run.returncode}"])[-1]}
        for load in SECONDS:
            row[load] = {law: _cell(folder, load, law, rig.torque) for law in LAWS}
    return row


def _cell(folder: Path, load: str, law: str, limit: float) -> float | None:
    """Return the reduction (%) or the error (mN*m) with the best gain; None if every gain ends in a fault."""
    found = [error for gain in GAINS.get(law, (0.0,)) if (error := _error(folder, load, law, gain, limit)) is not None]
    if not found:
        return None
    return 1e3 * min(found) if load == "small" else 100.0 * (1.0 - min(found) / rms(_without(folder, load)))


@functools.cache
def _without(folder: Path, load: str) -> np.ndarray:
    return play(folder, load, "none").error


def _error(folder: Path, load: str, law: str, gain: float, limit: float) -> float | None:
    """Return the RMS error (N*m) with one gain; None if the run ends in a fault."""
    try:
        if law in OWN:
            run = play(folder, load, "tuned" if law == OWN[0] else "open")
        else:
            with replaced(law, gain, limit):
                run = play(folder, load, "none")
    except (BusError, UsageError):
        return None
    return None if run.faults else rms(run.error)


def report(rows: list[Row]) -> Iterator[Table | str]:
    """Yield the table of medians and worst values, and the rigs whose tuning failed."""
    table = Table("load", "rigs", *LAWS)
    good = [row for row in rows if "failed" not in row]
    for load, kind in itertools.product(SECONDS, ("clean", "real")):
        of = [row[load] for row in good if row["kind"] == kind]
        cells = []
        for law in LAWS if of else ():
            values = [each[law] for each in of if each[law] is not None]
            worst, faults = (max if load == "small" else min), len(of) - len(values)
            text = f"{np.median(values):.1f} ({worst(values):.1f})" if values else "-"
            cells.append(f"{text}, {faults} faults" if faults else text)
        unit = "mN·m" if load == "small" else "%"
        table.add_row(f"{load}, {unit}", f"{len(of)} {kind}", *cells)
    yield table
    yield from (f"rig {row['rig']}, {row['kind']}: not tuned: {row['failed']}" for row in rows if "failed" in row)


def main() -> int:
    parser = command.parser(__name__, __doc__)
    command.share(parser, "rigs first seed rows processes json", rigs=4)
    arguments = parser.parse_args()
    if not str(cycle.__file__).endswith(".py"):
        raise UsageError(
            "bench/laws replaces a function of the loop, which the compiled build does not permit: set TSA_COMPILE=0"
        )
    command.seeded(arguments)
    numbers = range(arguments.first, arguments.first + arguments.rigs)
    asked = [(arguments.seed, number, kind) for number in numbers for kind in ("clean", "real")]
    rows = command.run_rows(trial, asked, lambda row: (row["seed"], row["rig"], row["kind"]), arguments)
    command.print_tables(rows, arguments, lambda: [f"seed {arguments.seed}", *report(rows)])
    return 0
