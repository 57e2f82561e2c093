"""Read a log file of any kind as a table of columns, and check tables of waypoints.

Waypoints are a table over increasing time, for example of a set-point or a motion.
"""

from __future__ import annotations

import errno
import hashlib
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.arguments import path_of
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.log.csv_table import connected, doubles, opened, quoted, read_csv, said
from tsa_ctrl.signals import is_selected

_NUMERIC = re.compile(r"U?(TINY|SMALL|BIG|HUGE)?INT(EGER)?|FLOAT|DOUBLE|DECIMAL\(.*\)")  # DuckDB's names of types

ENDINGS = (".csv", ".csv.gz", ".parquet", ".mcap")


@dataclass(frozen=True)
class Table:
    """The columns of one axis, float64 and of equal length, with nan for missing values.

    Attributes:
        label: name of the file (and axis) in messages.
        columns: columns by name, (n,) each.
        left_out: names of the columns that were not loaded.
        above: number of lines above the first row of a text file; None for other files.
        axis: name of the axis; None for a table.
        recorded: True for a log of the daemon.
        simulated: True for the log of a virtual run.
        rows: row of the file for each row of the table, (n,); None if they are the same.
        notes: descriptions of the repairs.
    """

    label: str
    columns: dict[str, NDArray[np.float64]]
    left_out: tuple[str, ...] = ()
    above: int | None = None
    axis: str | None = None
    recorded: bool = False
    simulated: bool = False
    rows: NDArray[np.int64] | None = None
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def place(self, row: int) -> str:
        """Return the place of a row (0-based index) for messages: its number from 1, and the line of a text file."""
        number = (row if self.rows is None else int(self.rows[row])) + 1
        return f"row {number}" if self.above is None else f"row {number} (line {number + self.above})"


def kind_of(path: Path) -> str:
    """Return the ending of the file name. Raise UsageError for an unknown ending."""
    name = path.name.lower()
    for ending in ENDINGS:
        if name.endswith(ending):
            return ending
    raise UsageError(
        f"{path}: unknown kind of log '{path.suffix}'; allowed are {', '.join(ENDINGS)}; tsa log import reads the "
        "tables of other programs"
    )


def split_axis(path: str | Path) -> tuple[Path, str | None]:
    """Split `run.mcap:NAME` into file and axis. The axis is None if a file with the whole name exists."""
    file = Path(path)
    stem, colon, axis = str(path).rpartition(":")
    if colon and not file.exists() and stem.lower().endswith(".mcap"):
        return Path(stem), axis
    return file, None


def check_readable(path: Path) -> None:
    """Raise UsageError if `path` is not a readable file."""
    file = path_of(path, "log", f"the path of a log ({', '.join(ENDINGS)})")
    if file.is_fifo():  # to open it could wait forever
        raise UsageError(f"{path}: is a pipe; write it to a file and give its path")
    try:
        with file.open("rb"):
            return
    except FileNotFoundError:
        raise UsageError(f"{path}: no such file; give the path of a log ({', '.join(ENDINGS)})") from None
    except IsADirectoryError:
        raise UsageError(f"{path}: is a folder; give the path of a log in it") from None
    except OSError as error:
        remedy = "grant read permission" if error.errno in (errno.EACCES, errno.EPERM) else "give the path of a log"
        raise UsageError(f"{path}: cannot be read ({error.strerror}); {remedy}") from None


def sha256_of(path: str | Path) -> str:
    """Return the hexadecimal SHA-256 of a log file, by which a result can be traced to it."""
    file, _ = split_axis(path)
    check_readable(file)
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def read_table(path: str | Path, wanted: Collection[str] | None = None) -> Table:
    """Read the columns `wanted`, or all numeric columns, of one axis of a log.

    Raises:
        UsageError: The file is missing, damaged or of an unknown kind, or it has several axes and `path` names none.
    """
    file, axis = split_axis(path)
    check_readable(file)
    kind = kind_of(file)
    if kind == ".mcap":
        return _read_log(file, axis, wanted)
    if kind == ".parquet":
        return _read_parquet(file, wanted)
    columns, left_out, above = read_csv(file, wanted)
    recorded = {"cycle", "state"} <= {*columns, *left_out}
    return Table(str(file), columns, tuple(left_out), above, recorded=recorded)


def _read_log(path: Path, axis: str | None, wanted: Collection[str] | None) -> Table:
    """Read one axis of a log of the daemon, without empty columns."""
    from tsa_ctrl.log.mcap_file import RUN
    from tsa_ctrl.log.reader import LogFile

    log = LogFile(path)
    axis, *others = log.chosen(axis)
    if others:
        raise UsageError(f"{path}: has the axes {', '.join(log.axes)}; select one, for example {path}:{axis}")
    kept = [name for name in log.fields if wanted is None or name in wanted]
    columns = log.columns(axis, kept)
    if wanted is None or "q_j" in wanted:
        columns |= {name: at(columns["t"]) for name, at in log.joint_angles().items()} if "t" in columns else {}
    columns = {name: values for name, values in columns.items() if name == "t" or not np.isnan(values).all()}
    label = str(path) if len(log.axes) == 1 else f"{path}:{axis}"
    left_out = tuple(name for name in log.fields if name not in kept)
    return Table(label, columns, left_out, axis=axis, recorded=True, simulated=RUN in log.files)


