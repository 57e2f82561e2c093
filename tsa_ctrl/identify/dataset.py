"""Prepare a log for simulation and diagnosis: check it, resample it to a uniform grid, and derive missing velocities.

All columns are in SI units. Each defect is reported in one line with file, column and row. Each repair and each derived
column is listed in `notes`.
"""

from __future__ import annotations

import dataclasses
import difflib
import fnmatch
import functools
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tsa_ctrl.arguments import kind_of, number_of
from tsa_ctrl.display import Displayed, lines
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.motion import SHAFTS, Motion, in_words
from tsa_ctrl.identify.redundancy import check_columns
from tsa_ctrl.identify.spikes import without_spikes
from tsa_ctrl.identify.units import check_rate, check_sizes
from tsa_ctrl.log.table import Table, read_table, sha256_of
from tsa_ctrl.log.timing import LONGEST_SKIP, check_increasing, fit_grid, fit_stamps, repair_timestamps
from tsa_ctrl.model.effects.specification import Kind
from tsa_ctrl.model.parameters import GearedDrive, Model, TendonSheath
from tsa_ctrl.model.signals import Signals
from tsa_ctrl.signals import COLUMNS, INPUTS, JOINT_ANGLE, is_input

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

MOST_JITTER = 0.20  # fraction of the period; a row with more jitter counts as late, which is an error in strict mode
UNIFORM = 1e-3  # fraction of the period; smaller jitter is rounding, so the samples are not changed
FEWEST_LOGS = 3  # fewest logs for which whole logs are held out: with two, the fit would use only one
MOTOR_AND_JOINT = (("q_m", "q_j"), ("omega_m", "omega_j"))
FEWEST = 10  # fewest rows of a log; a table with fewer is little more than a heading
NEEDED = frozenset(("tau_m", "tau_j", "omega_j", "q_j", "omega_m", "q_m"))
BURST = 3  # fewest consecutive rows without a number that count as a hole; fewer are reported as an error
TURN = 2.0 * np.pi  # rad, the range of a wrapped angle
WRAPS = 0.1  # turns, largest deviation of a jump of a wrapped angle from one turn
MOST_ROWS = 1e8  # of a resampled log
LEAST_PRESENT = 0.5  # fraction of rows; an optional signal with values in fewer rows is not used


