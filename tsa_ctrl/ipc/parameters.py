"""Convert a change of a parameter to a command, or report why the parameter cannot be changed."""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from typing import Any

from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc.mailbox import RECOVER, RELEASE, Command, Mailbox
from tsa_ctrl.ipc.protocol import Description, Range


def change(
    mailbox: Mailbox, description: Description, name: str, value: float, owner: bool = False, now: float = math.inf
) -> tuple[Command, dict[str, Any]]:
    """Return the command of `tsa set NAME VALUE`, and its answer once the loop has taken it.

    The answer's `before` is None until the loop has published its first status.

    Args:
        mailbox: source of the status.
        description: axes and parameters of the run.
        name: PARAMETER or AXIS.PARAMETER.
        value: new value, in the unit of the parameter.
        owner: True if the client's user started the daemon or is root.
        now: monotonic time, s.

    Raises:
        UsageError: the parameter is unknown or cannot be changed to this value now.
    """
    command, number = command_of(description, name, value)
    index = command.axis
    known = description.parameters[index][number]
    general, axes = mailbox.status()
    before = axes[index][1][number] if general.time > 0.0 else None  # unknown until the first cycle
    if command.parameter == RELEASE:
        _check_release(mailbox, index, owner, now)
    elif known.restores and before is not None and value > before:
        raise UsageError(
            f"{known.name} {value:g} is above {before:g}; it can be lowered, or released by {known.high:g}"
        )
    answer = {"axis": description.axes[index], "name": known.name, "unit": known.unit}
    return command, {**answer, "before": before, "value": value}


def command_of(description: Description, name: str, value: float) -> tuple[Command, int]:
    """Return the command of `tsa set NAME VALUE`, whatever the state of the loop, and the number of the parameter.

    Raises:
        UsageError: the axis or the parameter is unknown, or the value is out of its bounds.
    """
    axis, dot, parameter = name.rpartition(".")
    if not dot and len(description.axes) > 1:
        raise UsageError(f"'{name}': give the axis: {', '.join(f'{axis}.{name}' for axis in description.axes)}")
    index = axis_index(description, axis) if dot else 0
    number = parameter_number(description.parameters[index], parameter, value)
    known = description.parameters[index][number]
    release = known.restores and value == known.high
    return Command(index, RELEASE if release else number, value), number


def parameter_number(ranges: Sequence[Range], name: str, value: float) -> int:
    """Return the number of a parameter of an axis; raise UsageError unless it can be changed to `value`."""
    names = [known.name for known in ranges]
    if name not in names:
        near = difflib.get_close_matches(name, names, n=1)
        advice = f"did you mean '{near[0]}'?" if near else f"available: {', '.join(names)}"
        raise UsageError(f"no parameter '{name}'; {advice}")
    known = ranges[names.index(name)]
    if known.low is None or known.high is None:
        raise UsageError(f"'{name}' cannot be set on this axis: {known.doc}")
    check_bounds(name, value, known.low, known.high, known.unit)
    return names.index(name)


def _check_release(mailbox: Mailbox, axis: int, owner: bool, now: float) -> None:
    """Raise UsageError unless this client may release the latch of an axis' guard now."""
    if not owner:
        raise UsageError("back_off: only root and the user who started the daemon may release the guard's latch")
    if not mailbox.status()[1][axis][0].guard_latched:
        raise UsageError("back_off: the guard is not latched; it restores the compensation without a request")
    check_budget(mailbox, "back_off", now)


def check_budget(mailbox: Mailbox, what: str, now: float) -> None:
    """Raise UsageError unless the next release of a latch is permitted at `now` (s, monotonic)."""
    general = mailbox.status()[0]
    if now < general.release_next:
        raise UsageError(
            f"{what}: {general.releases:.0f} releases were made; the next one is permitted in "
            f"{general.release_next - now:.3g} s; find the cause of the fault first"
        )


def recovery(mailbox: Mailbox, description: Description, now: float) -> Command:
    """Return the command of a recovery; raise UsageError unless a fault is latched and the budget permits one."""
    _, cycle, code, _ = mailbox.measured()  # newer than the status
    phase = description.phases[code if cycle else int(mailbox.status()[0].phase)]
    if phase != "faulted":
        raise UsageError(f"recover: no fault is latched, the phase is {phase}; nothing to do")
    check_budget(mailbox, "recover", now)
    return Command(0, RECOVER, 0.0)


def axis_index(description: Description, name: str) -> int:
    """Return the index of an axis; raise UsageError for an unknown axis."""
    try:
        return description.axes.index(name)
    except ValueError:
        raise UsageError(f"no axis '{name}'; available: {', '.join(description.axes)}") from None


def check_bounds(name: str, value: float, low: float, high: float, unit: str) -> None:
    """Raise UsageError unless `low` <= `value` <= `high`."""
    if not low <= value <= high:
        of = of_unit(unit)
        raise UsageError(f"{name} {value:g}{of} is out of bounds; allowed is {low:g} to {high:g}{of}")


def clamped(value: float, limit: float) -> float:
    """Return a set-point clamped to -`limit` to `limit`, N*m; raise UsageError unless it is finite."""
    if not math.isfinite(value):
        raise UsageError(f"set-point {value} N*m is not a finite number; allowed is {-limit:g} to {limit:g} N*m")
    return min(max(value, -limit), limit)


def of_unit(unit: str) -> str:
    """Return the suffix of a number: a space and its unit, or nothing for the unit "1"."""
    return "" if unit == "1" else f" {unit}"
