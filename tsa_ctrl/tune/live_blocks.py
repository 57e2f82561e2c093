"""Blocks of a running daemon for a comparison: parameters through its socket, errors from its status."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.ipc import protocol
from tsa_ctrl.ipc.client import Client

POLL = 0.02  # s between looks at the status, which the loop publishes at 50 Hz
SETTLE = 1.0  # s after a change that do not count: parameters move smoothly, and friction has to turn once
FEWEST = 20  # different samples of a block
SLOWEST = 12.0  # s for a parameter to arrive; the slowest takes 8 from bound to bound


class LiveBlocks:
    """Sets parameters of one axis of a running daemon, measures its error, and puts everything back."""

    def __init__(self, client: Client, sets: Mapping[str, Mapping[str, float]], seconds: float) -> None:
        """`sets`: "a" and "b", each parameter (as `tsa set` names it) -> value; `seconds` of a block."""
        self._client = client
        self._sets = sets
        self._seconds = seconds
        self._before: dict[str, float] = {}
        self.axis = ""

    def check(self) -> None:
        """Refuse values out of bounds, and sets that are the same, before anything moves; raises UsageError."""
        if self._sets["a"] == self._sets["b"]:
            raise UsageError("A and B are the same; give two different values to compare")
        axes = self._client.ask(protocol.Status())["axes"]
        for parameter in self._sets["a"]:
            where, _, name = parameter.rpartition(".")
            for axis in axes:
                known = axis["parameters"].get(name)
                if where not in ("", axis["name"]) or known is None or known["low"] is None:
                    continue  # the daemon says why it refuses
                for values in self._sets.values():
                    if not known["low"] <= values[parameter] <= known["high"]:
                        raise UsageError(
                            f"{parameter} {values[parameter]:g} {known['unit']} is out of bounds; allowed is "
                            f"{known['low']:g} to {known['high']:g} {known['unit']}"
                        )

    def apply(self, name: str) -> None:
        """Set one of the two sets, and wait until it has arrived and settled; raises UsageError, BusError."""
        for parameter, value in self._sets[name].items():
            answer = self._client.ask(protocol.Set(parameter, value))
            self._before.setdefault(parameter, float(answer["before"]))
            if self.axis not in ("", answer["axis"]):
                raise UsageError(f"'{parameter}' is of axis {answer['axis']}, others of {self.axis}; compare one axis")
            self.axis = str(answer["axis"])
        end = time.monotonic() + SLOWEST
        while not self._arrived(name) and time.monotonic() < end:
            time.sleep(POLL)
        if not self._arrived(name):
            raise BusError(f"axis '{self.axis}': {name.upper()} has not arrived within {SLOWEST:g} s; see `tsa status`")
        time.sleep(SETTLE)

    def measure(self) -> float:
        """RMS of delivered minus wanted joint torque over a block, N*m; raises BusError when the torque stops."""
        squares: dict[float, float] = {}
        end = time.monotonic() + self._seconds
        while time.monotonic() < end:
            axis = self._axis()
            if axis["state"] != "operation_enabled":
                raise BusError(f"axis '{self.axis}' is {axis['state']}: the comparison ends; see `tsa status`")
            if axis["tau_j"] is None:
                raise UsageError(f"axis '{self.axis}' has no joint torque sensor, so errors cannot be compared")
            squares[axis["t"]] = (axis["tau_j"] - axis["tau_j_des"]) ** 2
            time.sleep(POLL)
        if len(squares) < FEWEST:
            raise BusError(
                f"axis '{self.axis}': only {len(squares)} different samples in a block; is the loop hanging?"
            )
        return math.sqrt(math.fsum(squares.values()) / len(squares))

    def restore(self) -> None:
        """Put back what was set before the first block."""
        for parameter, value in self._before.items():
            self._client.ask(protocol.Set(parameter, value))

    def _arrived(self, name: str) -> bool:
        values = self._axis()["parameters"]
        return all(
            math.isclose(values[parameter.rpartition(".")[2]]["value"], value, rel_tol=1e-6, abs_tol=1e-9)
            for parameter, value in self._sets[name].items()
        )

    def _axis(self) -> dict[str, Any]:
        status = self._client.ask(protocol.Status())
        found: dict[str, Any] = next(axis for axis in status["axes"] if axis["name"] == self.axis)
        return found
