"""A parameter by its name: which command moves it, or why nothing does."""

from __future__ import annotations

import difflib
from typing import Any

from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc.mailbox import Command, Mailbox
from tsa_ctrl.ipc.protocol import Description


def change(mailbox: Mailbox, description: Description, name: str, value: float) -> tuple[Command, dict[str, Any]]:
    """What `tsa set NAME VALUE` means, and its answer once the loop has taken it; raises UsageError."""
    axis, dot, parameter = name.rpartition(".")
    if not dot and len(description.axes) > 1:
        raise UsageError(f"'{name}': say of which axis: {', '.join(f'{axis}.{name}' for axis in description.axes)}")
    index = axis_index(description, axis) if dot else 0
    ranges = description.parameters[index]
    for number, known in enumerate(ranges):
        if known.name == parameter:
            if known.low is None or known.high is None:
                raise UsageError(
                    f"'{parameter}' cannot be set with this axis' estimator; see estimator.kind ({known.doc})"
                )
            check_bounds(parameter, value, known.low, known.high, known.unit)
            before = mailbox.status()[1][index][1][number]
            answer = {"axis": description.axes[index], "name": parameter, "unit": known.unit}
            return Command(index, number, value), {**answer, "before": before, "value": value}
    names = [known.name for known in ranges]
    near = difflib.get_close_matches(parameter, names, n=1)
    advice = f"did you mean '{near[0]}'?" if near else f"known are {', '.join(names)}"
    raise UsageError(f"no parameter '{parameter}'; {advice}")


def axis_index(description: Description, name: str) -> int:
    """The place of an axis; raises UsageError."""
    try:
        return description.axes.index(name)
    except ValueError:
        raise UsageError(f"no axis '{name}'; known are {', '.join(description.axes)}") from None


def check_bounds(name: str, value: float, low: float, high: float, unit: str) -> None:
    """Raises UsageError unless the value lies between them."""
    if not low <= value <= high:
        of = of_unit(unit)
        raise UsageError(f"{name} {value:g}{of} is out of bounds; allowed is {low:g} to {high:g}{of}")


def of_unit(unit: str) -> str:
    """What stands behind a number: a space and its unit; nothing where it is a pure number ("1" in the tables)."""
    return "" if unit == "1" else f" {unit}"
