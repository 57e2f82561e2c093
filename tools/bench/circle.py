"""Run `tsa demo --full` for hidden effects: simulate, calibrate, diagnose, and simulate with the extended model.

Usage: tools/vcan tools/run bench/circle [--seconds 20] [--rows FILE] [--json] [EFFECT[+EFFECT]:SEED ...]

Each row has the RMS error of the joint torque (mN*m) for five controllers: without compensation, with the nominal
model, with the calibrated model, with the extended model, and with the true parameters. The model is extended by the
causes that the diagnosis of the nominal run identifies. The last two numbers are the error reductions of the extended
model from no compensation and from the nominal model. They are shares of the reductions with the true parameters.
"""

from __future__ import annotations

import argparse
import functools
import json
import subprocess
import tempfile

from tools import command
from tools.command import Row
from tsa_ctrl.system.process_supervisor import tsa

CASES = (
    "viscous_friction:1",
    "stribeck_friction:2",
    "load_dependent_friction:3",
    "sheath_asymmetry:4",
    "direction_asymmetric_friction:5",
    "torque_offset:6",
    "torque_ripple:7",
    "gravity_load:8",
    "joint_stiffness:9",
    "presliding_hysteresis:10",
    "gravity_load+viscous_friction:11",
)
STAGES = ("none", "nominal", "calibrated", "extended", "true")


def one(arguments: argparse.Namespace, case: str) -> Row:
    """Run the demo with the hidden effects of one case, and return its row."""
    names, _, seed = case.partition(":")
    hidden = [part for name in names.split("+") for part in ("--hidden", name)]
    with tempfile.TemporaryDirectory(prefix="full-circle-") as folder:
        line = tsa("demo", "--full", "--json", *hidden, "--seed", seed or "1", "--out", folder)
        run = subprocess.run(
            [*line, "--seconds", f"{arguments.seconds:g}"], capture_output=True, text=True, check=False
        )
    return {"case": case, **(json.loads(run.stdout) if run.returncode == 0 else {"error": run.stderr.strip()})}


def cells(row: Row) -> list[str]:
    """Return a line of the table."""
    if "error" in row:
        return [row["case"], *("-" for _ in STAGES), "-", "-", row["error"].splitlines()[-1]]
    found = " + ".join(" or ".join([c["effect"], *c["alternatives"]]) for c in row["found"]) or "nothing"
    shares = (f"{100 * row['share_of_reachable'][name]:.1f}" for name in ("from_none", "from_nominal"))
    return [row["case"], *(f"{1e3 * row['rms'][stage]:.1f}" for stage in STAGES), *shares, found]


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("cases", nargs="*", default=CASES, metavar="EFFECT[+EFFECT]:SEED")
    parser.add_argument("--seconds", type=float, default=20.0, help="of torque per run")
    command.share(parser, "rows processes json")
    arguments = parser.parse_args()
    rows = command.run_rows(functools.partial(one, arguments), arguments.cases, lambda row: row["case"], arguments)
    heads = ("hidden:seed", *STAGES, "of none (%)", "of nominal (%)", "found")
    command.print_tables(rows, arguments, lambda: [command.table(heads, map(cells, rows))])
    return int(any("error" in row for row in rows))
