"""Reports a bus that loses answers or commands, and a loop that skips periods, before either ends the torque."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tsa_ctrl.control.axis import ControlAxis
from tsa_ctrl.daemon.events import Events
from tsa_ctrl.safety.leaky import SECOND
from tsa_ctrl.system.realtime import SKIPPED_SHARE, Overruns

TOLD = 0.05  # of the cycles since the last look: a sound bus loses fewer than one in 10,000
AGAIN = 10.0  # s between two remarks on one axis
LEAST = 2  # commands that a drive did not hear; one may be lost with an error


class Losses:
    """Compares, about once a second, what each axis missed with the cycles that there were."""

    def __init__(self, axes: Sequence[ControlAxis], events: Events, overruns: Overruns) -> None:
        self._axes = axes
        self._events = events
        self._overruns = overruns
        self._looked = -math.inf  # s, monotonic
        self._reported = -AGAIN
        self._cycles = 0
        self._missed = [0] * len(axes)
        self._heard = [(0, 0)] * len(axes)
        self._said = [-AGAIN] * len(axes)
        self._said_unheard = [-AGAIN] * len(axes)

    def update(self, t: float, cycles: int) -> None:
        """`t` in s of the log; `cycles` run by now."""
        run, self._cycles = cycles - self._cycles, cycles
        for index, axis in enumerate(self._axes):
            self._hear(t, index, axis)
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

    def update_skipped(self, t: float, now: float, rate: float) -> None:
        """Report, about once a second, a loop that skipped at least `SKIPPED_SHARE` of the periods of a second.

        Args:
            t: time of the log, s.
            now: monotonic time, s.
            rate: of the loop, Hz.
        """
        if now - self._looked < SECOND:
            return
        skipped, begin = self._overruns.worst_second(self._looked)
        self._looked = now
        if skipped and skipped >= SKIPPED_SHARE * rate and t - self._reported >= AGAIN:
            self._reported = t
            planned = round(rate * SECOND)
            remedy = self._overruns.remedy(begin, planned)
            self._events.add(t, "", f"{skipped} of {planned} periods within a second had no cycle: {remedy}")

    def _hear(self, t: float, index: int, axis: ControlAxis) -> None:
        """What the drive heard of its commands."""
        hearing = axis.io.hearing
        before, self._heard[index] = self._heard[index], (hearing.asked, hearing.unheard)
        asked, unheard = hearing.asked - before[0], hearing.unheard - before[1]
        if unheard < max(LEAST, TOLD * asked) or t - self._said_unheard[index] < AGAIN or not axis.terms.permitted:
            return
        self._said_unheard[index] = t
        self._events.add(
            t,
            axis.name,
            f"{axis.image.nodes[0]} held an older command {unheard} of the last {asked} times that 0x6071 was read "
            "back: commands are lost; look at the cable, the bus load, and the drive's cycle",
        )