def _read_parquet(path: Path, wanted: Collection[str] | None) -> Table:
    import duckdb

    try:
        with connected() as connection, opened(path) as file:
            twice = connection.execute(
                f"SELECT path_in_schema FROM parquet_metadata('{file}') "
                "GROUP BY path_in_schema, row_group_id HAVING count(*) > 1"
            ).fetchone()
            if twice is not None:
                raise UsageError(f"{path}: column {twice[0]} appears twice; rename or remove one")
            described = connection.execute(f"DESCRIBE SELECT * FROM read_parquet('{file}')").fetchall()
            kinds = {name: kind for name, kind, *_ in described}
            numeric = [name for name, kind in kinds.items() if _NUMERIC.fullmatch(kind)]
            for name, kind in kinds.items():
                if wanted is not None and is_selected(name, wanted) and name not in numeric:
                    raise UsageError(f"{path}: column {name} is {kind}, not a number; convert it")
            columns = {}
            for name in numeric:
                if is_selected(name, wanted):  # read one by one, so that only one column is in memory twice
                    query = f"SELECT CAST({quoted(name)} AS DOUBLE) AS x FROM read_parquet('{file}')"
                    columns[name] = doubles(connection.execute(query).fetchnumpy()["x"])
    except duckdb.Error as error:
        raise UsageError(f"{path}: is not a readable Parquet file ({said(error)}); export it again") from None
    recorded = {"cycle", "state"} <= kinds.keys()
    return Table(str(path), columns, tuple(name for name in kinds if name not in columns), recorded=recorded)


STOP_MARGIN = 0.05  # s before the end of a run that are left out, because the stop may have started
STRETCH = "tau_j_stretch"
LEAST_CYCLES = 100  # least number of cycles with torque for an evaluation


def load_run(
    log: str | Path,
    names: Collection[str],
    fade_in: float,
    seconds: float,
    cause: str = "",
    by_stretch: bool = False,
) -> dict[str, NDArray[np.float64]]:
    """Return the columns of one run between the fade-in and the stop.

    Cycles that were lost or have no joint torque are left out.

    Args:
        log: log of the daemon.
        names: columns to read in addition to t, tau_j_des, tau_m_cmd and tau_j.
        fade_in: time after the enable that is left out, s.
        seconds: time with torque from the enable, s.
        cause: reason for the end of the run, for the error message.
        by_stretch: True to take tau_j from the tendon elongation, for a rig without a joint torque sensor.

    Returns:
        Arrays of equal length by column, with `t` in s since the enable.

    Raises:
        BusError: The log contains too little torque.
        UsageError: The joint torque sensor sent no values.
    """
    columns = read_table(
        log, {"t", "tau_j_des", "tau_m_cmd", "tau_j", *([STRETCH] if by_stretch else []), *names}
    ).columns
    if by_stretch:
        columns = {**columns, "tau_j": columns.get(STRETCH, np.full(len(columns["t"]), np.nan))}
        if not np.isfinite(columns["tau_j"]).any():
            raise BusError(f"{log}: no joint torque was computed from the tendon elongation; see the run's events")
    t = columns["t"]
    active = np.flatnonzero((columns["tau_j_des"] != 0.0) | (columns["tau_m_cmd"] != 0.0))
    if not active.size:
        raise BusError(f"{log}: contains no torque" + (f"; {cause}" if cause else "; inspect the log"))
    known = np.isfinite(columns.get("tau_j", np.full(len(t), np.nan)))
    if not known.any():
        raise UsageError(f"{log}: the joint torque sensor sent no data; check [axis.torque_sensor] or its wiring")
    enabled = float(t[active[0]])
    chosen = (t >= enabled + fade_in) & (t <= enabled + seconds - STOP_MARGIN) & known
    if np.count_nonzero(chosen) < LEAST_CYCLES:
        raise BusError(f"{log}: contains too few cycles with torque" + (f"; {cause}" if cause else "; inspect the log"))
    part = {name: values[chosen] for name, values in columns.items()}
    return {**part, "t": part["t"] - enabled}


LEAST_ROWS = 2


def read_waypoints(path: str | Path, needed: Sequence[str], optional: Sequence[str] = ()) -> Table:
    """Read the columns `t` (s), `needed` and, if present, `optional` of a CSV, CSV.gz or Parquet file.

    Raises:
        UsageError: A column is missing, a value is not finite, there are fewer than two rows, or time does not
            increase. The message has file, column and row.
    """
    wanted = ("t", *needed, *optional)
    table = read_table(path, wanted)
    for name in ("t", *needed):
        if name not in table.columns:
            there = ", ".join([*table.columns, *table.left_out]) or "none"
            raise UsageError(f"{path}: column '{name}' is missing, found {there}; add it")
    if len(table) < LEAST_ROWS:
        raise UsageError(f"{path}: too few rows ({len(table)}); give at least {LEAST_ROWS}")
    for name, values in table.columns.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise UsageError(f"{path}: column '{name}', {table.place(int(bad[0]))}: not a finite number; correct it")
    back = np.flatnonzero(np.diff(table.columns["t"]) <= 0.0)
    if back.size:
        raise UsageError(
            f"{path}: column 't', {table.place(int(back[0]) + 1)}: time does not increase; sort the rows by time and "
            "remove duplicates"
        )
    return table


def from_zero(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the times relative to the first time."""
    shifted: NDArray[np.float64] = t - t[0]
    return shifted