@dataclass(frozen=True, repr=False)
class Dataset(Displayed):
    """One log on a uniform grid.

    Attributes:
        columns: float64 arrays of shape (n,), SI units, without nan.
        derived: names of the columns that were not in the file.
        motion: the smoother that derives them.
        read: one sentence for each repair made while the file was read.
        left_out: columns of the file that are not used.
        jitter: largest deviation from the uniform grid in the file, as a fraction of the period.
        simulated: True for the log of a virtual run.
    """

    name: str
    sha256: str
    rate: float
    columns: dict[str, Array]
    motion: Motion
    read: tuple[str, ...] = ()
    derived: frozenset[str] = frozenset()
    left_out: tuple[str, ...] = ()
    jitter: float = 0.0
    label: str = ""
    simulated: bool = False

    @staticmethod
    def from_arrays(
        columns: Mapping[str, ArrayLike], name: str = "arrays", recorded: bool = False, cutoff: float | None = None
    ) -> Dataset:
        """Return a dataset from arrays of one length, after the same checks as for a file.

        Args:
            columns: arrays by the name of the column, a data frame or a structured array. Masked values count as nan.
                `t` may have dates or durations.
            name: name of the dataset in messages.
            recorded: True for the daemon's own log, in which single cycles may be missing.
            cutoff: as in `load_log`.

        Raises:
            UsageError: as `load_log`.
        """
        given = _columns_of(columns, name)
        if given is None:
            raise UsageError(
                f"{name}: is a {kind_of(columns)}, not the columns of a log; give a mapping from column to "
                "array, several logs as a list or as a mapping from name to columns, and read a file with load_log"
            )
        found = {key: _numbers(name, key, value) for key, value in given.items()}
        arrays = {key: array for key, array in found.items() if array is not None}
        shapes = Counter(array.shape for key, array in arrays.items() if is_input(key))
        usual = max(shapes, key=lambda shape: (len(shape) == 1, shapes[shape]), default=())
        for key in [key for key, array in arrays.items() if array.ndim != 1 or array.shape != usual]:
            if is_input(key):
                wanted = f"({usual[0]},)" if len(usual) == 1 else "(n,)"
                raise UsageError(
                    f"{name}: column {key} has shape {arrays[key].shape}; give columns of one length {wanted}"
                )
            del arrays[key]
        left_out = tuple(key for key in given if key not in arrays)
        return _longest(_datasets(Table(name, arrays, left_out, recorded=recorded), name, "", False, cutoff))

    def facts(self) -> dict[str, str]:
        """Return name, duration, rate and columns of the log."""
        measured = ", ".join(name for name in self.columns if name not in self.derived)
        derived = ", ".join(name for name in self.columns if name in self.derived)
        found = {"log": self.name, "duration": f"{self['t'][-1] - self['t'][0]:.4g} s", "rate": f"{self.rate:.4g} Hz"}
        return {**found, "columns": measured, **({"derived": derived} if derived else {})}

    def plot(self) -> Figure:
        """Return a picture of torques, velocities and angles over time."""
        panels = []
        for label, names in (
            ("torque (N·m)", ("tau_m", "tau_j")),
            ("velocity (rad/s)", ("omega_m", "omega_j")),
            ("angle (rad)", ("q_m", "q_j")),
        ):
            if signals := {name: self[name] for name in names if name in self}:
                panels.append((label, signals))
        return lines(panels, self["t"], f"{self.name}: {self['t'][-1] - self['t'][0]:.4g} s at {self.rate:.4g} Hz")

    def __len__(self) -> int:
        return len(self.columns["t"])

    def __contains__(self, column: str) -> bool:
        return column in self.columns

    def __getitem__(self, column: str) -> Array:
        if column not in self.columns:
            raise UsageError(_missing(self.label or self.name, str(column), (*self.columns, *self.left_out)))
        return self.columns[column]

    @property
    def notes(self) -> tuple[str, ...]:
        """Return one sentence for each repair and each column derived so far; accelerations are derived on demand."""
        return notes_of([self])

    @property
    def period(self) -> float:
        """Return the sampling period, s."""
        return 1.0 / self.rate

    @property
    def seconds(self) -> float:
        """Return the time from the first to the last sample, s."""
        return float(self.columns["t"][-1] - self.columns["t"][0])

    def require(self, model: Model, *more: str) -> None:
        """Raise UsageError if the log lacks a column of `more`, or one that every simulation with `model` needs."""
        motions = {Kind.RIGID_DRIVE: ("omega_m", "q_m"), Kind.GEARED_DRIVE: ("omega_j", "q_j", "q_m", "omega_m")}
        wanted = motions.get(model.kind, ("omega_j", "q_j"))
        if not any(name in self.columns for name in wanted):
            known = (*(name for name in self.columns if name not in self.derived), *self.left_out)
            raise UsageError(_missing(self.label or self.name, " or ".join(wanted), known))
        for column in more:
            self[column]

    def completed_for(self, model: Model) -> Dataset:
        """Return this log with the columns that `model` derives from other columns.

        For tendon-sheaths, `[routing]` determines the wrap angle theta from the angles q_j.NAME. A log that lacks one
        of these angles keeps its column theta; if it has no such column either, UsageError is raised. For a geared
        drive, the ratio converts between the motions of motor and joint.
        """
        if isinstance(model, GearedDrive):
            return self._turned_by(model.ratio)
        if isinstance(model, TendonSheath):
            return self._bent_by(model)
        return self

    def _turned_by(self, ratio: float) -> Dataset:
        recorded = self.motion.columns
        other = {name: recorded[motor] / ratio for motor, name in MOTOR_AND_JOINT if motor in recorded}
        other |= {motor: recorded[name] * ratio for motor, name in MOTOR_AND_JOINT if name in recorded}
        motion = Motion({**other, **recorded}, self.period, self.motion.cutoff)
        derived = motion.derived()
        columns = {**other, **self.columns, **derived}
        return dataclasses.replace(self, columns=columns, derived=self.derived | set(derived), motion=motion)

    def _bent_by(self, model: TendonSheath) -> Dataset:
        routing = model.routing
        if routing is None:
            return self
        lacking = [joint for joint in routing.joints if f"{JOINT_ANGLE}{joint}" not in self.columns]
        if lacking and "theta" in self.columns:
            return self
        if lacking:
            raise UsageError(
                f"{self.label or self.name}: column {JOINT_ANGLE}{lacking[0]} is missing, and [routing] of "
                f"{model.source or 'the model'} names joint '{lacking[0]}'; log its angle (rad), name the axis "
                "of a log of all joints (run.mcap:AXIS), or add column theta"
            )
        angles = {joint: self.columns[f"{JOINT_ANGLE}{joint}"] for joint in routing.joints}
        routing.check_log(model.bending_angle, angles, f"{self.label or self.name}: {model.source or 'the model'}")
        a, b = routing.wrap_angles(angles)
        bent = {"theta": model.bending_angle + 0.5 * (a + b)}
        if not routing.alike:
            bent["theta_difference"] = 0.5 * (a - b)
        return dataclasses.replace(self, columns={**self.columns, **bent}, derived=self.derived | set(bent))

    def resampled(self, rate: float) -> Dataset:
        """Return this log at `rate` (Hz), interpolated linearly; a note states this, and columns are derived again."""
        rate = number_of(rate, f"{self.name}: rate in Hz", 1.0 / max(self.seconds, 1.0), MOST_ROWS / self.seconds)
        t = self.columns["t"]
        times = t[0] + np.arange(math.floor(self.seconds * rate + UNIFORM) + 1) / rate
        recorded = [name for name in self.columns if name not in self.derived]
        columns = {name: np.interp(times, t, self.columns[name]) for name in recorded} | {"t": times}
        made = Dataset.from_arrays(columns, self.name, cutoff=self.motion.cutoff)
        note = f"{self.name}: resampled by straight lines from {self.rate:.5g} Hz to {rate:.5g} Hz for the other logs"
        same = {name: getattr(self, name) for name in ("sha256", "left_out", "jitter", "label", "simulated")}
        return dataclasses.replace(made, read=(*self.read, note), **same)

    @cached_property
    def _signals(self) -> Signals:
        optional = ("q_j", "q_m", "omega_m", "theta", "theta_difference", "temperature")
        present = {name: self.columns.get(name) for name in optional}
        omega_j = self.columns.get("omega_j")
        if omega_j is None:  # in a plain drive, motor and joint are the same shaft
            omega_j = self.columns["omega_m"]
        motions = self.motion.accelerations()
        motor = motions.get("acceleration_m")
        joint = motor if self.columns.get("omega_j") is None else motions.get("acceleration_j")
        return Signals(
            t=self.columns["t"],
            tau_m=self.columns["tau_m"],
            omega_j=omega_j,
            acceleration_j=joint,
            acceleration_m=motor,
            **present,
            joints={
                name.removeprefix(JOINT_ANGLE): values
                for name, values in self.columns.items()
                if name.startswith(JOINT_ANGLE)
            },
        )

    def signals(self) -> Signals:
        """Return the columns as signals for a model; for a plain drive, omega_j is the motor velocity."""
        return self._signals


