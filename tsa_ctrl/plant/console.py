"""The commands that a running simulated machine takes: faults, and a look at its state."""

from __future__ import annotations

import json

from tsa_ctrl.errors import UsageError
from tsa_ctrl.plant.channel import ControlSocket
from tsa_ctrl.plant.faults import CHANGES, FAULTS, parse_fault
from tsa_ctrl.plant.machine import Machine

KINDS = {**FAULTS, **CHANGES}
HELP = "NAME [axis=AXIS] [node=drive|encoder|torque_sensor] [value=NUMBER] [duration=SECONDS] [at=SECONDS]"


class Console:
    """Answers `ok CLOCK` (CLOCK_MONOTONIC in s, when it was done), `error: ...`, or what was asked."""

    def __init__(self, machine: Machine, channel: ControlSocket) -> None:
        self._machine = machine
        self._channel = channel
        self._now = 0.0

    def poll(self, now: float) -> None:
        self._now = now
        self._channel.poll(self.answer)

    def answer(self, line: str) -> str:
        """One command: a fault, `clear` (all faults end), `state` (JSON), `list` or `help`."""
        if line in ("", "help"):
            return f"{HELP}; or clear, state, list"
        if line == "list":
            return "\n".join(f"{name}: {kind.doc}{_value(name)}" for name, kind in KINDS.items())
        if line == "state":
            return self._state()
        if line == "clear":
            return f"ok {self._now:.6f} {self._machine.faults.clear(self._now)} ended"
        try:
            axis, fault = parse_fault(line)
            self._machine.begin_fault(axis, fault, self._now)
        except UsageError as error:
            return f"error: {error}"
        return f"ok {self._now:.6f}"

    def _state(self) -> str:
        axes = [
            {
                "name": unit.axis.name,
                "power": unit.drive.machine.state.name.lower(),
                "nmt": {kind: node.state.name.lower() for kind, node in unit.by_kind.items()},
                **unit.axis.values(),
            }
            for unit in self._machine.axes
        ]
        return json.dumps({"clock": self._now, "faults": self._machine.faults.active, "axes": axes})

    def close(self) -> None:
        self._channel.close()


def _value(name: str) -> str:
    kind = KINDS[name]
    return f" (value: {kind.unit}, default {kind.value:g})" if kind.unit else ""
