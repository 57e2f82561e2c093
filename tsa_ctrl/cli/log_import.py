"""`tsa log import`: interpret, show and write tables of other programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.cli.init import SHIPPED
from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.foreign import mapping
from tsa_ctrl.log.foreign.mapping import Imported, Mapped
from tsa_ctrl.log.foreign.text import NO_TEXT, ForeignTable, read_foreign
from tsa_ctrl.signals import COLUMNS


@dataclass(frozen=True)
class Understood:
    """A foreign table, the mapping of its columns, and the mapped columns in SI units."""

    table: ForeignTable
    mapped: list[Mapped]
    columns: dict[str, NDArray[np.float64]]
    dropped: int  # omitted rows with a NaN, which leave gaps in the log

    @property
    def left(self) -> list[str]:
        """Return the foreign columns that are not mapped."""
        taken = {column.source for column in self.mapped}
        return [name for name in self.table.names if name not in taken]


def understand_all(
    paths: Sequence[Path], map_file: Path | None, given: Sequence[str], accept: bool
) -> tuple[list[Understood], list[str]]:
    """Read and map all files; return them with the proposals that were used.

    Raises:
        UsageError: questions of any file are open; one message lists all. With `accept`, the proposals answer them.
    """
    done, open_questions, proposals = [], [], []
    for path in paths:
        found, asked = understand(path, map_file, given)
        done += [] if found is None else [found]
        fixed = [question for question, proposal in asked if not proposal]
        proposals += [proposal for _, proposal in asked if proposal and proposal not in proposals]
        if fixed or (asked and not accept):
            open_questions.append(f"{path}: {'; '.join(question for question, _ in asked)}")
    if open_questions:
        said = " ".join(f"--column '{proposal}'" for proposal in proposals)
        remedy = f"; --yes accepts the proposals {said}" if said else ""
        raise UsageError("; ".join(open_questions) + remedy)
    return done, proposals


def understand(
    path: Path, map_file: Path | None, given: Sequence[str]
) -> tuple[Understood | None, list[tuple[str, str]]]:
    """Read and map one file; return it and the open questions, each with its proposal or ""."""
    file = mapping.MapFile() if map_file is None else mapping.load_map(map_file)
    table = read_foreign(path, mapping.full_shape(file))
    shape = mapping.shape_of(file, table.shape)
    if table.shape not in (shape, NO_TEXT):
        table = read_foreign(path, shape)
    said = {**file.column, **dict(mapping.parse_column(text) for text in given)}
    mapped = mapping.resolve(table, said, str(map_file or "--column"))
    asked: list[tuple[str, str]] = []
    if map_file is None:
        for name, settings in mapping.guess(table, said).items():
            unit = settings.unit
            if not unit:
                unit = COLUMNS[name].unit
                asked.append(
                    (f"the unit of {name} from '{settings.source}' is not stated", f"{name}={settings.source}|{unit}")
                )
            try:
                mapped += mapping.resolve(
                    table, {name: mapping.ColumnSettings(source=settings.source, unit=unit)}, name
                )
            except UsageError as error:
                asked.append((str(error), ""))
    answered = {column.name for column in mapped} | {text.partition(":")[0] for text, fix in asked if not fix}
    names = ", ".join(f"'{name}'" for name in table.names)
    for name in ("t", "tau_m"):
        if name in answered:
            continue
        proposal = mapping.propose(table, name, {column.source for column in mapped})
        remedy = "" if proposal else f"; give --column {name}=NAME|UNIT"
        asked.append((f"none of the names {names} identifies {name} ({COLUMNS[name].doc}){remedy}", proposal))
        if proposal:
            mapped += mapping.resolve(table, dict([mapping.parse_column(proposal)]), "proposal")
    if any(not proposal for _, proposal in asked):
        return None, asked
    columns = mapping.take(table, mapped)
    empty = {name for name, values in columns.items() if not np.isfinite(values).any() and name != "t"}
    mapped = [column for column in mapped if column.name not in empty]
    good = np.logical_and.reduce([np.isfinite(values) for name, values in columns.items() if name not in empty])
    kept = {name: values[good] for name, values in columns.items() if name not in empty}
    if not good.any():
        raise UsageError(f"{path}: no row has a number in each of {', '.join(kept)}; map fewer columns with --map")
    return Understood(table, mapped, kept, int((~good).sum())), asked


def stems(paths: Sequence[Path]) -> list[str]:
    """Return a file name without suffix for each path; equal names get their suffix, then a number."""
    short = [path.name.split(".")[0] for path in paths]
    whole = [s if short.count(s) == 1 else path.name.replace(".", "_") for s, path in zip(short, paths, strict=True)]
    return [w if whole.count(w) == 1 else f"{w}_{whole[:i].count(w) + 1}" for i, w in enumerate(whole)]


def write(done: Understood, out: Path, stem: str, kind: str) -> Imported:
    """Write log, mapping, model and picture to `out`; raises UsageError."""
    return mapping.write(out, done.table, done.mapped, done.columns, SHIPPED / "actuator.toml", stem, kind)


def show(done: Understood) -> None:
    """Print the interpretation of the table before anything is written."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Column, Table

    shape, console = done.table.shape, Console()
    named = {"\t": "tab", " ": "white space"}.get(shape.separator, f"'{shape.separator}'")
    rows = len(done.columns["t"])
    text = (
        f"{done.table.path.name}: {shape.encoding}, separator {named}, decimal sign '{shape.decimal}', names in "
        f"line {shape.header}, {rows} rows"
    )
    if shape == NO_TEXT:
        text = f"{done.table.path.name}: {len(done.table.names)} columns, {rows} rows"
    console.print(text, markup=False, highlight=False)
    if done.dropped:
        console.print(f"note: {done.dropped} rows with a missing number are omitted and leave gaps", markup=False)
    if done.table.ignored:
        console.print(f"note: {done.table.ignored} lines that are not table rows are ignored", markup=False)
    view = Table("column", Column("from", overflow="fold"), "unit", "SI per unit", "lowest", "highest", "SI unit")
    for column in done.mapped:
        low, high = _span(done.columns[column.name])
        unit = COLUMNS[column.name].unit
        view.add_row(column.name, escape(column.source), escape(column.unit), f"{column.scale:.6g}", low, high, unit)
    console.print(view)
    if done.left:
        console.print(f"not imported: {', '.join(done.left)}", markup=False, highlight=False)


def as_dict(done: Understood, written: Imported) -> dict[str, Any]:
    """Return the object that `--json` prints."""
    columns = {
        column.name: {"from": column.source, "unit": column.unit, "scale": column.scale, "offset": column.offset}
        for column in done.mapped
    }
    files = {key: None if path is None else str(path) for key, path in vars(written).items()}
    return {"schema": 1, "rows": len(done.columns["t"]), "columns": columns, "not_taken": done.left, **files}


def _span(values: NDArray[np.float64]) -> tuple[str, str]:
    finite = values[np.isfinite(values)]
    return ("-", "-") if not finite.size else (f"{finite.min():.4g}", f"{finite.max():.4g}")
