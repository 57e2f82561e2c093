"""Schedule the events of a simulated run, and repeat a run from its log.

An event is a fault of the plant or a parameter of the controller, each with its time. The header of a log contains all
files and the arguments of the run.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import msgspec
import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc.mailbox import RECOVER, Command, Mailbox
from tsa_ctrl.ipc.parameters import command_of
from tsa_ctrl.ipc.protocol import Description
from tsa_ctrl.log.mcap_file import RUN
from tsa_ctrl.log.reader import LogFile
from tsa_ctrl.plant.faults import FaultKind, nothing, parse_fault
from tsa_ctrl.plant.machine import Machine
from tsa_ctrl.plant.settings import FaultSettings
from tsa_ctrl.settings import referenced
from tsa_ctrl.virtual.lockstep import Wire

RECOVERY = "recover"  # as `tsa set recover 1`


HOST_FAULTS: Mapping[str, FaultKind] = {
    "slow_loop": FaultKind("each cycle of the controller takes this long", lambda target: nothing, 1.5e-3, "s", 0, 10),
}


@dataclass(frozen=True)
class Fault:
    """Define a fault by a line of `tsa plant --ask`, at the time `at` of the log (s); "clear" ends all faults."""

    line: str
    at: float


@dataclass(frozen=True)
class Change:
    """Define a change by a parameter of `tsa set` (PARAMETER or AXIS.PARAMETER), at the time `at` of the log (s)."""

    name: str
    value: float
    at: float


def parse_fault_option(text: str) -> Fault:
    """Parse `LINE@T`; raises UsageError."""
    line, at = _split(text, "--fault", "LINE@T, for example 'torn_tendon@5'")
    return Fault(line, at)


def parse_set_option(text: str) -> Change:
    """Parse `NAME=VALUE@T`; raises UsageError."""
    example = "NAME=VALUE@T, for example compensation=0.5@3"
    assignment, at = _split(text, "--set", example)
    name, equals, value = assignment.partition("=")
    number = _number(value)
    if not equals or not name or number is None:
        raise UsageError(f"--set {text}: is not {example}")
    return Change(name.strip(), number, at)


def _split(text: str, option: str, example: str) -> tuple[str, float]:
    before, at, time = text.rpartition("@")
    seconds = _number(time)
    if not at or not before.strip() or seconds is None or seconds < 0.0:
        raise UsageError(f"{option} {text}: is not {example}; T is the time in s from the first cycle on")
    return before.strip(), seconds


def _number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def beginnings(machine: Machine, faults: Iterable[Fault], wire: Wire) -> list[tuple[Callable[[float], None], float]]:
    """Return the start function and the time (s) of each fault; raises UsageError for an unknown fault."""
    found: list[tuple[Callable[[float], None], float]] = []
    for fault in faults:
        if fault.line == "clear":
            found.append((lambda now: _clear(machine, now), fault.at))
        else:
            try:
                axis, settings = parse_fault(fault.line, HOST_FAULTS)
                host = settings.name in HOST_FAULTS
                begin = _slow_loop(machine, wire, settings) if host else machine.beginning(axis, settings)
            except UsageError as error:
                raise UsageError(f"fault '{fault.line}' at {fault.at:g} s: {error}") from None
            found.append((begin, fault.at + settings.at))
    return found


def _slow_loop(machine: Machine, wire: Wire, settings: FaultSettings) -> Callable[[float], None]:
    """Return a function that makes each cycle of the host take `value` s, for the duration or without end."""
    value = HOST_FAULTS["slow_loop"].value if settings.value is None else settings.value

    def begin(now: float) -> None:
        end = machine.changes.begin(wire.host, "cycle_time", lambda before: value)
        if settings.duration > 0.0:
            wire.at(now + settings.duration, end)

    return begin


def _clear(machine: Machine, now: float) -> None:
    machine.faults.clear(now)


def commands(description: Description, changes: Iterable[Change]) -> list[tuple[Command, float]]:
    """Return the commands for the mailbox with their times; raises UsageError as the socket's server does."""
    found = []
    for change in changes:
        if change.name != RECOVERY:
            found.append((command_of(description, change.name, change.value)[0], change.at))
        elif change.value == 1.0:
            found.append((Command(0, RECOVER, 0.0), change.at))
        else:
            raise UsageError(f"{RECOVERY} {change.value:g}: only 1 is possible, it asks for a new start")
    return found


def put(mailbox: Mailbox, command: Command) -> None:
    """Pass a command to the loop; raises UsageError if its queue is full."""
    if mailbox.put(command) is None:
        raise UsageError("more settings at one time than the loop's queue holds; give them different times")


MOST_FILES = 200  # most files in a header


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
    }  # relative to the controller's folder, like the controller's own files
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
    """Hold the arguments of a virtual run: files relative to the controller's folder, the others of `simulate_loop`."""

    controller: str
    plant: str
    seconds: float
    seed: int | None
    faults: tuple[str, ...]
    changes: tuple[str, ...]


class Replay:
    """Write the files of a recorded run to a folder, and hold its arguments.

    Attributes:
        controller: path of the controller file.
        plant: path of the plant file, or None for a log of hardware.
        arguments: arguments of the recorded run, or None for a log of hardware.
    """

    def __init__(self, log: Path, folder: Path) -> None:
        """Write the files of `log` into the empty `folder`; raises UsageError if the log does not contain them."""
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
        columns: columns of the repetition, by axis and column, (n,).

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
