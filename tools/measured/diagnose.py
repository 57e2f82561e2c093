"""Diagnose a measured cable drive with leave-one-load-out and leave-one-frequency-out folds.

Usage: tools/run measured/diagnose [--processes 2] [--rows FILE] [--reports FOLDER] [--pictures FOLDER] [--list]

Each fold is a call `diagnose(logs, model, hold_out=PATTERN)` with all 25 trials. Its report is written to --reports.
The model is fitted on the other trials, and the error includes all samples of the held-out trials. The errors of each
split are also pooled over its folds. A fold in --rows (default: the source of the manual's table) is not run again
unless --pictures draws it. The command looks for the data in TSA_DATA, and then in ../shared/data. Without data it
prints one line.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tools import command
from tools.command import Results, Row
from tools.figures.look import BACKWARD, FORWARD, NEUTRAL, grid, save
from tsa_ctrl.identify import diagnose
from tsa_ctrl.identify.dataset import load_log
from tsa_ctrl.identify.diagnosis.report.page import write
from tsa_ctrl.model.parameters import load_model

FOLDS = {
    "load": ("load010*", "load030*", "load050*", "load070*", "load090*"),
    "frequency": ("*_0.1Hz*", "*_0.2Hz*", "*_0.3Hz*", "*_0.4Hz*", "*_0.5Hz*"),
}
STEPS = ("as given", "recalibrated", "extended")
# Errors of the manual baseline, mN*m, from the README of the data: (3.55), then with presliding, load, and a spring.
BY_HAND = {"load": (45.7, 15.3, 9.2, 7.0), "frequency": (45.0, 12.9, 8.5, 6.4)}
PUBLISHED = 4.42  # mN*m, error of a published neural network on other splits, with all loads in the training data
SHOWN = ("load010_0.3Hz.csv.gz", "load050_0.3Hz.csv.gz", "load090_0.3Hz.csv.gz")
STRETCH = (0.0, 9.0)  # s, drawn section of these trials


FILE = command.ROOT / "tools" / "manual" / "folds.jsonl"
Curve = tuple[str, np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # trial, t, measured, recalibrated, extended


def fold(job: tuple[str, str, Path, Path]) -> tuple[Row, list[Curve]]:
    """Diagnose with the logs of one pattern held out. Return the row, with errors in mN*m, and the curves to draw."""
    split, pattern, data, out = job
    model = data / "actuator.toml"
    logs = [load_log(path) for path in sorted(data.glob("*.csv.gz"))]
    started = time.process_time()
    result = diagnose(logs, load_model(model), hold_out=pattern)
    seconds = time.process_time() - started
    write(result, out / split / pattern.strip("*_"), model)
    errors = (result.rms.as_given, result.rms.recalibrated, result.rms.extended)
    row: Row = {
        "split": split,
        "left_out": pattern,
        "rms": [None if value is None else 1e3 * value for value in errors],
        "causes": [[cause.effect, *cause.alternatives] for cause in result.causes],
        "sentence": result.sentence,
        "seconds": seconds,
        **command.here(),
    }
    held = {log.name for log in logs if Path(log.name).match(pattern)}
    curves = [
        (c.name, c.t - c.t[0], c.measured, c.recalibrated, c.extended)
        for c in (result.details.curves if result.details else ())
        if c.name in held and c.name in SHOWN
    ]
    return row, curves


def pooled(rows: Sequence[Row]) -> np.ndarray:
    """Return the pooled errors by STEPS, mN*m, shape (3,), or nan if a fold has no error.

    All folds hold out about the same number of samples, so the squares are averaged without weights.
    """
    return np.asarray(np.sqrt(np.mean(np.square(np.array([row["rms"] for row in rows], dtype=np.float64)), axis=0)))


def table(rows: Sequence[Row]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return head and lines of the table: the folds of each split, then their pooled errors and the manual baseline."""
    head = ("left out", "as given", "(3.55) recalibrated", "extended, mN·m", "named (s of one processor)", "measured")
    lines: list[tuple[str, ...]] = []
    by = {(row["split"], row["left_out"]): row for row in rows}
    for split, patterns in FOLDS.items():
        found = [by[split, pattern] for pattern in patterns if (split, pattern) in by]
        for row in found:
            named = "; ".join(" or ".join(each).replace("_", " ") for each in row["causes"]) or "nothing"
            errors = ("refused" if value is None else f"{value:.3g}" for value in row["rms"])
            took = "" if row["seconds"] is None else f" ({row['seconds']:.0f})"
            lines.append((spoken(row["left_out"]), *errors, named + took, f"{row['date']}, {row['commit']}"))
        if len(found) == len(patterns):
            hand = f"by hand, (3.55), + presliding, + load, + spring: {', '.join(f'{x:g}' for x in BY_HAND[split])}"
            more = f"; a published network, all loads seen: {PUBLISHED:g}" if split == "frequency" else ""
            lines.append((f"each {split} once", *(f"{value:.3g}" for value in pooled(found)), hand + more, ""))
    return head, lines