def _constructed(dataset: Dataset, *args: Any, **named: Any) -> None:
    """Initialise a dataset from its attributes, or from the only argument as `dataset_of`."""
    if len(args) == 1 and not named:
        made = dataset_of(args[0])
        for each in dataclasses.fields(made):
            object.__setattr__(dataset, each.name, getattr(made, each.name))
        return
    try:
        _from_attributes(dataset, *args, **named)
    except TypeError:
        raise UsageError(
            "Dataset: give the columns of one log, Dataset(columns); with a name, Dataset.from_arrays(columns, name)"
        ) from None


_from_attributes = Dataset.__init__
Dataset.__init__ = functools.wraps(_from_attributes)(_constructed)  # type: ignore[assignment, method-assign]


def dataset_of(log: Any, name: str = "log") -> Dataset:
    """Return one log as a Dataset.

    Args:
        log: a Dataset, a mapping of arrays, a data frame, a structured array or the path of a file.
        name: name of the log in messages.

    Raises:
        UsageError: `log` has no usable form or lacks a column.
    """
    if isinstance(log, Dataset):
        return log
    if isinstance(log, (str, Path)):
        return load_log(log)
    if not _columns_of(log, name):
        raise UsageError(f"{name}: is a {kind_of(log)}; give a Dataset, a mapping of arrays, a data frame or a path")
    return Dataset.from_arrays(log, name)


