"""Measure the coverage of the calibration's 95 % intervals on random logs.

Usage: tools/run bench/calibrate [--logs 1000] [--seed 1] [--processes 2] [--rows FILE] [--json]

The logs are computed from the elongation equilibrium of two tendons (tests/blind/tendon_logs.py), not by the package.
"""

from __future__ import annotations

import time
import tomllib
from collections.abc import Iterator

import numpy as np
from rich.table import Table
from scipy.stats import beta

from tests.blind import tendon_logs
from tools import command
from tools.command import Row
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.calibrate import calibrate
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import TendonSheath, model_from

Job = tuple[int, str, str]  # seed, profile, kind
ONE = "one configuration"
VARIED = ("pretension varied", "bending varied", "tensions measured", "gain certified")
QUANTITIES = ("slope", "half_loop_torque", "friction_angle", "pretension")


def one(job: Job) -> Row:
    """Calibrate a random rig and its logs, and return for each quantity whether its interval contains the truth."""
    seed, profile, kind = job
    rng = np.random.default_rng([seed, tendon_logs.PROFILES.index(profile), sum(map(ord, kind))])
    rig = tendon_logs.draw_rig(rng, profile)
    nominal = model_from(tomllib.loads(tendon_logs.model_text(rig, rng)), "nominal")
    assert isinstance(nominal, TendonSheath)
    swing, change = 0.3 * rig.theta * (kind == "bending varied"), 0.4 * rig.pretension
    logs = {"a.csv": tendon_logs.record(rig, rng, theta_swing=swing, tensions=kind == "tensions measured")}
    if kind == "pretension varied":
        logs["b.csv"] = tendon_logs.record(rig, rng, tensioner=change)
    datasets = [Dataset.from_arrays(columns, name) for name, columns in logs.items()]
    row: Row = {"seed": seed, "profile": profile, "kind": kind}
    tensioner = {"b.csv": change} if "b.csv" in logs else None
    started = time.process_time()  # processor time, which excludes other processes
    try:
        result = calibrate(datasets, nominal, tensioner=tensioner, certified_gain=kind == "gain certified")
    except UsageError as error:
        return {**row, "refused": str(error)}
    row["seconds"] = time.process_time() - started
    found = {name: (getattr(result, name), true) for name, true in rig.truth().items()}
    row["hits"] = {name: bool(q.low <= true <= q.high) for name, (q, true) in found.items()}
    return {**row, "split": bool(result.split)}


def covered(rows: list[Row], name: str) -> str:
    """Return the share of intervals that contain the truth, with its Clopper-Pearson interval, in %."""
    hits, n = sum(row["hits"][name] for row in rows), len(rows)
    low = float(beta.ppf(0.025, hits, n - hits + 1)) if hits else 0.0
    high = float(beta.ppf(0.975, hits + 1, n - hits)) if hits < n else 1.0
    return f"{100 * hits / n:.1f} % ({100 * low:.1f}-{100 * high:.1f})"


def report(everything: list[Row], seed: int) -> Iterator[Table | str]:
    """Yield the coverage by curvature profile and kind of log."""
    rows = [row for row in everything if "refused" not in row]
    refused = sorted({row["refused"] for row in everything if "refused" in row})
    yield f"{len(rows)} logs, seed {seed}: share of 95 % intervals that contain the truth (Clopper-Pearson)"
    lines = []
    for profile, kind in dict.fromkeys((row["profile"], row["kind"]) for row in rows):
        part = [row for row in rows if (row["profile"], row["kind"]) == (profile, kind)]
        known = QUANTITIES if kind in VARIED else QUANTITIES[:2]
        cells = [covered(part, name) if name in known else "(not separable)" for name in QUANTITIES]
        lines.append((profile, kind, len(part), *cells, f"{sum(row['split'] for row in part)}/{len(part)}"))
    heads = ("curvature", "what varies", "n", "slope", "friction torque", "friction angle", "pretension", "separated")
    yield command.table(heads, lines)
    yield f"{len(everything) - len(rows)} logs were rejected" + "".join(f": {text}" for text in refused[:1])
    yield f"slowest calibration: {max(row['seconds'] for row in rows):.2f} s"


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--logs", type=int, default=1000, help="logs in all (default 1000)")
    command.share(parser, "seed rows processes json", seed=1, processes=command.MOST_PROCESSES)
    arguments = parser.parse_args()
    each = max(1, arguments.logs // (len(tendon_logs.PROFILES) + len(VARIED)))
    seeds = range(arguments.seed * 1_000_000, arguments.seed * 1_000_000 + each)
    jobs = [(seed, profile, ONE) for profile in tendon_logs.PROFILES for seed in seeds]
    jobs += [(seed, "joint_end", kind) for kind in VARIED for seed in seeds]
    rows = command.run_rows(one, jobs, lambda row: (row["seed"], row["profile"], row["kind"]), arguments)
    command.print_tables(rows, arguments, lambda: report(rows, arguments.seed))
    return 0
