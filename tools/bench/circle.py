"""The full circle for many hidden effects: `tsa demo --full` for each, one line each.

Usage: tools/vcan tools/run bench/circle [--results FILE] [--at-most N] [--seconds 20] [--rate 1000] [EFFECT+...:SEED]
RMS joint torque error (mN*m) without compensation, with the nominal model, calibrated, extended by what the diagnosis
of the nominal run's log names, and with the true parameters as the limit. With --results FILE each row is appended to
it as it ends, and rows that it holds are not made again.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
from pathlib import Path

from tools import command
from tools.command import Results, Row
from tsa_ctrl.system.processes import tsa

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


def one(case: str, arguments: argparse.Namespace) -> Row:
    names, _, seed = case.partition(":")
    hidden = [part for name in names.split("+") for part in ("--hidden", name)]
    with tempfile.TemporaryDirectory(prefix="full-circle-") as folder:
        verb = tsa("demo", "--full", "--json", *hidden, "--seed", seed or "1", "--out", folder)
        more = ("--seconds", f"{arguments.seconds:g}", "--rate", f"{arguments.rate:g}")
        run = subprocess.run([*verb, *more], capture_output=True, text=True, check=False)
    if run.returncode != 0:
        return {"case": case, "error": run.stderr.strip().splitlines()[-1]}
    return {"case": case, **json.loads(run.stdout)}


def line(row: Row) -> str:
    hidden = str(row["case"])
    if "error" in row:
        return f"{hidden:36s} {row['error']}"
    found = " + ".join(" or ".join([c["effect"], *c["alternatives"]]) for c in row["found"]) or "nothing"
    errors = " ".join(f"{1e3 * row['rms'][stage]:10.1f}" for stage in STAGES)
    share = row["share_of_reachable"]
    return f"{hidden:36s} {errors} {100 * share['from_none']:7.1f} {100 * share['from_nominal']:7.1f}  {found}"


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("cases", nargs="*", default=CASES, metavar="EFFECT[+EFFECT]:SEED")
    parser.add_argument("--results", type=Path, help="a JSON object per row; those that it holds are not made again")
    parser.add_argument("--at-most", type=int, help="make so many new rows, then stop; with --results")
    parser.add_argument("--seconds", type=float, default=20.0, help="of torque per run")
    parser.add_argument("--rate", type=float, default=1000.0, help="of the loop, Hz")
    arguments = parser.parse_args()
    known = Results(arguments.results, lambda row: row["case"])
    print(
        f"{arguments.seconds:g} s per run at {arguments.rate:g} Hz; RMS joint torque error in mN*m; shares in % of the "
        f"reduction that the true parameters reach\n{'hidden:seed':36s} {' '.join(f'{s:>10s}' for s in STAGES)}"
        f" {'of none':>7s} {'of nom.':>7s}  found",
        flush=True,
    )
    made, shares = 0, []
    for case in arguments.cases:
        if case not in known:
            if made == arguments.at_most:
                continue
            known.add(one(case, arguments))
            made += 1
        print(line(known[case]), flush=True)
        if "error" not in known[case]:
            shares.append(known[case]["share_of_reachable"]["from_none"])
    failed = len(arguments.cases) - len(shares)
    if shares:
        print(f"least share of the reachable reduction: {100 * min(shares):.1f} %; {failed} rows failed or not made")
    return int(failed > 0)
