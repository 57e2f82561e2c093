"""The monitor in virtual time: the same object as in the process, with its own end of the wire."""

from __future__ import annotations

from tsa_ctrl.daemon.monitor_process import REPEAT, Report
from tsa_ctrl.monitor.findings import Watched
from tsa_ctrl.monitor.watch import Frame, Monitor
from tsa_ctrl.virtual.lockstep import End, Wire

TICK = 1e-3  # s between two checks for missing frames


class VirtualMonitor:
    """Receive every frame of a wire from now on. It acts like the process, unless it is only a witness."""

    def __init__(self, wire: Wire, watched: Watched, acts: bool = True) -> None:
        self.report = Report()
        self.monitor = Monitor(watched)
        self._wire, self._end, self._acts = wire, End(wire), acts
        self._number, self._due, self._open = 0, 0.0, True
        self._told: set[str] = set()
        wire.listeners.append(self._hear)
        wire.at(wire.now, self._tick)

    def fault(self, now: float) -> str | None:
        """Return why there must be no torque."""
        return f"monitor: {self.monitor.stop}" if self.report.stop is not None else None

    def news(self) -> list[str]:
        """Return notices since the last call."""
        new = [str(notice) for name, notice in self.monitor.notices.items() if name not in self._told]
        self._told |= set(self.monitor.notices)
        return new

    def close(self) -> None:
        """Stop receiving."""
        self._open = False
        self._wire.listeners.remove(self._hear)

    def _hear(self, frame: Frame, now: float) -> None:
        self._follow(now, frame)

    def _tick(self, now: float) -> None:
        if self._open:
            self._follow(now, None)
            self._wire.at(now + TICK, self._tick)

    def _follow(self, now: float, frame: Frame | None) -> None:
        monitor = self.monitor
        if monitor.step(frame, now) is None or not self._acts or self.report.confirmed or now < self._due:
            return
        self._due = now + REPEAT
        confirmed = monitor.confirmed
        for can_id, data in monitor.action(0 if confirmed else self._number):
            self._wire.send(self._end, can_id, data)
        self._number += 1
        self.report = Report(monitor.stop, confirmed)
