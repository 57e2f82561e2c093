"""`tsa diagnose FOLDER`: diagnose each log of a folder separately, with a progress bar and one table of verdicts."""

from __future__ import annotations

import json
from pathlib import Path

import click
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from tsa_ctrl.identify.fleet import Row, executors, logs_in, sweep
from tsa_ctrl.identify.fleet.ledger import TABLE, counted
from tsa_ctrl.model.parameters import load_model
from tsa_ctrl.outputs import json_types, terminal

SHOWN = 40  # maximum number of rows on the screen; verdicts.csv has all of them


def diagnose_folder(
    folder: Path,
    model: Path,
    out: Path,
    *,
    seed: int,
    strict: bool,
    jobs: int | None,
    scheduler: str | None,
    as_json: bool,
) -> None:
    """Diagnose the logs of a folder, and print the results; a log that cannot be read is a row of the table."""
    load_model(model)  # reports an error of the model file once, before the logs
    logs = logs_in(folder)
    console = terminal(stderr=True)
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    place = executors.local(jobs) if scheduler is None else executors.dask(scheduler)
    with place as workers, Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("diagnosing", total=len(logs))

        def tell(done: int, total: int, row: Row | None) -> None:
            bar.update(task, completed=done)
            if row is None and done:
                console.print(f"{done} of {total} logs are already diagnosed in {out}", soft_wrap=True)

        def say(line: str) -> None:
            console.print(line, soft_wrap=True)

        rows = sweep(logs, model, out, workers, seed=seed, strict=strict, progress=tell, say=say)
    verdicts, causes = counted(rows)
    if as_json:
        data = {"schema": 1, "verdicts": dict(sorted(verdicts.items())), "causes": dict(sorted(causes.items()))}
        click.echo(json.dumps({**data, "logs": json_types(rows)}, allow_nan=False, ensure_ascii=False))
    else:
        _show(rows, out)


def _show(rows: list[Row], out: Path) -> None:
    console = terminal()
    table = Table("log", "verdict", "causes (or)", "recalibrated", "extended, mN*m")
    for row in rows[:SHOWN]:
        errors = [row.rms.get(step) for step in ("recalibrated", "extended")]
        values = ["" if value is None else f"{1e3 * value:.3g}" for value in errors]
        table.add_row(row.log, row.verdict, row.told or row.error, *values)
    console.print(table)
    if len(rows) > SHOWN:
        console.print(f"and {len(rows) - SHOWN} more")
    verdicts, causes = counted(rows)
    console.print(
        f"{len(rows)} {'log' if len(rows) == 1 else 'logs'}: "
        + ", ".join(f"{count} {name}" for name, count in verdicts.most_common())
    )
    if causes:
        console.print("causes: " + ", ".join(f"{name} {count}" for name, count in causes.most_common()), soft_wrap=True)
    console.print(f"table: {out / TABLE}; the reports are in the same folder", soft_wrap=True)