def _columns_of(log: Any, name: str) -> dict[str, Any] | None:
    """Return the columns of a mapping, a data frame or a structured array by name; None for another type.

    Without a column t, an index of dates or durations, or one named t, is used as the time.

    Raises:
        UsageError: a data frame has a column of a log twice.
    """
    if hasattr(log, "collect_schema") and hasattr(log, "collect"):  # a lazy frame of polars
        log = log.collect()
    if isinstance(log, Mapping):
        coordinates = getattr(log, "coords", {})  # of xarray
        time = {"t": coordinates["t"]} if "t" in coordinates else {}
        return {**time, **{str(key): value for key, value in log.items()}}
    names = getattr(getattr(log, "dtype", None), "names", None)
    if names is None and not isinstance(log, type):
        names = getattr(log, "column_names", getattr(log, "columns", None))
    if names is None:
        return None
    names = list(names)
    plain = _plain_names(names)
    counts = Counter(plain)
    twice = next((each for each, count in counts.items() if count > 1 and is_input(each)), None)
    if twice is not None:
        raise UsageError(f"{name}: column {twice} appears {counts[twice]} times; rename or remove the others")
    index = getattr(log, "index", None)
    is_time = getattr(getattr(index, "dtype", None), "kind", "") in ("M", "m") or getattr(index, "name", None) == "t"
    found = {key: log[each] for key, each in zip(plain, names, strict=True) if counts[key] == 1}
    return {**({"t": index} if is_time else {}), **found}


def _plain_names(names: Sequence[Any]) -> list[str]:
    """Return the names as texts. A name of several levels omits levels that are equal in all names, and an SI unit."""
    if not names or not all(isinstance(name, tuple) for name in names):
        return [str(name) for name in names]
    levels = [level for level in zip(*names, strict=True) if len(set(level)) > 1] or list(zip(*names, strict=True))
    plain = []
    for parts in zip(*levels, strict=True):
        first, *others = [str(part) for part in parts if str(part)] or [""]
        is_unit = first in COLUMNS and others == [COLUMNS[first].unit]
        plain.append(first if is_unit else ".".join([first, *others]))
    return plain


def _numbers(name: str, key: str, value: Any) -> Array | None:
    """Return a column as float64; None if it is not an input of a model and not an array of numbers.

    Masked values become nan. Dates and durations of `t` become seconds since the first one.
    """
    try:
        given = value if isinstance(value, np.ma.MaskedArray) else np.asarray(value)
        if key == "t" and given.ndim == 1:
            given = _seconds(given)
        if given.dtype.kind in "fiubO":
            doubles = given.astype(np.float64)
            filled = doubles.filled(np.nan) if isinstance(doubles, np.ma.MaskedArray) else doubles
            return np.require(filled, np.float64, "C")
    except (TypeError, ValueError, OverflowError):
        pass
    if not is_input(key):
        return None
    raise UsageError(f"{name}: column {key} is no array of numbers{_reason(value)}; give numbers in SI units")


def _seconds(stamps: Any) -> Any:
    """Return dates or durations, of NumPy or as objects, as seconds since the first one, and other values unchanged."""
    if stamps.dtype.kind == "M":
        stamps = stamps.astype("datetime64[ns]")
        stamps = stamps - stamps[~np.isnat(stamps)][:1]
    elif stamps.dtype.kind == "O" and stamps.size and isinstance(stamps[0], (datetime, timedelta)):
        first = stamps[0] if isinstance(stamps[0], datetime) else timedelta()
        return np.array([(stamp - first).total_seconds() for stamp in stamps])
    if stamps.dtype.kind == "m":
        return np.where(np.isnat(stamps), np.nan, stamps.astype("timedelta64[ns]").astype(np.float64) * 1e-9)
    return stamps


