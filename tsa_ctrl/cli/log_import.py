"""`tsa log import`: interpret, show and write tables of other programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.cli.init import empty_model
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.dataset import LEAST_PRESENT, NEEDED
from tsa_ctrl.log.foreign import mapping
from tsa_ctrl.log.foreign.cells import is_number
from tsa_ctrl.log.foreign.mapping import Imported, Mapped
from tsa_ctrl.log.foreign.names import Name, listed
from tsa_ctrl.log.foreign.text import NO_TEXT, ForeignTable, read_foreign, row_clock
from tsa_ctrl.outputs import terminal
from tsa_ctrl.settings import load
from tsa_ctrl.signals import COLUMNS

MOST_SIGNALS = 100  # different names in a column of signal names


@dataclass(frozen=True)
class Understood:
    """A foreign table, the mapping of its columns, and the mapped columns in SI units."""

    table: ForeignTable
    mapped: list[Mapped]
    columns: dict[str, NDArray[np.float64]]
    dropped: int  # omitted rows with a NaN, which leave gaps in the log
    sparse: Mapping[str, float]  # omitted foreign columns and the fraction of their rows with a number
    notes: tuple[str, ...] = ()  # on the place of the table and on the repair of its time

    @property
    def markers(self) -> dict[str, dict[str, int]]:
        """Return the number of cells for each text that a mapped foreign column has instead of a number."""
        found = {column.source: dict(self.table.markers(column.source)) for column in self.mapped}
        return {source: markers for source, markers in found.items() if markers}

    @property
    def left(self) -> list[str]:
        """Return the foreign columns that are not mapped, or that have no place in the table."""
        taken = {column.source for column in self.mapped}
        return [name for name in self.table.names if name not in taken] + list(self.table.dropped)


def understand_all(
    paths: Sequence[Path], map_file: Path | None, given: Sequence[str], accept: bool, rate: float | None = None
) -> tuple[list[Understood], list[str]]:
    """Read and map all files; return them with the proposals that were used.

    Raises:
        UsageError: questions of any file are open; one message lists all. With `accept`, the proposals answer them.
    """
    done, open_questions = [], []
    proposals: list[str] = []
    for path in paths:
        found, asked = understand(path, map_file, given, accept, rate)
        done += [] if found is None else [found]
        fixed = [question for question, proposal in asked if not proposal]
        proposals = list(dict.fromkeys([*proposals, *(proposal for _, proposal in asked if proposal)]))
        if fixed or (asked and not accept):
            open_questions.append(f"{path}: {'; '.join(question for question, _ in asked)}")
    if open_questions:
        said = " ".join(f"--column '{proposal}'" for proposal in proposals)
        remedy = f"; --yes accepts the proposals {said}" if said else ""
        raise UsageError("; ".join(open_questions) + remedy)
    return done, proposals


def understand(
    path: Path, map_file: Path | None, given: Sequence[str], accept: bool, rate: float | None = None
) -> tuple[Understood | None, list[tuple[str, str]]]:
    """Read and map one file.

    Args:
        path: file of another program.
        map_file: mapping file, or None.
        given: columns of the command line.
        accept: the proposals answer all questions.
        rate: sampling rate in Hz of a file without a time column; None takes the rate of the mapping file.

    Returns:
        The mapped table, or None if a question has no proposal, and the open questions, each with its proposal or "".

    Raises:
        UsageError: The file or the mapping is wrong.
    """
    file = mapping.MapFile() if map_file is None else load(map_file, mapping.MapFile)
    table = read_foreign(path, file.table.shape)
    said = {**file.column, **dict(mapping.parse_column(text) for text in given)}
    rate = rate or file.table.rate
    if rate is not None:
        table = _with_rate(table, said, rate)
    mapped = mapping.resolve(table, said, str(map_file or "--column"))
    asked: list[tuple[str, str]] = []
    if table.rate is not None:
        time = mapping.ColumnSettings(source=row_clock(table.rate), unit="s")
        said["t"] = time
        mapped += mapping.resolve(table, {"t": time}, "--rate")
    if not file.column:
        identified = mapping.identify(table, said)
        asked += identified.questions
        for name, settings in identified.columns.items():
            unit = settings.unit
            if not unit:
                unit = mapping.proposed_unit(table, settings.source, name)
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
    names = listed(table.names)
    for name in ("t", "tau_m"):
        if name in answered:
            continue
        used = {column.source for column in mapped}
        proposal = mapping.propose(table, name, used)
        remedy = "" if proposal else f"; {mapping.remedy_of(table, name, used)}"
        asked.append((f"none of the names {names} identifies {name} ({COLUMNS[name].doc}){remedy}", proposal))
        if proposal:
            mapped += mapping.resolve(table, dict([mapping.parse_column(proposal)]), "proposal")
    _reject_long_format(table, mapped)
    if not file.column and (accept or asked):  # without another question, optional columns are only a note
        for question, proposal in mapping.optional(table, mapped):
            mapped += mapping.resolve(table, dict([mapping.parse_column(proposal)]), "proposal")
            asked.append((question, proposal))
    if any(not proposal for _, proposal in asked):
        return None, asked
    columns, note = mapping.take(table, mapped)
    notes = tuple(filter(None, (table.note, note)))
    shares = {name: float(np.isfinite(values).mean()) for name, values in columns.items() if name != "t"}
    empty = {name for name, share in shares.items() if share == 0.0 or (share < LEAST_PRESENT and name not in NEEDED)}
    sparse = {column.source: shares[column.name] for column in mapped if column.name in empty}
    mapped = [column for column in mapped if column.name not in empty]
    good = np.logical_and.reduce([np.isfinite(values) for name, values in columns.items() if name not in empty])
    kept = {name: values[good] for name, values in columns.items() if name not in empty}
    if not good.any():
        raise UsageError(f"{path}: no row has a number in each of {', '.join(kept)}; map fewer columns with --map")
    return Understood(table, mapped, kept, int((~good).sum()), sparse, notes), asked


def _with_rate(table: ForeignTable, said: Mapping[str, mapping.ColumnSettings], rate: float) -> ForeignTable:
    """Return the table with a time column from the sampling rate. Raise UsageError if it has a time column."""
    time = {**mapping.identify(table, said).columns, **said}.get("t")
    if time is not None:
        raise UsageError(
            f"{table.path}: a rate of {rate:g} Hz is given, but the column '{time.source}' is the time; omit the rate"
        )
    return table.with_rate(rate)


def _reject_long_format(table: ForeignTable, mapped: Sequence[Mapped]) -> None:
    """Raise UsageError if each row has one value of one signal, whose name is in a column of texts."""
    time = next((column for column in mapped if column.name == "t"), None)
    if time is None or not table.cells or time.source not in table.cells:
        return
    stamps = table.cells[time.source]
    if len(set(stamps)) > 0.75 * len(stamps):
        return
    for name, cells in table.cells.items():
        signals = dict.fromkeys(cells)
        few = 2 <= len(signals) <= min(MOST_SIGNALS, len(cells) // 2)
        if (
            few
            and not any(is_number(cell) for cell in signals)
            and len(set(zip(stamps, cells, strict=True))) == len(cells)
        ):
            raise UsageError(
                f"{table.path}: each row has one of the {len(signals)} signals {listed(signals)} of the column "
                f"'{name}', and the times repeat; pivot the table to one column per signal"
            )


def stems(paths: Sequence[Path]) -> list[str]:
    """Return a file name without suffix for each path; equal names get their suffix, then a number."""
    short = [path.name.split(".")[0] for path in paths]
    whole = [s if short.count(s) == 1 else path.name.replace(".", "_") for s, path in zip(short, paths, strict=True)]
    return [w if whole.count(w) == 1 else f"{w}_{whole[:i].count(w) + 1}" for i, w in enumerate(whole)]


def write(done: Understood, out: Path, stem: str, kind: str) -> Imported:
    """Write log, mapping, model and picture to `out`; raises UsageError."""
    return mapping.write(out, done.table, done.mapped, done.columns, empty_model(), stem, kind)


def show(done: Understood) -> None:
    """Print the interpretation of the table before anything is written."""
    from rich.table import Table

    shape, console = done.table.shape, terminal()
    named = {"\t": "tab", " ": "white space"}.get(shape.separator, f"'{shape.separator}'")
    rows = len(done.columns["t"])
    text = (
        f"{done.table.path.name}: {shape.encoding}, separator {named}, decimal sign '{shape.decimal or '.'}', names in "
        f"line {shape.header}, {rows} rows"
    )
    if shape == NO_TEXT:
        text = f"{done.table.path.name}: {len(done.table.names)} columns, {rows} rows"
    console.print(text)
    for note in done.notes:
        console.print(f"note: {note}")
    for name, markers in done.markers.items():
        count, texts = sum(markers.values()), ", ".join(f"'{text}'" for text in list(markers)[:4])
        console.print(f"note: column '{name}' has {count} cells without a number ({texts})")
    for name, share in done.sparse.items():
        console.print(f"note: column '{name}' has a number in {share:.0%} of the rows and is omitted")
    if done.dropped:
        console.print(f"note: {done.dropped} rows with a missing number are omitted and leave gaps")
    if done.table.ignored:
        console.print(f"note: {done.table.ignored} lines that are not table rows are ignored")
    view = Table("column", "from", "unit", "SI per unit", "lowest", "highest", "SI unit")
    for column in done.mapped:
        low, high = _span(done.columns[column.name])
        unit = COLUMNS[column.name].unit
        view.add_row(column.name, column.source, column.unit, f"{column.scale:.6g}", low, high, unit)
    console.print(view)
    if done.left:
        for question, proposal in mapping.optional(done.table, done.mapped):
            console.print(f"note: {question}; to import it, add --column '{proposal}'", soft_wrap=True)
        for source in mapping.forces(done.table, done.mapped):
            proposal = f"--column 'tau_j={source}|{Name(source).unit}*R'"
            console.print(
                f"note: '{source}' is a force; to import it as joint torque, add {proposal}, where R is its lever arm",
                soft_wrap=True,
            )
        console.print(f"not imported: {listed(done.left)}")


def as_dict(done: Understood, written: Imported) -> dict[str, Any]:
    """Return the object that `--json` prints."""
    columns = {
        column.name: {"from": column.source, "unit": column.unit, "scale": column.scale, "offset": column.offset}
        for column in done.mapped
    }
    files = {key: None if path is None else str(path) for key, path in vars(written).items()}
    return {
        "schema": 1,
        "rows": len(done.columns["t"]),
        "columns": columns,
        "not_taken": done.left,
        "markers": done.markers,
        "notes": list(done.notes),
        **files,
    }


def _span(values: NDArray[np.float64]) -> tuple[str, str]:
    finite = values[np.isfinite(values)]
    return ("-", "-") if not finite.size else (f"{finite.min():.4g}", f"{finite.max():.4g}")
