"""Map foreign columns to canonical ones, and write the files of an import.

Column and unit are guessed from the foreign names, or given by a mapping file. A mapping file (TOML) has a `[table]`
(encoding, separator, decimal, header) and one `[column.NAME]` for each canonical column. A column has `from` (the
foreign name), `unit`, and, if the unit requires them, `scale` (SI per unit) and `offset` (SI). An import writes a
canonical CSV file, the mapping, a model file to fill in and a picture.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from tsa_ctrl import outputs, settings
from tsa_ctrl.display import TIME, axis_label
from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.convert import write_columns
from tsa_ctrl.log.foreign.names import ANGLE, CURRENT, SPEED, TORQUE, Name, listed
from tsa_ctrl.log.foreign.text import NO_TEXT, ForeignTable
from tsa_ctrl.log.foreign.units import (
    DATE,
    DEVICE_UNITS,
    EXAMPLES,
    LEVER_ARM,
    SHIFT,
    needs_scale,
    quantities_of,
    scale_of,
)
from tsa_ctrl.signals import COLUMNS, INPUTS

Separator = Annotated[str, Meta(pattern=r'^[^"\r\n]?\Z', description='one character, or " " for any white space')]


class TableSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[table] of a mapping file. Missing keys are determined from the table."""

    encoding: str | None = None
    separator: Separator | None = None
    decimal: Annotated[str, Meta(pattern=r"^[.,]\Z", description='"." or ","')] | None = None
    header: Annotated[int, Meta(ge=0)] | None = None  # line of the names, counted from 1; 0 without such a line
    rate: Annotated[float, Meta(gt=0.0, le=1e9)] | None = None  # Hz, for a table without a time column

    @property
    def shape(self) -> dict[str, str | int]:
        """Return the keys of the shape of the text that the file has."""
        keys = ("encoding", "separator", "decimal", "header")
        return {key: value for key in keys if (value := getattr(self, key)) not in (None, "")}


class ColumnSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True, rename={"source": "from"}):
    """[column.NAME] of a mapping file."""

    source: str
    unit: str
    scale: float | None = None  # SI per unit; required for a unit that depends on the device
    offset: float = 0.0  # SI, added after scaling