def _reason(value: Any) -> str:
    """Return the first value of a column that is not a number, for a message; "" if none is found."""
    for row, each in enumerate(value, start=1) if isinstance(value, (Sequence, np.ndarray)) else ():
        if isinstance(each, (int, float, np.integer, np.floating)):
            continue
        found = repr(str(each)) if isinstance(each, (str, bytes)) else f"a {kind_of(each)}"
        return f" (row {row} is {found:.60})"
    return "" if isinstance(value, (Sequence, np.ndarray)) else f" (it is a {kind_of(value)})"


def load_log(path: str | Path, strict: bool = False, cutoff: float | None = None) -> Dataset:
    """Read a log (CSV, CSV.gz, Parquet or the daemon's MCAP; `run.mcap:AXIS` names one of several axes).

    The log needs t, tau_m and one velocity or angle; `Dataset.require` checks the other columns of a model. Late rows,
    lost samples, duplicate times and gaps are repaired and listed in `notes`. Only the longest piece between gaps is
    returned.

    Args:
        path: the file, with `:AXIS` if it has several axes.
        strict: True to repair only jitter of up to 20 % of the period.
        cutoff: cut-off in Hz of the smoother that derives velocities and accelerations; by default the data set it.

    Raises:
        UsageError: a column is missing, a value is nan, the time runs backwards, the file is empty or damaged, or a
            unit cannot be right; the message names file, column and row.
    """
    return _longest(_datasets(read_table(path, INPUTS), Path(path).name, sha256_of(path), strict, cutoff))


def load_logs(paths: Iterable[str | Path], strict: bool = False, cutoff: float | None = None) -> list[Dataset]:
    """Read logs like `load_log`, but return every piece between gaps; run.csv becomes run.csv#1, run.csv#2.

    Files of one name in different folders are named by their paths.
    """
    paths = list(paths)
    names = [Path(path).name for path in paths]
    return [
        dataset
        for path, name in zip(paths, names, strict=True)
        for dataset in _datasets(
            read_table(path, INPUTS), name if names.count(name) == 1 else str(path), sha256_of(path), strict, cutoff
        )
    ]


def check_distinct(command: str, logs: Sequence[Dataset]) -> None:
    """Raise UsageError if two logs contain the same data or have the same name.

    The same data twice would make every interval too narrow, and whole logs are held out by name.
    """
    seen: dict[tuple[str, float], str] = {}
    for log in logs:
        piece = log.sha256, float(log.columns["t"][0])  # a piece of one file between two gaps
        if log.sha256 and piece in seen:
            raise UsageError(
                f"{command}: {seen[piece]} and {log.name} are the same file; give each log once, and only "
                "the axis that the model describes"
            )
        seen[piece] = log.name
    names = [log.name for log in logs]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise UsageError(f"{command}: two logs are named {doubled[0]}; give each a different name")


def matches(name: str, pattern: str) -> bool:
    """Return True if a command-line pattern matches this dataset; the name of a file matches all its pieces."""
    return fnmatch.fnmatch(name, pattern) or fnmatch.fnmatch(name.partition("#")[0], pattern)


def held_out_logs(names: Sequence[str], pattern: str | None) -> set[str]:
    """Return the names of the held-out logs.

    These are the logs that match `pattern`. Without a pattern, every third log by name is held out if there are at
    least FEWEST_LOGS logs, and none otherwise.

    Raises:
        UsageError: the pattern matches no log, or every log.
    """
    if pattern is None:
        return set(sorted(names)[2::3]) if len(names) >= FEWEST_LOGS else set()
    chosen = {name for name in names if matches(name, pattern)}
    if not chosen:
        raise UsageError(f"--hold-out '{pattern}' matches no log; the logs are {', '.join(names)}")
    if len(chosen) == len(names):
        raise UsageError(f"--hold-out '{pattern}' matches every log; leave at least one to learn from")
    return chosen


