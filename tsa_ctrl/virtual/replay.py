"""Repeat a virtual run from its log: the head of the log holds all files and the arguments of the run."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

import msgspec
import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.reader import LogFile
from tsa_ctrl.settings import referenced
from tsa_ctrl.virtual.script import Change, Fault

RUN = "run.json"  # in the head of a log: the arguments of a virtual run
MOST_FILES = 200  # that a head may hold


def described(
    controller: Path,
    plant: Path,
    seconds: float,
    seed: int | None,
    faults: Sequence[Fault],
    changes: Sequence[Change],
) -> dict[str, str]:
    """Return the files of the plant, and the arguments of the run as `RUN`, by name."""
    folder = controller.parent
    files = {
        os.path.relpath(plant.parent / name, folder): text for name, text in referenced(plant).items()
    }  # relative to the controller's folder, as the controller's own files
    arguments = Arguments(
        controller=controller.name,
        plant=os.path.relpath(plant, folder),
        seconds=seconds,
        seed=seed,
        faults=tuple(f"{fault.line}@{fault.at!r}" for fault in faults),
        changes=tuple(f"{change.name}={change.value!r}@{change.at!r}" for change in changes),
    )
    return {**files, RUN: msgspec.json.encode(arguments).decode()}


class Arguments(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The arguments of a virtual run: files relative to the controller's folder, the others as of `simulate_loop`."""

    controller: str
    plant: str
    seconds: float
    seed: int | None
    faults: tuple[str, ...]
    changes: tuple[str, ...]


class Replay:
    """The files and arguments of a recorded run, written to a folder.

    Attributes:
        controller: path of the controller file.
        plant: path of the plant file, or None for a log of hardware.
        arguments: of the recorded run, or None for a log of hardware.
    """

    def __init__(self, log: Path, folder: Path) -> None:
        """Write the files of `log` into the empty `folder`; raises UsageError if the log does not hold them."""
        files = LogFile(log).files
        if not files:
            raise UsageError(f"{log}: its head holds no configuration; the log is of an earlier version")
        if len(files) > MOST_FILES:
            raise UsageError(f"{log}: its head holds {len(files)} files; allowed are {MOST_FILES}")
        ups = max((PurePosixPath(name).parts.count("..") for name in files), default=0)
        base = folder.joinpath(*(f"above-{level}" for level in range(ups)))
        for name, text in files.items():
            place = Path(os.path.normpath(base / name))
            if not place.is_relative_to(folder) or PurePosixPath(name).is_absolute():
                raise UsageError(f"{log}: its head names a file outside of its folder: '{name}'; do not trust this log")
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_text(text, encoding="utf-8")
        self.arguments: Arguments | None = None
        self.plant: Path | None = None
        controller = next(iter(files))
        if RUN in files:
            try:
                self.arguments = found = msgspec.json.decode(files[RUN], type=Arguments)
            except msgspec.DecodeError as error:
                raise UsageError(f"{log}: {RUN} in its head is damaged ({error}); give another copy") from None
            if not {found.controller, found.plant} <= files.keys():
                raise UsageError(f"{log}: {RUN} in its head names a file that is not there; give another copy")
            controller, self.plant = found.controller, Path(os.path.normpath(base / found.plant))
        self.controller: Path = base / controller


def first_difference(recorded: Path, columns: dict[str, dict[str, NDArray[np.float64]]]) -> str:
    """Compare the records of a log with a repetition, bit by bit.

    Args:
        recorded: the log; it may lack the first part of its run.
        columns: of the repetition, by axis and column, (n,).

    Returns:
        The first difference in words, or an empty text if all records are equal.
    """
    log = LogFile(recorded)
    for axis in log.axes:
        old = log.columns(axis, log.fields)
        new = columns.get(axis)
        if new is None:
            return f"axis '{axis}' is missing"
        begin = int(np.searchsorted(new["t"], old["t"][0])) if len(old["t"]) else 0
        rows = min(len(old["t"]), len(new["t"]) - begin)
        unequal = {
            name: np.flatnonzero(old[name][:rows].view(np.int64) != new[name][begin:][:rows].view(np.int64))
            for name in log.fields
        }
        first = {name: int(found[0]) for name, found in unequal.items() if len(found)}
        if first:
            name = min(first, key=lambda each: first[each])
            row = first[name]
            values = f"{old[name][row]:.17g}, the repetition has {new[name][begin + row]:.17g}"
            return f"axis '{axis}', {name} at t = {old['t'][row]:.6g} s: {values}"
        if rows < len(old["t"]):
            return f"axis '{axis}': {len(old['t'])} records, the repetition has {rows}"
    return ""