class MapFile(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A mapping file."""

    table: TableSettings = TableSettings()
    column: dict[str, ColumnSettings] = {}


@dataclass(frozen=True)
class Mapped:
    """A canonical column and its foreign source, with SI = scale * value + offset."""

    name: str
    source: str
    unit: str
    scale: float
    offset: float

    def values(self, table: ForeignTable) -> NDArray[np.float64]:
        """Return the column in SI units. Raise UsageError with the line of a value that is not a number."""
        if self.unit == DATE:
            return table.times(self.source)
        return table.numbers(self.source) * self.scale + self.offset


def parse_column(text: str) -> tuple[str, ColumnSettings]:
    """Parse `NAME=FOREIGN NAME`, `NAME=FOREIGN NAME|UNIT` or `...|UNIT*SCALE` of the command line.

    Raises:
        UsageError: The text has another form.
    """
    name, separator, rest = text.partition("=")
    source, _, unit = rest.partition("|")
    unit, _, scale = unit.rpartition("*") if re.search(r"\*[-+.\d]", unit) else (unit, "", "")
    try:
        if not separator or not name or not source:
            raise ValueError
        return name, ColumnSettings(source=source, unit=unit, scale=float(scale) if scale else None)
    except ValueError:
        raise UsageError(
            f"--column: found '{text}'; write NAME=HEADER, NAME=HEADER|UNIT or NAME=HEADER|UNIT*SCALE, for example "
            "t='Zeit [s]' or tau_m='Strom|A*0.12'"
        ) from None


def resolve(table: ForeignTable, given: Mapping[str, ColumnSettings], where: str) -> list[Mapped]:
    """Return the given columns, checked against the table.

    Raises:
        UsageError: A column, its source or its unit is wrong. The message has the value found and the allowed ones.
    """
    found = []
    for name, wanted in given.items():
        if name not in COLUMNS:
            near = difflib.get_close_matches(name, INPUTS, n=1)
            advice = f"did you mean '{near[0]}'?" if near else f"allowed are {', '.join(INPUTS)}"
            raise UsageError(f"{where}: unknown column '{name}'; {advice}")
        source = _source(table, wanted.source, where)
        unit = wanted.unit or _unit(Name(source), table, name) or ""
        found.append(_mapped(name, source, unit, wanted.scale, wanted.offset, where))
    return found


@dataclass(frozen=True)
class Identified:
    """The columns that the names of a table determine, and the open questions, each with its proposal or ""."""

    columns: dict[str, ColumnSettings]
    questions: list[tuple[str, str]]


def identify(table: ForeignTable, taken: Mapping[str, ColumnSettings]) -> Identified:
    """Determine the columns from their names, except those in `taken`.

    If several names fit one column, a canonical name wins, then a unit that converts without a scale, then the name
    with the fewest unknown words. If names are still equal, or if a name fits several columns, a question is open.

    Args:
        table: foreign table.
        taken: columns that the user has mapped.

    Returns:
        Columns, with the unit "" if the file has none, and questions. The first name of a question is proposed.
    """
    used = {settings.source for settings in taken.values()}
    fitting: dict[str, list[Name]] = {}
    unclear: dict[tuple[str, ...], list[Name]] = {}
    for source in table.names:
        name = Name(source)
        if source in used or not name.columns:
            continue
        if len(name.columns) > 1:
            unclear.setdefault(tuple(sorted(name.columns, key=list(COLUMNS).index)), []).append(name)
            continue
        (column,) = name.columns
        if column not in taken and (column in ("t", "tau_m") or _unit(name, table, column) is not None):
            fitting.setdefault(column, []).append(name)
    found: dict[str, ColumnSettings] = {}
    questions: list[tuple[str, str]] = []
    for column, names in fitting.items():
        best = _best(names, table, column)
        unit = _unit(best[0], table, column) or ""
        found[column] = ColumnSettings(source=best[0].source, unit=unit)
        if len(best) > 1:
            questions.append((f"{column} may be {listed([n.source for n in best])}", _proposal(column, best[0], unit)))
    for columns, names in unclear.items():
        column = next((c for c in columns if c not in taken and c not in found), "")
        unit = _unit(names[0], table, column) or ""
        if not unit and len({COLUMNS[c].unit for c in columns}) > 1:  # neither the name nor a unit states the quantity
            if column in ("t", "tau_m"):
                remedy = " or ".join(f"--column '{c}={names[0].source}|{COLUMNS[c].unit}'" for c in columns)
                questions.append((f"'{names[0].source}' may be {' or '.join(columns)}; give {remedy}", ""))
        elif column:
            found[column] = ColumnSettings(source=names[0].source, unit=unit)
            question = f"{listed([n.source for n in names])} may be {' or '.join(columns)}"
            questions.append((question, _proposal(column, names[0], unit)))
    return Identified(found, questions)


def optional(table: ForeignTable, mapped: list[Mapped]) -> list[tuple[str, str]]:
    """Return a question and its proposal for each column that is not imported because its unit or place is not stated.

    Without a unit, a column is in SI. Without a place, it belongs to the side, motor or joint, that has no such column
    yet. If both have none, it belongs to the joint in a log with a joint torque, and else to the motor. No place is
    proposed if several names state the same quantity.
    """
    have, used = {column.name for column in mapped}, {column.source for column in mapped}
    names = [Name(source) for source in table.names if source not in used]
    found: dict[str, tuple[str, str]] = {}
    for name in names:
        if len(name.columns) != 1 or name.columns & have or name.unit is not None or name.is_current:
            continue
        (column,) = name.columns
        found.setdefault(column, (f"the unit of {column} from '{name.source}' is not stated", _in_si(column, name)))
    for quantity, stem in ((TORQUE, "tau"), (ANGLE, "q"), (SPEED, "omega")):
        taken = have | set(found)
        sides = ("j", "m") if "tau_j" in taken else ("m", "j")
        free = [f"{stem}_{side}" for side in sides if f"{stem}_{side}" not in taken]
        fitting = [name for name in names if name.unplaced == quantity and _is_measured(_finite(table, name.source))]
        if not free or len(fitting) != 1:
            continue
        (name,), column = fitting, free[0]
        if name.unit is None or not needs_scale(name.unit, COLUMNS[column].unit):
            found[column] = f"'{name.source}' does not state motor or joint", _in_si(column, name)
    return list(found.values())


def forces(table: ForeignTable, mapped: list[Mapped]) -> list[str]:
    """Return the names of unused forces, which a lever arm converts to the joint torque; empty if there is a torque."""
    if any(column.name == "tau_j" for column in mapped):
        return []
    used = {column.source for column in mapped}
    return [source for source in table.names if source not in used and quantities_of(Name(source).unit or "") == {"N"}]


def _in_si(column: str, name: Name) -> str:
    return f"{column}={name.source}|{name.unit or COLUMNS[column].unit}"


def _unit(name: Name, table: ForeignTable, column: str) -> str | None:
    if column == "t" and table.is_date(name.source):
        return DATE
    return "A" if name.unit is None and name.is_current else name.unit


def _best(names: list[Name], table: ForeignTable, column: str) -> list[Name]:
    """Return the names that fit a column best; several if they are equal."""

    def rank(name: Name) -> tuple[bool, int, int]:
        unit = _unit(name, table, column)
        cost = 1 if unit is None else 2 * needs_scale(unit, COLUMNS[column].unit)
        return name.canonical != column, cost, name.unknown

    best = min(rank(name) for name in names)
    return [name for name in names if rank(name) == best]


def _proposal(column: str, name: Name, unit: str) -> str:
    """Return a proposal in the form of --column, or "" if its unit needs a scale."""
    si = COLUMNS[column].unit
    return "" if unit and needs_scale(unit, si) else f"{column}={name.source}|{unit or si}"


def propose(table: ForeignTable, missing: str, used: Set[str]) -> str:
    """Return the proposal for a column that no name determines, in the form of --column.

    Time is the first column that increases in every row and does not count the rows. The torque is the first remaining
    column whose name is a torque, or else the first whose name and unit do not contradict it. A column without a unit
    is in SI.
    """
    si = COLUMNS[missing].unit
    for name in sorted(map(Name, table.names), key=lambda name: missing == "t" or name.unplaced != TORQUE):
        source = name.source
        unit = name.unit or proposed_unit(table, source, missing)
        if source in used or not name.may_be(missing) or needs_scale(unit, si):
            continue
        if missing == "t" and table.is_date(source):
            return f"{missing}={source}|{DATE}"
        finite = _finite(table, source)
        possible = _is_clock(finite, stated=name.unit is not None) if missing == "t" else _is_measured(finite)
        if finite.size and possible:
            return f"{missing}={source}|{unit}"
    return ""


def remedy_of(table: ForeignTable, missing: str, used: Set[str]) -> str:
    """Return the option with which the user states a column without a proposal; `used` are the mapped names."""
    if missing == "t":
        return "give --column t=NAME|UNIT or --rate HZ"
    names = [Name(source) for source in table.names if source not in used]
    for name in sorted(names, key=lambda name: name.unplaced != TORQUE):
        if name.unplaced in (TORQUE, CURRENT):
            unit = name.unit or "A"
            return f"give --column '{missing}={name.source}|{unit}*K', where K is the torque in N*m per {unit}"
    for name in names:
        if name.is_command:
            return f"to use the commanded torque, give --column '{_in_si(missing, name)}'"
    return f"give --column {missing}=NAME|UNIT"


def proposed_unit(table: ForeignTable, source: str, column: str) -> str:
    """Return the unit to propose for a column without one: the SI unit, or for time the unit of a possible rate.

    Times since 1970 state their unit by their size. Other times are in s if the rate of the rows is then possible.
    """
    si = COLUMNS[column].unit
    if column != "t":
        return si
    values = _finite(table, source)
    steps = np.diff(values)
    steps = steps[steps > 0.0]
    if not steps.size:
        return si
    step, largest = float(np.median(steps)), float(np.max(np.abs(values)))
    scales = {unit: scale_of(unit, "s") or 1.0 for unit in ("s", "ms", "us", "ns")}
    possible = [unit for unit, scale in scales.items() if SLOWEST <= 1.0 / (step * scale) <= FASTEST]
    since_1970 = [unit for unit in possible if EPOCH[0] < largest * scales[unit] < EPOCH[1]]
    if since_1970 or si in possible:
        return since_1970[0] if since_1970 else si
    return min(scales, key=lambda unit: abs(math.log(step * scales[unit] * USUAL_RATE)))


def _is_clock(values: NDArray[np.float64], stated: bool) -> bool:
    """Return True if values increase in every row and, without a stated unit, do not count the rows."""
    return bool(np.all(np.diff(values) > 0)) and (stated or not _counts_rows(values))


def _is_measured(values: NDArray[np.float64]) -> bool:
    """Return False for row numbers and for times since 1970."""
    return not _counts_rows(values) and not bool(np.any(np.abs(values) > EPOCH[0]))


def _finite(table: ForeignTable, source: str) -> NDArray[np.float64]:
    """Return the finite values of a column; empty if a cell is not a number."""
    try:
        values = table.numbers(source)
    except UsageError:
        return np.zeros(0)
    return values[np.isfinite(values)]


def _counts_rows(values: NDArray[np.float64]) -> bool:
    return len(values) > 1 and bool(np.all(np.diff(values) == 1.0))


def dump_map(table: ForeignTable, mapped: list[Mapped]) -> str:
    """Return the text of a mapping file that repeats this import."""
    import tomlkit

    document = tomlkit.document()
    document.add(
        tomlkit.comment(f"Mapping of the columns of {table.path.name} to log columns: tsa log import ... --map THIS")
    )
    shape = tomlkit.table()
    for key in ("encoding", "separator", "decimal", "header"):
        shape[key] = getattr(table.shape, key) or ("." if key == "decimal" else 0)
    if table.shape == NO_TEXT:
        shape = tomlkit.table()
    if table.rate is not None:
        shape["rate"] = table.rate
    if shape:
        document["table"] = shape
    columns = tomlkit.table(is_super_table=True)
    for column in mapped:
        if table.rate is not None and column.name == "t":
            continue
        entry = tomlkit.table()
        entry["from"], entry["unit"] = column.source, column.unit
        if column.unit != DATE and scale_of(column.unit, COLUMNS[column.name].unit) != column.scale:
            entry["scale"] = column.scale
        offset = column.offset - SHIFT.get(column.unit, 0.0)
        if offset:
            entry["offset"] = offset
        columns[column.name] = entry
    document["column"] = columns
    return str(tomlkit.dumps(document))


def _source(table: ForeignTable, wanted: str, where: str) -> str:
    if wanted in table.names:
        return wanted
    near = difflib.get_close_matches(wanted, table.names, n=1)
    advice = f"did you mean '{near[0]}'?" if near else f"its columns are {listed(table.names)}"
    raise UsageError(f"{where}: {table.path} has no column '{wanted}'; {advice}")


def _mapped(name: str, source: str, unit: str, scale: float | None, offset: float, where: str) -> Mapped:
    si = COLUMNS[name].unit
    known = scale_of(unit, si)
    here = f"{where}: {name} from '{source}'"
    if scale is None and unit.lower() in DEVICE_UNITS:
        raise UsageError(f"{here}: the unit '{unit}' depends on the device; give scale ({DEVICE_UNITS[unit.lower()]})")
    other = any({quantity, si} != LEVER_ARM for quantity in quantities_of(unit))
    value = known if scale is None else scale
    if value is None or (known is None and other):
        wrong = f"unit '{unit}' belongs to another quantity" if other else f"unknown unit '{unit}'"
        found = wrong if unit else "no unit"
        raise UsageError(
            f"{here}: {found}; allowed are {EXAMPLES.get(si, si)}, or a unit of your device with scale ({si} per unit)"
        )
    if not math.isfinite(value) or value == 0.0 or not math.isfinite(offset):
        raise UsageError(
            f"{here}: scale {value:g} with offset {offset:g}; give finite numbers and a scale other than 0"
        )
    return Mapped(name, source, unit, value, offset + SHIFT.get(unit, 0.0))


SLOWEST, FASTEST, USUAL_RATE = 2.0, 50e3, 500.0  # Hz, sampling rates of a drive's log
EPOCH = (1e9, 4e9)  # s since 1970: the years 2001 to 2096
COUNTERS = (16, 24, 32)  # bits of a counter of time
MOST_LOST = 5.0  # median steps, longest step over the end of a counter
MOST_EQUAL = 0.5  # largest fraction of rows with the time of the row above
POINTS = 4000  # least number of drawn points of a longer curve
Columns = Mapping[str, NDArray[np.float64]]

RIGID = """# A plain drive: tau_M = J domega/dt + tau_c sign(omega) + b omega + c. A key behind # can be identified.
[actuator]
kind = "rigid_drive"
coulomb_friction = {coulomb:.3g}{pad}# N*m: half the median torque of this log; replace it with your estimate
# inertia = 1e-4                 # kg*m^2
# viscous_friction = 0.0         # N*m*s/rad
# torque_offset = 0.0            # N*m
"""
GEARED = """# A drive with a gear and a joint torque sensor, without tendons:
# tau_J = eta^s N tau_M - tau_c sigma - b omega_J, s = +1 where the motor drives, -1 where it is driven.
[actuator]
kind = "geared_drive"
ratio = ""                       # FILL IN: N, motor turns per joint turn
efficiency = 0.9                 # eta, 1
coulomb_friction = {coulomb:.3g}{pad}# tau_c, N*m: 5 % of the median torque of this log; replace it with your estimate
viscous_friction = 0.0           # b, N*m*s/rad
"""


@dataclass(frozen=True)
class Imported:
    """The files that an import has written."""

    log: Path
    mapping: Path
    model: Path | None  # None if the file existed already
    picture: Path


def take(table: ForeignTable, mapped: list[Mapped]) -> tuple[dict[str, NDArray[np.float64]], str]:
    """Return the columns in SI units, with time 0 at the first row, and a note on a counter that wraps, or "".

    Raises:
        UsageError: A value is not a number, or the time decreases. The message has the line.
    """
    columns = {column.name: column.values(table) for column in sorted(mapped, key=lambda column: column.name != "t")}
    t = columns["t"]
    good = np.isfinite(t)
    note = ""
    if good.any():
        scale = next(column.scale for column in mapped if column.name == "t")
        t[good], note = _continued(t[good], scale)
        columns["t"] = t - t[good][0]
    equal = int(np.count_nonzero(np.diff(t[good]) == 0.0))
    if equal > MOST_EQUAL * len(t):
        raise UsageError(
            f"{table.path}: column t: {equal} of {len(t)} rows have the time of the row above, so the resolution of "
            "the time is too coarse; export it with more digits, or remove it and give --rate HZ"
        )
    back = np.flatnonzero(np.diff(t[good]) < 0.0)
    if back.size:
        before, row = np.flatnonzero(good)[back[0] : back[0] + 2]
        raise UsageError(
            f"{table.path}: column t, line {table.first + row}: the time decreases from "
            f"{columns['t'][before]:.9g} s to {columns['t'][row]:.9g} s after the first row; split the file there, or "
            "sort its rows by time"
        )
    return columns, note


def _continued(t: NDArray[np.float64], scale: float) -> tuple[NDArray[np.float64], str]:
    """Return times in s without the jumps of a counter that wraps, and a note, or the times unchanged and "".

    A counter wraps at a power of 2 of its unit or of a decimal fraction of it, and continues with a usual step.
    """
    steps = np.diff(t)
    back = steps < 0.0
    if not back.any() or not (steps > 0.0).any():
        return t, ""
    longest = MOST_LOST * float(np.median(steps[steps > 0.0]))
    for bits in COUNTERS:
        for digits in (0, 3, 6, 9):
            period = 2.0**bits * scale / 10.0**digits
            over = steps[back] + period
            if longest < period and np.ptp(t) < period and np.all((over > 0.0) & (over <= longest)):
                count = np.concatenate([[0], np.cumsum(back)])
                note = (
                    f"the counter of the time wraps {count[-1]} times at {bits} bits ({period:.6g} s) and is continued"
                )
                return t + period * count, note
    return t, ""


def write(
    folder: Path,
    table: ForeignTable,
    mapped: list[Mapped],
    columns: Columns,
    tendon_sheath: str,
    stem: str,
    kind: str = "",
) -> Imported:
    """Write the files of an import to `folder`.

    Args:
        folder: folder of the files.
        table: foreign table.
        mapped: mapping of the columns.
        columns: columns in SI units.
        tendon_sheath: text of the model file of a tendon-sheath.
        stem: start of the file names.
        kind: kind of the model file. The default is a tendon-sheath if there is a joint torque, or else a plain drive.

    Raises:
        UsageError: A file cannot be written.
    """
    log, mapping, model = folder / f"{stem}.csv", folder / f"{stem}-map.toml", folder / "model.toml"
    picture = folder / f"{stem}.png"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{folder}: cannot be created ({error.strerror}); choose another --out") from None
    for path in (log, mapping, picture):
        outputs.refuse_inputs(path, [table.path])
    write_columns(log, columns)
    outputs.keep(mapping)
    settings.write_text(mapping, dump_map(table, mapped))
    made = None
    if not model.exists():
        made = model
        settings.write_text(model, _model(columns, tendon_sheath, kind))
    _draw(picture, table, columns)
    return Imported(log, mapping, made, picture)


def _model(columns: Columns, tendon_sheath: str, kind: str) -> str:
    kind = kind or ("tendon_sheath" if "tau_j" in columns else "rigid_drive")
    if kind == "tendon_sheath":
        return tendon_sheath
    text, name, share = (GEARED, "tau_j", 0.05) if kind == "geared_drive" else (RIGID, "tau_m", 0.5)
    tau = columns.get(name, np.zeros(1))
    coulomb = share * float(np.nanmedian(np.abs(tau))) if tau.size else 0.0
    value = f"{coulomb:.3g}"
    return text.format(coulomb=coulomb, pad=" " * max(1, 33 - len(f"coulomb_friction = {value}")))


def _draw(path: Path, table: ForeignTable, columns: Columns) -> None:
    from matplotlib.figure import Figure

    names = [name for name in columns if name != "t"]
    figure = Figure(figsize=(9.0, 1.0 + 1.5 * len(names)), layout="constrained")
    step = max(1, len(columns["t"]) // POINTS)
    for i, name in enumerate(names, start=1):
        axes = figure.add_subplot(len(names), 1, i)
        axes.plot(columns["t"][::step], columns[name][::step], linewidth=0.8)
        axes.set_ylabel(axis_label(name, COLUMNS[name].unit).replace(" (", "\n("))
        axes.grid(alpha=0.3)
        if i == len(names):
            axes.set_xlabel(TIME)
    figure.suptitle(f"{table.path.name}: imported columns in SI units")
    outputs.save_picture(figure, path, dpi=110)
