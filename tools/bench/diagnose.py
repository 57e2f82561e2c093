"""Measure the diagnosis on logs with hidden effects, and compare it with naive strategies on the same logs.

Usage: tools/run bench/diagnose [--quick] [--short] [--families single:30 none:400 ...] [--names EFFECT ...]
                            [--processes 2] [--seed 0] [--rows FILE.jsonl] [--list] | --speed

The logs are computed from the four tendon tensions (tests/blind), not by the package. Each result is appended to
--rows. With the same file an interrupted run continues. Results of another version of the code are ignored. --quick is
the gate: its exit code is 1 if a result is significantly worse than its target.
"""

from __future__ import annotations

import hashlib
import json
import resource
import subprocess
import sys
import tempfile
import time
import tomllib
import traceback
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tests.blind import FAMILIES, HiddenLog, case
from tests.blind.gain import fresh_gain
from tests.blind.naive import name_effects
from tests.blind.score import mark
from tests.blind.table import failed, print_table
from tools import command
from tools.command import Results, Row
from tsa_ctrl.identify import diagnose
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import model_from
from tsa_ctrl.system.process_supervisor import tsa

# Number of cases for each name of a family. For "none" and "pair", the total number of cases.
FULL = {
    "none": 400,
    "hidden_direction": 25,
    "single": 30,
    "pair": 60,
    "outside": 8,
    "confounded": 6,
    "rigid": 10,
    "geared": 10,
}
Job = tuple[str, str, int, bool]  # family, name, seed, short
QUICK = {"none": 40, "single": 2}