def spoken(pattern: str) -> str:
    """Return the held-out load or frequency of a pattern as readable text."""
    name = pattern.strip("*_")
    return f"load {int(name.removeprefix('load'))} %" if name.startswith("load") else name.replace("Hz", " Hz")


def picture(curves: Sequence[Curve], folder: Path) -> None:
    """Draw the curves of held-out trials."""
    if curves:
        figure, axes_of = grid(len(curves), 1, 8.0, 1.9 * len(curves) + 0.5)
        for (axes,), (name, t, measured, recalibrated, extended) in zip(axes_of, sorted(curves), strict=True):
            part = (t >= STRETCH[0]) & (t <= STRETCH[1])
            axes.plot(t[part], 1e3 * recalibrated[part], color=BACKWARD, lw=1.0, label="(3.55), recalibrated")
            axes.plot(t[part], 1e3 * measured[part], color=NEUTRAL, lw=2.4, label="measured")
            axes.plot(t[part], 1e3 * extended[part], color=FORWARD, lw=1.1, label="extended by the diagnosis")
            axes.set_ylabel("joint torque (mN·m)")
            axes.set_title(f"{name.removesuffix('.csv.gz')}, held out")
        axes_of[0][0].legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 0.98))
        axes_of[-1][0].set_xlabel("t (s)")
        save(figure, folder, "davinci_held_out.png")


def main() -> int:
    parser = command.parser(__name__, __doc__)
    command.share(parser, "processes rows", rows=FILE)
    parser.add_argument(
        "--reports", type=Path, default=command.ROOT / "out" / "davinci_diagnose", help="folder of the reports"
    )
    parser.add_argument("--pictures", type=Path, help="folder of the pictures; default: none are drawn")
    parser.add_argument("--list", action="store_true", help="only print the table of the results in --rows")
    options = parser.parse_args()
    data = None if options.list else command.measured_data(__name__)
    if data is None and not options.list:
        return 0
    results = Results(options.rows, lambda row: (row["split"], row["left_out"]))
    curves: list[Curve] = []
    if data is not None:
        wanted = [(split, pattern) for split in FOLDS for pattern in FOLDS[split]]
        drawn = [each for each in wanted if options.pictures and any(Path(name).match(each[1]) for name in SHOWN)]
        jobs = [(*each, data, options.reports) for each in wanted if each not in results or each in drawn]
        for row, own in command.parallel(fold, jobs, options.processes):
            results.add(row)
            curves += own if row["split"] == "load" else []
            print(f"{row['left_out']}: {row['sentence']}", file=sys.stderr, flush=True)
    known = [results[split, each] for split in FOLDS for each in FOLDS[split] if (split, each) in results]
    head, lines = table(known)
    command.print_table(head, lines)
    if options.pictures:
        picture(curves, options.pictures)
    print("data: O'Neill, Stephens, Kowalewski, IEEE RA-L 3(4):3027-3034, 2018 (Open Database License 1.0)")
    return 0
