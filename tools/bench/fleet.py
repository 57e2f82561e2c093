"""A folder of hundreds of logs through `tsa diagnose FOLDER`: interrupted, gone on with, and marked.

Usage: tools/run bench/fleet [--logs 200] [--seed 0] [--jobs N] [--scheduler tcp://host:8786] [--keep DIR]

The logs are of one rig (tests/blind, nothing shared with the package), 12 to 20 s each; three of ten hide nothing,
the others one effect each. The command gets SIGINT when a third is answered, and is started again. Exit code 1: a log
has no answer in verdicts.csv, or one was asked twice.
"""

from __future__ import annotations

import csv
import signal
import subprocess
import tempfile
import time
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np

from tests.blind.fleet import fleet
from tools import command
from tsa_ctrl.system.processes import tsa

PATIENCE = 0.5  # s between looks at what is answered


def write(folder: Path, count: int, seed: int) -> dict[str, str]:
    """Write model and logs; returns what is hidden, by name of the log."""
    (folder / "logs").mkdir(parents=True)
    model, cases = fleet(count, seed)
    (folder / "actuator.toml").write_text(model, encoding="utf-8")
    hidden = {}
    for number, case in enumerate(cases):
        columns = case.logs[0].columns
        path = folder / "logs" / f"drive_{number:04d}.csv"
        table = np.column_stack(list(columns.values()))
        np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
        hidden[path.name] = next(iter(case.truth.effects), "nothing")
    return hidden


def answered(out: Path) -> int:
    path = out / "fleet.jsonl"
    return path.read_text("utf-8").count("\n") if path.exists() else 0


def run(command: list[str], out: Path, stop_at: int | None) -> tuple[float, int]:
    """Run it to its end, or to `stop_at` answers and Ctrl-C; returns the seconds and the exit code."""
    started = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    while stop_at is not None and process.poll() is None and answered(out) < stop_at:
        time.sleep(PATIENCE)
    if stop_at is not None:
        process.send_signal(signal.SIGINT)
    code = process.wait()
    return time.perf_counter() - started, code


def show(out: Path, hidden: dict[str, str]) -> int:
    """Print the table by hidden effect; returns how many logs have no answer."""
    with (out / "verdicts.csv").open(newline="", encoding="utf-8") as file:
        rows = {row["log"]: row for row in csv.DictReader(file)}
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    for log, truth in hidden.items():
        row, count = rows.get(log), counts[truth]
        count["logs"] += 1
        if row is None or row["verdict"] == "error":
            count["no answer"] += 1
            continue
        causes = [cause.partition(" (or ") for cause in filter(None, row["causes"].split("; "))]
        named = [name for name, _, _ in causes]
        alone = [name for name, _, others in causes if not others]
        count["the truth alone"] += named == alone == ([] if truth == "nothing" else [truth])
        count["among what is named"] += truth == "nothing" or any(truth in "".join(cause) for cause in causes)
        count["something else for sure"] += any(name != truth for name in alone)
    titles = ("logs", "the truth alone", "among what is named", "something else for sure", "no answer")
    print(f"{'hidden':32}" + "".join(f"{title:>{len(title) + 3}}" for title in titles))
    for truth, count in [*sorted(counts.items()), ("all", sum(counts.values(), Counter()))]:
        print(f"{truth:32}" + "".join(f"{count[title]:>{len(title) + 3}}" for title in titles))
    return sum(count["no answer"] for count in counts.values())


def main() -> int:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a child would inherit that it is ignored, as under nohup
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, help="processes; default: one per core")
    parser.add_argument("--scheduler", help="of a running Dask cluster, for the second half")
    parser.add_argument("--keep", type=Path, help="folder for logs and reports; default: a temporary one")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary) / "fleet"
        if folder.exists():
            parser.error(f"--keep {folder}: is there already; name a new folder")
        hidden = write(folder, options.logs, options.seed)
        out = folder / "out"
        verb = tsa("diagnose", str(folder / "logs"), "--model", str(folder / "actuator.toml"), "--out", str(out))
        jobs = ["--jobs", str(options.jobs)] if options.jobs else []
        first, code = run(verb + jobs, out, max(1, options.logs // 3))
        before = answered(out)
        print(f"{before} of {options.logs} logs in {first:.0f} s, then Ctrl-C: exit code {code}")
        more = ["--scheduler", options.scheduler] if options.scheduler else jobs
        second, code = run(verb + more, out, None)
        after = answered(out)
        print(
            f"the other {after - before} in {second:.0f} s: exit code {code}; {after} questions for {options.logs} logs"
        )
        return int(show(out, hidden) > 0 or code != 0 or after != options.logs)
