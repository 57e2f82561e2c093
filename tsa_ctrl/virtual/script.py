"""Define the events of a simulated run: faults of the plant and parameters of the controller, each at its time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from tsa_ctrl.control.live_parameters import Tuner
from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc.mailbox import RECOVER, RELEASE, Command, Mailbox
from tsa_ctrl.plant.fault_kind import FaultKind, nothing
from tsa_ctrl.plant.faults import parse_fault
from tsa_ctrl.plant.machine import Machine
from tsa_ctrl.plant.settings import FaultSettings
from tsa_ctrl.virtual.lockstep import Wire

RECOVERY = "recover"  # as `tsa set recover 1`


HOST_FAULTS: Mapping[str, FaultKind] = {
    "slow_loop": FaultKind("each cycle of the controller takes this long", lambda target: nothing, 1.5e-3, "s", 0, 10),
}


@dataclass(frozen=True)
class Fault:
    """A line as `tsa plant --ask` takes it, `at` s of the log's time; "clear" ends all faults."""

    line: str
    at: float


@dataclass(frozen=True)
class Change:
    """A parameter as `tsa set` takes it (PARAMETER or AXIS.PARAMETER), `at` s of the log's time."""

    name: str
    value: float
    at: float


def parse_fault_option(text: str) -> Fault:
    """`LINE@T`; raises UsageError."""
    line, at = _split(text, "--fault", "LINE@T, for example 'torn_tendon@5'")
    return Fault(line, at)


def parse_set_option(text: str) -> Change:
    """`NAME=VALUE@T`; raises UsageError."""
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
    """Return what begins each fault, and when; raise UsageError for a fault that neither plant nor host has."""
    found: list[tuple[Callable[[float], None], float]] = []
    for fault in faults:
        if fault.line == "clear":
            found.append((lambda now: _clear(machine, now), fault.at))
        else:
            try:
                axis, settings = parse_fault(fault.line, HOST_FAULTS)
                host = settings.name in HOST_FAULTS
                begin = _slow_loop(wire, settings) if host else machine.beginning(axis, settings)
            except UsageError as error:
                raise UsageError(f"fault '{fault.line}' at {fault.at:g} s: {error}") from None
            found.append((begin, fault.at + settings.at))
    return found


def _slow_loop(wire: Wire, settings: FaultSettings) -> Callable[[float], None]:
    """Return what makes each cycle of the host take `value` s, for the duration if there is one."""
    value = HOST_FAULTS["slow_loop"].value if settings.value is None else settings.value

    def end(now: float) -> None:
        wire.host.cycle_time = 0.0

    def begin(now: float) -> None:
        wire.host.cycle_time = value
        if settings.duration > 0.0:
            wire.at(now + settings.duration, end)

    return begin


def _clear(machine: Machine, now: float) -> None:
    machine.faults.clear(now)


def commands(axes: Sequence[str], tuners: Sequence[Tuner], changes: Iterable[Change]) -> list[tuple[Command, float]]:
    """Return the commands for the mailbox with their times; raises UsageError as the socket's server does."""
    found = []
    for change in changes:
        if change.name == RECOVERY:
            if change.value != 1.0:
                raise UsageError(f"{RECOVERY} {change.value:g}: only 1 is possible, it asks for a new start")
            found.append((Command(0, RECOVER, 0.0), change.at))
            continue
        axis, dot, name = change.name.rpartition(".")
        if not dot and len(axes) > 1:
            raise UsageError(f"'{name}': name the axis: {', '.join(f'{axis}.{name}' for axis in axes)}")
        if dot and axis not in axes:
            raise UsageError(f"no axis '{axis}'; known are {', '.join(axes)}")
        place = axes.index(axis) if dot else 0
        parameters = tuners[place].parameters
        number = next((n for n, parameter in enumerate(parameters) if parameter.name == name), None)
        if number is None:
            raise UsageError(f"no parameter '{name}'; known are {', '.join(p.name for p in parameters)}")
        known = parameters[number]
        if known.low is None or known.high is None:
            raise UsageError(f"'{name}' cannot be set on this axis: {known.doc}")
        if not known.low <= change.value <= known.high:
            raise UsageError(
                f"{name} {change.value:g} {known.unit} is out of bounds; "
                f"allowed is {known.low:g} to {known.high:g} {known.unit}"
            )
        release = known.restores and change.value == known.high
        found.append((Command(place, RELEASE if release else number, change.value), change.at))
    return found


def put(mailbox: Mailbox, command: Command) -> None:
    """Hand a command to the loop; its queue has room for all that one script can mean at one time."""
    if mailbox.put(command) is None:
        raise UsageError("more settings at one time than the loop's queue holds; give them different times")