def jobs(counts: dict[str, int], names: list[str], seed: int, short: bool) -> Iterator[Job]:
    """Yield every case, with families interleaved so that an interrupted run has cases of each family."""
    queues = []
    for family, count in counts.items():
        known = [name for name in FAMILIES[family] if not names or name in names]
        total = count if family in ("none", "pair") else count * len(known)
        total += 30 if family == "rigid" and "none" in known and count >= FULL["rigid"] else 0
        queue = [(family, known[i % len(known)], seed + i // len(known), short) for i in range(total if known else 0)]
        queues.append([(k / max(len(queue), 1), job) for k, job in enumerate(dict.fromkeys(queue))])
    for _, job in sorted((entry for queue in queues for entry in queue), key=lambda entry: entry[0]):
        yield job


def ask(logs: list[HiddenLog], model: str) -> tuple[Row, float]:
    """Return the contents of diagnosis.json and the duration of the diagnosis, s."""
    datasets = [Dataset.from_arrays(log.columns, log.name) for log in logs]
    started = time.perf_counter()
    report = json.loads(diagnose(datasets, model_from(tomllib.loads(model), "nominal.toml")).to_json())
    return report, time.perf_counter() - started


def one(job: Job) -> Row:
    """Generate a case, diagnose it and its experiment, and mark both and the naive strategies on the same logs."""
    try:
        hidden = case(*job)
    except (RuntimeError, ValueError) as problem:  # no such case can be generated; it is printed but not counted
        return {"undrawn": str(problem)}
    family, name, seed, short = job
    truth = hidden.truth
    result: Row = {
        "family": family,
        "name": name,
        "seed": seed,
        "short": short,
        "effects": truth.effects,
        "ratio": truth.size / truth.noise,
        "sign_ratio": truth.sign_noise / truth.noise,
        "log_seconds": hidden.seconds,
        "setting": truth.setting,
    }
    report, experiment, error = SILENT, None, ""
    try:
        report, result["seconds"] = ask(hidden.logs, hidden.model)
        if hidden.experiment is not None:
            experiment, _ = ask(hidden.experiment.logs, hidden.experiment.model)
    except Exception as problem:  # a failure counts as a wrong answer
        error = f"{type(problem).__name__}: {problem} at {traceback.extract_tb(problem.__traceback__)[-1]}"
    result["error"] = error
    result["mark"] = mark(hidden, report, experiment).as_dict()
    result["verdict"] = report["verdict"]
    result["causes"] = [[c["effect"], c["alternatives"], c.get("probability")] for c in report["causes"]]
    if experiment is not None:
        result["experiment_causes"] = [[c["effect"], c["alternatives"]] for c in experiment["causes"]]
    result["gain"] = report.get("gain")
    result["fresh_gain"] = fresh_gain(hidden, report["causes"])
    if family not in ("rigid", "geared"):
        result["naive"] = {
            strategy: mark(hidden, as_report(found)).as_dict()
            for strategy, found in name_effects(hidden.logs, hidden.model).items()
        }
    return result


SILENT: Row = {"verdict": "error", "causes": [], "parameter_errors": {}, "experiment": ""}


def as_report(names: list[str]) -> Row:
    """Return the report of a naive strategy, whose causes have no alternatives."""
    causes = [{"effect": name, "alternatives": [], "parameters": {}} for name in names]
    return {**SILENT, "verdict": "explained" if names else "consistent", "causes": causes}


def code_version() -> str:
    """Return a digest of the sources of diagnosis, model and blind benchmark."""
    digest = hashlib.sha256()
    folders = ("tsa_ctrl/identify", "tsa_ctrl/model", "tests/blind")
    for path in sorted(path for folder in folders for path in (command.ROOT / folder).rglob("*.py")):
        if not path.name.startswith("test_"):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def key(row: Row) -> Job:
    """Return the job of a row."""
    return row["family"], row["name"], row["seed"], row["short"]


def run(queue: list[Job], processes: int, results: Results, version: str) -> None:
    """Run the jobs of the queue, and write each result to disk immediately."""
    started = time.perf_counter()
    for done, row in enumerate(command.parallel(one, queue, processes), 1):
        if "undrawn" in row:
            print(row["undrawn"], file=sys.stderr)
        else:
            results.add({**row, "version": version})
        if sys.stderr.isatty() or done % 20 == 0:
            left = (time.perf_counter() - started) / done * (len(queue) - done)
            print(f"{done}/{len(queue)}, {left / 60:.0f} min left", file=sys.stderr)


def speed(seed: int) -> None:
    """Print the duration of `tsa diagnose` on CSV files of 60 s at 1 kHz, from process start to process end."""
    for name in ("stribeck_friction", "presliding_hysteresis", "thermal_friction_drift"):
        hidden = case("timing", name, seed)
        with tempfile.TemporaryDirectory() as folder:
            log, model, out = (Path(folder) / part for part in ("log.csv", "actuator.toml", "out"))
            columns = hidden.logs[0].columns
            table = np.column_stack(list(columns.values()))
            np.savetxt(log, table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
            model.write_text(hidden.model)
            before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
            verb = tsa("diagnose", str(log), "--model", str(model), "--out", str(out), "--json")
            told = subprocess.run(verb, check=True, capture_output=True, text=True).stdout
            seconds, after = time.perf_counter() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
        used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        causes = ", ".join(cause["effect"] for cause in json.loads(told)["causes"])
        print(
            f"{hidden.seconds:.0f} s at {len(table) / hidden.seconds:.0f} Hz, "
            f"hidden {name}, named {causes or 'nothing'}: {seconds:.1f} s, of which {used:.1f} s of one processor"
        )


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--quick", action="store_true", help="the gate: 40 without effect, 2 per effect, short logs")
    parser.add_argument("--short", action="store_true", help="short logs: 12 to 20 s, one run")
    parser.add_argument("--families", nargs="+", metavar="FAMILY[:N]", help=f"of {', '.join(FULL)}; N per name")
    parser.add_argument("--names", nargs="+", default=[], help="only these effects, kinds or rows")
    command.share(parser, "processes seed", processes=command.MOST_PROCESSES, seed=0)
    parser.add_argument("--rows", "--out", type=Path, help="JSON lines of finished runs, which are not run again")
    parser.add_argument("--list", action="store_true", help="only print the table of the results in --rows")
    parser.add_argument(
        "--speed", action="store_true", help="only measure the time that `tsa diagnose` takes for 60 s at 1 kHz"
    )
    arguments = parser.parse_args()
    if arguments.speed:
        speed(arguments.seed)
        return 0
    counts = dict(QUICK if arguments.quick else FULL)
    if arguments.families:
        asked = [entry.partition(":") for entry in arguments.families]
        unknown = [family for family, _, _ in asked if family not in FULL]
        if unknown:
            parser.error(f"unknown family {unknown[0]}; available: {', '.join(FULL)}")
        counts = {family: int(count or counts.get(family, FULL[family])) for family, _, count in asked}
    name = "bench_diagnose_quick.jsonl" if arguments.quick else "bench_diagnose.jsonl"
    out = arguments.rows or command.ROOT / "out" / name
    out.parent.mkdir(parents=True, exist_ok=True)
    version = code_version()
    wanted = list(jobs(counts, arguments.names, arguments.seed, arguments.quick or arguments.short))
    results = Results(out, key, lambda row: row["version"] == version)
    queue = [job for job in wanted if job not in results]
    if not arguments.list:
        print(f"{len(queue)} cases to run, {len(wanted) - len(queue)} known; results in {out}", file=sys.stderr)
        run(queue, arguments.processes, results, version)
    rows = [results[job] for job in wanted if job in results]
    print_table(rows)
    errors = Counter(row["error"] for row in rows if row["error"])
    for error, count in errors.most_common(10):
        print(f"ERROR {count} times: {error}")
    return 1 if arguments.quick and (errors or failed(rows)) else 0
