"""Coverage of calibration's 95 % intervals on randomised logs.

Usage: tools/run bench/calibrate [--logs 1000] [--seed 1] [--jobs 2] [--results FILE]
Each log's result is appended to FILE as it comes; a run that was interrupted goes on from there.
The logs come from the elongation equilibrium of two tendons (tests/blind/tendon_logs.py), not from the package.
"""

from __future__ import annotations

import os
import time
import tomllib
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from scipy.stats import beta

from tests.blind import tendon_logs
from tools import command
from tools.command import Results, Row
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.calibrate import calibrate
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import TendonSheath, model_from

Job = tuple[int, str, str]  # seed, profile, kind
VARIED = ("pretension varied", "bending varied", "tensions measured", "gain certified")


def nominal_of(rig: tendon_logs.Rig, rng: np.random.Generator) -> TendonSheath:
    """The model file that is written for a rig."""
    model = model_from(tomllib.loads(tendon_logs.model_text(rig, rng)), "nominal")
    assert isinstance(model, TendonSheath)
    return model


def one(job: Job) -> Row:
    """Draw a rig and a log by seed, calibrate, and say for each quantity whether its interval holds the truth."""
    seed, profile, kind = job
    rng = np.random.default_rng([seed, tendon_logs.PROFILES.index(profile), sum(map(ord, kind))])
    rig = tendon_logs.draw_rig(rng, profile)
    nominal = nominal_of(rig, rng)
    change = 0.4 * rig.pretension
    logs = {
        "a.csv": tendon_logs.record(
            rig, rng, theta_swing=0.3 * rig.theta * (kind == "bending varied"), tensions=kind == "tensions measured"
        )
    }
    if kind == "pretension varied":
        logs["b.csv"] = tendon_logs.record(rig, rng, tensioner=change)
    datasets = [Dataset.from_arrays(columns, name) for name, columns in logs.items()]
    started = time.process_time()  # of the processor: other processes do not count
    try:
        result = calibrate(
            datasets,
            nominal,
            tensioner={"b.csv": change} if "b.csv" in logs else None,
            certified_gain=kind == "gain certified",
        )
    except UsageError as error:
        return {"seed": seed, "profile": profile, "kind": kind, "refused": str(error)}
    seconds = time.process_time() - started
    truth = rig.truth()
    quantities = {name: getattr(result, name) for name in truth}
    hits = {name: bool(q.low <= truth[name] <= q.high) for name, q in quantities.items()}
    found = {name: [float(truth[name]), q.value, q.low, q.high] for name, q in quantities.items()}
    return {
        "seed": seed,
        "profile": profile,
        "kind": kind,
        "hits": hits,
        "found": found,
        "split": bool(result.split),
        "seconds": seconds,
    }


def run(jobs: list[Job], workers: int, file: Path | None) -> list[Row]:
    """Results of all jobs; those that `file` holds are read from it, the others appended as they come."""
    results = Results(file, lambda row: (row["seed"], row["profile"], row["kind"]))
    with ProcessPoolExecutor(workers) as pool:
        for row in pool.map(one, [job for job in jobs if job not in results], chunksize=1):
            results.add(row)
    return [results[job] for job in jobs]


def covered(results: list[Row], name: str) -> str:
    hits = sum(r["hits"][name] for r in results)
    n = len(results)
    low = float(beta.ppf(0.025, hits, n - hits + 1)) if hits else 0.0
    high = float(beta.ppf(0.975, hits + 1, n - hits)) if hits < n else 1.0
    return f"{100 * hits / n:5.1f} % ({100 * low:.1f}-{100 * high:.1f})"


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--logs", type=int, default=1000, help="logs in all (default 1000)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--results", type=Path, help="a JSON object per log; those that it holds are not run again")
    arguments = parser.parse_args()
    each = max(1, arguments.logs // (len(tendon_logs.PROFILES) + len(VARIED)))
    seeds = range(arguments.seed * 1_000_000, arguments.seed * 1_000_000 + each)
    jobs = [(s, p, "one configuration") for p in tendon_logs.PROFILES for s in seeds]
    jobs += [(s, "joint_end", kind) for kind in VARIED for s in seeds]
    everything = run(jobs, arguments.jobs, arguments.results)
    results = [r for r in everything if "refused" not in r]
    refusals = sorted({str(r["refused"]) for r in everything if "refused" in r})
    print(f"{len(results)} logs, seed {arguments.seed}: share of 95 % intervals that hold the truth (Clopper-Pearson)")
    print(
        f"{'curvature':10s} {'what varies':18s} {'n':>4s}  {'slope':20s} {'half loop torque':20s} "
        f"{'friction angle':20s} {'pretension':20s} parted"
    )
    for kind, profile in [("one configuration", p) for p in tendon_logs.PROFILES] + [(k, "joint_end") for k in VARIED]:
        part = [r for r in results if (r["kind"], r["profile"]) == (kind, profile)]
        own = [covered(part, "slope"), covered(part, "half_loop_torque")]
        own += [covered(part, n) if kind in VARIED else "(not parted)" for n in ("friction_angle", "pretension")]
        print(
            f"{profile:10s} {kind:18s} {len(part):4d}  "
            + " ".join(f"{c:20s}" for c in own)
            + f" {sum(bool(r['split']) for r in part)}/{len(part)}"
        )
    print(f"{len(everything) - len(results)} logs were refused{': ' * bool(refusals)}{refusals[0] if refusals else ''}")
    print(f"slowest calibration: {max(r['seconds'] for r in results):.2f} s")
    return 0
