"""What `tsa log import` understood of a foreign table: found, shown as a table, written."""

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
from tsa_ctrl.log.foreign import write as writing
from tsa_ctrl.log.foreign.mapping import Mapped
from tsa_ctrl.log.foreign.text import ForeignTable, read_foreign
from tsa_ctrl.log.foreign.write import Imported
from tsa_ctrl.signals import COLUMNS


@dataclass(frozen=True)
class Understood:
    """A foreign table, which of its columns are ours, and these in SI."""

    table: ForeignTable
    mapped: list[Mapped]
    columns: dict[str, NDArray[np.float64]]

    @property
    def left(self) -> list[str]:
        """Foreign columns that are not taken."""
        taken = {column.source for column in self.mapped}
        return [name for name in self.table.names if name not in taken]


def understand(path: Path, map_file: Path | None, given: Sequence[str]) -> Understood:
    """Read and map; raises UsageError naming what is missing and how to say it."""
    file = mapping.MapFile() if map_file is None else mapping.load_map(map_file)
    table = read_foreign(path)
    shape = mapping.shape_of(file, table.shape)
    if shape != table.shape:
        table = read_foreign(path, shape)
    said = {**file.column, **dict(mapping.parse_column(text) for text in given)}
    mapped = mapping.resolve(table, said, str(map_file or "--column"))
    if map_file is None:
        mapped += mapping.resolve(table, mapping.guess(table, said), str(path))
    names = {column.name for column in mapped}
    missing = [name for name in ("t", "tau_m") if name not in names]
    if missing:
        columns = ", ".join(f"'{name}'" for name in table.names)
        raise UsageError(
            f"{path}: which column is {missing[0]} ({COLUMNS[missing[0]].doc}) is not told by the names {columns}; "
            f"give --column {missing[0]}=NAME|UNIT"
        )
    return Understood(table, mapped, writing.take(table, mapped))


def write(done: Understood, out: Path) -> Imported:
    """Write the log and what goes with it to `out`; raises UsageError."""
    return writing.write(out, done.table, done.mapped, done.columns, SHIPPED / "actuator.toml")


def show(done: Understood) -> None:
    """The table of what was understood, before anything is written."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Column, Table

    shape, console = done.table.shape, Console()
    named = {"\t": "tab", " ": "white space"}.get(shape.separator, f"'{shape.separator}'")
    rows = len(done.columns["t"])
    console.print(
        f"{done.table.path.name}: {shape.encoding}, fields parted by {named}, decimal sign '{shape.decimal}', names in "
        f"line {shape.header}, {rows} rows",
        markup=False,
        highlight=False,
    )
    if done.table.ignored:
        console.print(f"note: {done.table.ignored} lines that are no rows of the table are left out", markup=False)
    view = Table("column", Column("from", overflow="fold"), "unit", "SI per unit", "lowest", "highest", "SI unit")
    for column in done.mapped:
        low, high = _span(done.columns[column.name])
        unit = COLUMNS[column.name].unit
        view.add_row(column.name, escape(column.source), escape(column.unit), f"{column.scale:.6g}", low, high, unit)
    console.print(view)
    if done.left:
        console.print(f"not taken: {', '.join(done.left)}", markup=False, highlight=False)


def as_dict(done: Understood, written: Imported) -> dict[str, Any]:
    """What `--json` prints."""
    columns = {
        column.name: {"from": column.source, "unit": column.unit, "scale": column.scale, "offset": column.offset}
        for column in done.mapped
    }
    files = {key: None if path is None else str(path) for key, path in vars(written).items()}
    return {"schema": 1, "rows": len(done.columns["t"]), "columns": columns, "not_taken": done.left, **files}


def _span(values: NDArray[np.float64]) -> tuple[str, str]:
    finite = values[np.isfinite(values)]
    return ("-", "-") if not finite.size else (f"{finite.min():.4g}", f"{finite.max():.4g}")