def held_out_blocks(count: int, blocks: int, first: int, gap: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the masks of the fitted and of the held-out samples of one log, (count,) each.

    The log is divided into `blocks` blocks, and every third one is held out, starting with number `first`. On either
    side of it, `gap` samples belong to neither mask; `gap` must be less than the length of a block.
    """
    sample = np.arange(count)
    held = sample * blocks // max(count, 1) % 3 == first
    near = held | held[np.maximum(sample - gap, 0)] | held[np.minimum(sample + gap, count - 1)]
    return ~near, held


def _datasets(table: Table, name: str, sha256: str, strict: bool, cutoff: float | None) -> list[Dataset]:
    """Return one dataset for each piece of the table."""
    if cutoff is not None:
        cutoff = number_of(cutoff, f"{name}: cutoff in Hz", 1e-6, 1e6)
    pieces = repair_timestamps(table if strict or table.recorded else _without_bursts(table), strict)
    names = [name] if len(pieces) == 1 else [f"{name}#{number}" for number in range(1, len(pieces) + 1)]
    return [_dataset(piece, own, sha256, strict, cutoff) for piece, own in zip(pieces, names, strict=True)]


def _longest(pieces: list[Dataset]) -> Dataset:
    longest = max(pieces, key=lambda piece: piece.seconds)
    if len(pieces) == 1:
        return longest
    used = f"of them the longest is used, {longest.seconds:.4g} s from t = {longest.columns['t'][0]:.6g} s on"
    return dataclasses.replace(longest, name=longest.name.rpartition("#")[0], read=(*longest.read, used))


def notes_of(logs: Sequence[Dataset]) -> tuple[str, ...]:
    """Return the sentences on repairs and derived columns of all logs, each sentence once."""
    read = dict.fromkeys(note for log in logs for note in log.read)
    return (*read, *in_words(made for log in logs for made in log.motion.made()))


def _dataset(table: Table, name: str, sha256: str, strict: bool, cutoff: float | None) -> Dataset:
    columns = dict(table.columns)
    everything = (*columns, *table.left_out)
    for column in ("t", "tau_m"):
        if column not in columns:
            raise UsageError(_missing(table.label, column, everything))
    if len(table) < FEWEST:
        raise UsageError(f"{table.label}: holds {len(table)} rows; at least {FEWEST} are needed: give a longer log")
    notes = list(table.notes)
    for column in [key for key in columns if key != "t" and is_input(key) and bool(np.isnan(columns[key]).all())]:
        if column == "tau_m":
            raise UsageError(f"{table.label}: column tau_m has no value in any row; log the drive's torque")
        del columns[column]
        notes.append(f"column {column} is empty and taken as absent")
    if not any(column in columns for column in ("omega_j", "q_j", "omega_m", "q_m")):
        raise UsageError(_missing(table.label, "omega_j or q_j", everything))
    if table.recorded:
        table = _recorded(dataclasses.replace(table, columns=columns), notes, strict)
        columns = table.columns
    _check_numbers(table, columns)
    repairs: list[str] = []
    read = columns = without_spikes(table, _unwrapped(columns, notes), NEEDED, repairs)
    for repair in repairs:
        _add_repair(notes, repair, table.label, strict)
    columns, period, jitter = _uniform(table, read, notes, strict)
    notes += check_columns(table.label, columns, period)
    check_sizes(table.label, read, table.place)
    motion = Motion({name: columns[name] for shaft in SHAFTS for name in shaft if name in columns}, period, cutoff)
    derived = motion.derived()
    return Dataset(
        name=name,
        sha256=sha256,
        rate=1.0 / period,
        columns={**columns, **derived},
        motion=motion,
        read=tuple(notes),
        derived=frozenset(derived),
        left_out=table.left_out,
        jitter=jitter,
        label=table.label,
        simulated=table.simulated,
    )


def _without_bursts(table: Table) -> Table:
    """Return the table without bursts of rows that lack a number, so that each burst becomes a gap."""
    inputs = [values for name, values in table.columns.items() if is_input(name) and np.isfinite(values).any()]
    bad = ~np.logical_and.reduce([np.isfinite(values) for values in inputs]) if inputs else np.zeros(0, dtype=bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], bad, [0]])))
    bursts = [(first, end) for first, end in zip(edges[::2], edges[1::2], strict=True) if end - first >= BURST]
    if not bursts or bad.mean() > LEAST_PRESENT or not np.isfinite(table.columns.get("t", np.array([np.nan]))).all():
        return table
    kept = np.ones(len(table), dtype=bool)
    for first, end in bursts:
        kept[first:end] = False
    rows = np.flatnonzero(kept) if table.rows is None else table.rows[kept]
    note = (
        f"{np.count_nonzero(~kept)} rows lack a number, the first from {table.place(int(bursts[0][0]))} on: "
        "they count as holes"
    )
    columns = {name: values[kept] for name, values in table.columns.items()}
    return dataclasses.replace(table, columns=columns, rows=rows, notes=(*table.notes, note))


def _unwrapped(columns: dict[str, Array], notes: list[str]) -> dict[str, Array]:
    """Return the columns after removing jumps of one turn from wrapped angles."""
    out = dict(columns)
    for name in [name for name in columns if name in ("q_j", "q_m") or name.startswith(JOINT_ANGLE)]:
        steps = np.diff(columns[name])
        jumps = np.abs(steps) > TURN / 2.0
        if not jumps.any() or float(np.ptp(columns[name])) > TURN * (1.0 + WRAPS):
            continue
        if np.all(np.abs(np.abs(steps[jumps]) - TURN) < WRAPS * TURN):
            out[name] = np.unwrap(columns[name])
            count = np.count_nonzero(jumps)
            notes.append(f"column {name} is wrapped to one turn: jumps of 2 pi are removed, {count} in all")
    return out


def _missing(label: str, column: str, found: tuple[str, ...]) -> str:
    near = difflib.get_close_matches(column.split(" or ")[0].lower(), [name.lower() for name in found], n=1, cutoff=0.6)
    original = next((name for name in found if near and name.lower() == near[0]), "")
    advice = f"is '{original}' meant? rename it" if original and original not in COLUMNS else "add it"
    if not set(found) & set(COLUMNS):
        advice += "; tsa log import reads the tables of other programs"
    listed = ", ".join(found[:12]) + (", ..." if len(found) > 12 else "")
    return f"{label}: column {column} is missing (found: {listed or 'none'}); {advice}"


def _add_repair(notes: list[str], repair: str, label: str, strict: bool) -> None:
    """Add the sentence on a repair to the notes; raise UsageError with it in strict mode."""
    if strict:
        raise UsageError(f"{label}: {repair}; --strict allows no repair: correct the log, or omit --strict")
    notes.append(repair)


def _recorded(table: Table, notes: list[str], strict: bool) -> Table:
    """Return the longest usable part of a daemon's log.

    Other parts are unusable because devices were silent or the loop was interrupted. Raises UsageError if the longest
    part has fewer than FEWEST rows.
    """
    columns = dict(table.columns)
    present = {name: np.isfinite(values) for name, values in columns.items() if is_input(name)}
    for name in [name for name, good in present.items() if name not in NEEDED and good.mean() < LEAST_PRESENT]:
        notes.append(f"column {name} has a value in only {present.pop(name).mean():.0%} of the rows: taken as absent")
        del columns[name]
    complete = np.logical_and.reduce(list(present.values()))
    if not complete.any():
        return dataclasses.replace(table, columns=columns)  # `_check_numbers` reports the nan with its row
    start = int(np.argmax(complete))
    if start:
        notes.append(f"the first {start} rows, before every device had reported, are left out")
    usable = np.flatnonzero(complete)
    rows = usable[slice(*_longest_piece(columns["t"][usable]))] if len(usable) >= FEWEST else usable
    if len(rows) < FEWEST:
        raise UsageError(
            f"{table.label}: the longest part with a value of every device in each row holds {len(rows)} rows; at "
            f"least {FEWEST} are needed: give a longer log"
        )
    first, end = int(rows[0]), int(rows[-1]) + 1
    if end - first < len(complete) - start:
        gap = (
            f"the daemon stood still, or a device was silent, for more than {1e3 * LONGEST_SKIP:g} ms at least once: "
            f"the longest stretch without is used, {len(complete) - start - (end - first)} rows are left out"
        )
        _add_repair(notes, gap, table.label, strict)
    columns = {name: values[rows] for name, values in columns.items()}
    return dataclasses.replace(table, columns=columns, rows=rows if table.rows is None else table.rows[rows])


def stretches(t: Array) -> list[tuple[int, int]]:
    """Return the start and end indices of the parts of a daemon's log between gaps that must not be interpolated.

    A gap must not be interpolated if it is longer than LONGEST_SKIP. The same applies if it is not a whole number of
    periods, because the clock of the loop was then restarted.
    """
    steps = np.diff(t)
    periods = steps / float(np.median(steps))
    broken = (np.abs(periods - np.rint(periods)) > MOST_JITTER) & (periods > 1.5)
    gaps = np.flatnonzero((steps > LONGEST_SKIP + 1.5 * float(np.median(steps))) | broken) + 1
    edges = [0, *(int(gap) for gap in gaps), len(t)]
    return list(pairwise(edges))


def _longest_piece(t: Array) -> tuple[int, int]:
    return max(stretches(t), key=lambda piece: piece[1] - piece[0])


def _check_numbers(table: Table, columns: Mapping[str, Array]) -> None:
    for name, values in columns.items():
        if not is_input(name):
            continue
        good = np.isfinite(values)
        if not good.all():
            row = int(np.argmin(good))
            found = "no number (empty or nan)" if np.isnan(values[row]) else f"{values[row]}"
            raise UsageError(
                f"{table.label}: column {name}, {table.place(row)}: found {found}; every row needs a finite "
                "number: correct the row or cut the file there"
            )


def _uniform(
    table: Table, columns: dict[str, Array], notes: list[str], strict: bool
) -> tuple[dict[str, Array], float, float]:
    """Return the columns on a uniform grid, its period (s) and the jitter of the file (fraction of the period)."""
    t = columns["t"]
    check_increasing(table, t)
    whole = table.recorded or strict
    grid = fit_grid(t, LONGEST_SKIP if table.recorded else 0.0) if whole else fit_stamps(t)
    check_rate(table.label, grid.typical, float(t[-1] - t[0]), strict)
    if whole and grid.jitter > MOST_JITTER:
        row = grid.worst
        raise UsageError(
            f"{table.label}: column t, {table.place(row)}: a step of {t[row] - t[row - 1]:.6g} s where the "
            f"period is {grid.typical:.6g} s; at most {MOST_JITTER:.0%} off is allowed: cut the file at the hole"
        )
    if grid.skipped:
        share = grid.skipped / (grid.index[-1] + 1)
        lost = "cycles" if table.recorded else "samples"
        cause = "the daemon skipped" if table.recorded else "the file lacks"
        filled = f"{grid.skipped} {lost} ({share:.2%}) that {cause} are filled by straight lines"
        _add_repair(notes, filled, table.label, strict)
    period = f"the period of {grid.period * 1e3:.4g} ms"
    if grid.jitter > MOST_JITTER:
        off = np.abs(np.diff(t) / grid.period - np.diff(grid.index)) > MOST_JITTER
        notes.append(
            f"{np.count_nonzero(off)} of {len(off)} steps of time ({off.mean():.2%}) are off by more than "
            f"{MOST_JITTER:.0%} of {period}, the most at {table.place(grid.worst)} "
            f"({1e3 * (t[grid.worst] - t[grid.worst - 1]):.4g} ms); resampled to a uniform grid"
        )
    elif grid.jitter > UNIFORM:
        notes.append(f"time jitters by {grid.jitter:.1%} of {period}; resampled to a uniform grid")
    if not grid.skipped and grid.jitter <= UNIFORM:
        return columns, grid.period, grid.jitter
    uniform = grid.times[0] + grid.period * np.arange(grid.index[-1] + 1)
    resampled = {name: np.interp(uniform, t, values) for name, values in columns.items() if name != "t"}
    return {"t": uniform, **resampled}, grid.period, grid.jitter
