"""Compare the joint torque errors of two parameter sets by pairs of blocks, with an interval of the difference.

The order of the blocks is A B B A A B B A ..., so that a slow drift (warming, relaxation) affects both sets equally.
Each pair of neighbouring blocks yields one difference of RMS errors. The interval of the mean difference follows from
Student's t distribution with pairs - 1 degrees of freedom.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tsa_ctrl.errors import BusError, TsaError, UsageError
from tsa_ctrl.identify.quantity import Quantity, half_width
from tsa_ctrl.ipc import protocol
from tsa_ctrl.ipc.client import Client
from tsa_ctrl.ipc.parameters import check_bounds
from tsa_ctrl.outputs import json_types

# The comparison sets parameters through the socket of a running daemon, and reads the errors from its status.

SETTLE = 1.0  # s after a change that are not evaluated: parameters change smoothly, and friction must reverse once
FEWEST = 20  # least number of different samples in a block
SLOWEST = 12.0  # s, time-out for a parameter to reach its value; the slowest takes 8 s from bound to bound


class LiveBlocks:
    """The blocks of a comparison on one axis of a running daemon."""

    def __init__(self, client: Client, sets: Mapping[str, Mapping[str, float]], seconds: float) -> None:
        """Prepare the comparison.

        Args:
            client: connection to the daemon.
            sets: values by parameter for "a" and "b", with the parameter names of `tsa set`.
            seconds: duration of a block, s.
        """
        self._client = client
        self._sets = sets
        self._seconds = seconds
        self._before: dict[str, float] = {}
        self.axis = ""

    def check(self) -> None:
        """Raise UsageError if a value is out of bounds or the sets are equal, before anything is changed."""
        if self._sets["a"] == self._sets["b"]:
            raise UsageError("A and B are the same; give two different values to compare")
        axes = self._client.ask(protocol.Status())["axes"]
        for parameter in self._sets["a"]:
            where, _, name = parameter.rpartition(".")
            for axis in axes:
                known = axis["parameters"].get(name)
                if where not in ("", axis["name"]) or known is None or known["low"] is None:
                    continue  # if necessary, the daemon rejects the value and reports the reason
                for values in self._sets.values():
                    check_bounds(parameter, values[parameter], known["low"], known["high"], known["unit"])

    def apply(self, name: str) -> None:
        """Apply one of the two sets, and wait until the values are reached and the motion has settled.

        Raises:
            UsageError: The daemon has not run a cycle, or the parameters belong to several axes.
            BusError: The values were not reached within `SLOWEST`.
        """
        for parameter, value in self._sets[name].items():
            answer = self._client.ask(protocol.Set(parameter, value))
            if answer["before"] is None:
                raise UsageError("the daemon has not run a cycle yet; compare when `tsa status` reports running")
            self._before.setdefault(parameter, float(answer["before"]))
            if self.axis not in ("", answer["axis"]):
                raise UsageError(
                    f"'{parameter}' belongs to axis {answer['axis']}, others to {self.axis}; compare one axis"
                )
            self.axis = str(answer["axis"])
        end = time.monotonic() + SLOWEST
        while not self._arrived(name) and time.monotonic() < end:
            time.sleep(1.0 / protocol.STATUS_RATE)
        if not self._arrived(name):
            raise BusError(f"axis '{self.axis}': {name.upper()} was not reached within {SLOWEST:g} s; see `tsa status`")
        time.sleep(SETTLE)

    def measure(self) -> float:
        """Return the RMS of delivered minus desired joint torque over a block, N*m.

        Raises:
            BusError: The axis is not enabled, or the block has too few different samples.
            UsageError: The axis has no joint torque sensor.
        """
        squares: dict[float, float] = {}
        end = time.monotonic() + self._seconds
        while time.monotonic() < end:
            axis = self._axis()
            if axis["state"] != "operation_enabled":
                raise BusError(f"axis '{self.axis}' is {axis['state']}: the comparison was stopped; see `tsa status`")
            if axis["tau_j"] is None:
                raise UsageError(f"axis '{self.axis}' has no joint torque sensor, so errors cannot be compared")
            squares[axis["t"]] = (axis["tau_j"] - axis["tau_j_des"]) ** 2
            time.sleep(1.0 / protocol.STATUS_RATE)
        if len(squares) < FEWEST:
            raise BusError(f"axis '{self.axis}': only {len(squares)} different samples in a block; is the loop stuck?")
        return math.sqrt(math.fsum(squares.values()) / len(squares))

    def restore(self) -> None:
        """Restore the values from before the first block. Raise BusError with those that were not restored."""
        left = []
        for parameter, value in self._before.items():
            try:
                self._client.ask(protocol.Set(parameter, value))
            except TsaError as error:
                left.append(f"`tsa set {parameter} {value:g}` ({error})")
        if left:
            raise BusError(f"axis '{self.axis}': not all parameters were restored; repeat {', '.join(left)}")

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


FEWEST_PAIRS = 3


@dataclass(frozen=True)
class Comparison:
    """The RMS joint torque errors (N*m) of A and of B, and the mean difference B - A with its 95 % interval."""

    a: float
    b: float
    difference: Quantity
    pairs: int

    @property
    def verdict(self) -> str:
        """Return the result as one sentence, in which "A" and "B" are the two sets."""
        low, high = self.difference.low, self.difference.high
        if low <= 0.0 <= high:
            most = max(abs(low), abs(high))
            return (
                f"no difference found: A {1e3 * self.a:.1f}, B {1e3 * self.b:.1f} mN*m; "
                f"if there is one, it is below {1e3 * most:.1f} mN*m (95 %, {self.pairs} pairs)"
            )
        better, worse = ("A", "B") if low > 0.0 else ("B", "A")
        best, other = (self.a, self.b) if low > 0.0 else (self.b, self.a)
        bounds = sorted((abs(low), abs(high)))
        return (
            f"{better} is better than {worse}: {1e3 * best:.1f} against {1e3 * other:.1f} mN*m, by "
            f"{1e3 * abs(self.difference.value):.1f} mN*m ({1e3 * bounds[0]:.1f} to {1e3 * bounds[1]:.1f}; 95 %, "
            f"{self.pairs} pairs)"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison in JSON types."""
        low, high = self.difference.low, self.difference.high
        better = None if low <= 0.0 <= high else ("a" if low > 0.0 else "b")
        return {
            "schema": 1,
            "rms": {"a": self.a, "b": self.b, "unit": "N*m"},
            "difference": json_types(self.difference),
            "pairs": self.pairs,
            "better": better,
            "verdict": self.verdict,
        }


