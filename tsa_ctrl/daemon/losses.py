"""Says it when a bus loses more answers than it should, but not so many that the torque has to end."""

from __future__ import annotations

from collections.abc import Sequence

from tsa_ctrl.control.axis import ControlAxis
from tsa_ctrl.daemon.events import Events

TOLD = 0.05  # of the cycles since the last look: a sound bus loses fewer than one in 10,000
AGAIN = 10.0  # s between two remarks on one axis


class Losses:
    """Compares, about once a second, what each axis missed with the cycles that there were."""

    def __init__(self, axes: Sequence[ControlAxis], events: Events) -> None:
        self._axes = axes
        self._events = events
        self._cycles = 0
        self._missed = [0] * len(axes)
        self._said = [-AGAIN] * len(axes)

    def update(self, t: float, cycles: int) -> None:
        """`t` in s of the log; `cycles` run by now."""
        run, self._cycles = cycles - self._cycles, cycles
        for index, axis in enumerate(self._axes):
            missed = axis.image.missed
            lost, self._missed[index] = missed - self._missed[index], missed
            if lost < TOLD * run or t - self._said[index] < AGAIN or not axis.terms.permitted:
                continue
            self._said[index] = t
            nodes = ", ".join(f"{node} {node.missed}" for node in axis.image.nodes if node.missed)
            self._events.add(
                t,
                axis.name,
                f"{lost} of the last {run} cycles were without all answers (since the start: {nodes}); look at the "
                "cable, the bus load, and collect in [controller]",
            )