def order(blocks: int) -> tuple[str, ...]:
    """Return "a" or "b" for each block. The order within the pairs alternates.

    An odd number of `blocks` is rounded up to a whole pair.
    """
    pairs = (blocks + 1) // 2
    return tuple(name for pair in range(pairs) for name in (("a", "b") if pair % 2 == 0 else ("b", "a")))


def compare(errors: Sequence[tuple[str, float]]) -> Comparison:
    """Return the comparison of blocks. `errors` has set and RMS error (N*m) of each block, in the order of `order`."""
    firsts, seconds = errors[0::2], errors[1::2]
    a = [e if name == "a" else f for (name, e), (_, f) in zip(firsts, seconds, strict=True)]
    b = [f if name == "a" else e for (name, e), (_, f) in zip(firsts, seconds, strict=True)]
    difference = np.subtract(b, a)
    pairs = difference.size
    mean = float(np.mean(difference))
    error = float(np.std(difference, ddof=1) / np.sqrt(pairs))
    half = half_width(pairs - 1) * error
    return Comparison(
        a=float(np.sqrt(np.mean(np.square(a)))),
        b=float(np.sqrt(np.mean(np.square(b)))),
        difference=Quantity(mean, mean - half, mean + half, "N*m"),
        pairs=pairs,
    )


def alternate(
    blocks: int, apply: Callable[[str], None], measure: Callable[[], float], tell: Callable[[int, str, float], None]
) -> Comparison:
    """Alternate "a" and "b", and measure and report the RMS error of each block. The caller restores the old values."""
    errors = []
    for number, name in enumerate(order(max(blocks, 2 * FEWEST_PAIRS))):
        apply(name)
        errors.append((name, measure()))
        tell(number, name, errors[-1][1])
    return compare(errors)
