"""Evaluate functions with a memory for formulas, over a log or cycle by cycle.

    lag(x, T)       T dy/dt + y = x
    ring(x, f, d)   y'' + 2 d w y' + w^2 y = w^2 x,  w = 2 pi f
    dahl(x, w)      dz/dx = (1 - sign(dx) z)/w,  -1 <= z <= 1

`lag` and `ring` are exact if x is linear between samples. They start at rest at the first x. `dahl` is exact over each
step of x and starts at 0. Source: the two lags are in any textbook of control; P. R. Dahl, A solid friction model, The
Aerospace Corporation, 1968, with exponent 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tsa_ctrl.model.functions import Array


@dataclass(frozen=True)
class Range:
    """Define one constant of a function with a memory and its range, both ends included."""

    name: str
    low: float
    high: float
    unit: str

    def describe(self) -> str:
        """Return the allowed values as text."""
        return f"{self.low:g} to {self.high:g}{f' {self.unit}' if self.unit else ''}"


# The ranges are wider than those of any drive. With a damping of 1 or more nothing oscillates; a lag suffices.
KINDS: dict[str, tuple[Range, ...]] = {
    "lag": (Range("T", 1e-6, 1e6, "s"),),
    "ring": (Range("f", 1e-3, 1e5, "Hz"), Range("d", 1e-6, 1.0, "")),
    "dahl": (Range("w", 1e-12, 1e12, "in units of x"),),
}


def usage(kind: str) -> str:
    """Return the call of a function as written in a formula, for example "lag(x, T)"."""
    return f"{kind}(x, {', '.join(constant.name for constant in KINDS[kind])})"


@dataclass(frozen=True)
class Memory:
    """Define one function with a memory, with its constants in the order of `KINDS`."""

    kind: str
    constants: tuple[float, ...]

    @property
    def _rings(self) -> bool:
        return self.kind == "ring"

    def over(self, x: Array, t: Array) -> Array:
        """Return its value along a log, (n,), for x and t (s), (n,) each; the time steps may differ."""
        from tsa_ctrl.model.effects import kernels  # imported only if needed, because it imports numba, which is slow

        x = kernels.plain(x)
        if self.kind == "dahl":
            return np.asarray(kernels.dahl(x, self.constants[0], 0.0))
        first, second = (*self.constants, 0.0)[:2]
        return np.asarray(kernels.linear(x, kernels.plain(t), self._rings, first, second))

    def live(self) -> Live:
        """Return the same function for cycle-by-cycle evaluation."""
        if self.kind == "dahl":
            return Dahl(*self.constants)
        return Linear(self._rings, *self.constants)

    def level(self, x: Array, part: float) -> Array:
        """Return a possible value, in the shape of x, for any past within the present range of x.

        `part`: position within the possible values, from -1 (lowest) to 1 (highest).
        """
        if self.kind == "dahl":
            return np.full(np.shape(x), part)
        low, high = float(np.min(x)), float(np.max(x))
        reach = 0.5 * (high - low) * (2.0 if self._rings else 1.0)  # a step overshoots to twice itself
        return np.full(np.shape(x), 0.5 * (low + high) + part * reach)

    def passes(self, level: Array, change: Array, elapsed: float) -> Array:
        """Return its value after x has changed by a small `change` in `elapsed` s, starting from `level`.

        `elapsed`: s; inf for the final value.
        """
        if self.kind == "dahl":
            side = np.sign(change)
            return np.asarray(side + (level - side) * np.exp(-np.abs(change) / self.constants[0]))
        through = 1.0
        if elapsed < math.inf:
            live = self.live()
            live.set(live.resting(0.0))
            live.begin(elapsed)
            through = live.value(1.0)
        return np.asarray(level + through * change)


class Live:
    """Evaluate one memory cycle by cycle: `begin` a step, call `value` as often as necessary, then `keep` one x.

    Attributes: `asked`: the x of the last call of `value`. `taken`: the x that was accepted.
    """

    __slots__ = ("_state", "asked", "taken")

    def __init__(self) -> None:
        self.asked = self.taken = 0.0
        self._state: list[float] = []

    def begin(self, elapsed: float) -> None:
        """Begin a step of `elapsed` s from the kept state."""

    def value(self, x: float) -> float:
        """Return the value at the end of the step for this x, without changing the state."""
        raise NotImplementedError

    def keep(self, x: float) -> None:
        """End the step with this x and store the state."""
        raise NotImplementedError

    def resting(self, x: float) -> list[float]:
        """Return the state at rest at x."""
        raise NotImplementedError

    def get(self) -> list[float]:
        """Return a copy of the state; it is empty before the first `keep`."""
        return self._state.copy()

    def set(self, state: Sequence[float]) -> None:
        """Restore a state."""
        self._state = list(state)


class Linear(Live):
    """Evaluate `lag` or `ring` cycle by cycle; the state is y, its derivative, and the last x.

    The value within a step is free + direct x. Before the first `keep`, the value is x.
    """

    __slots__ = ("_constants", "_direct", "_elapsed", "_free", "_matrix", "_transition")

    def __init__(self, rings: bool, first: float, second: float = 0.0) -> None:
        """Prepare the function; arguments as in `kernels.transition`."""
        from tsa_ctrl.model.effects import kernels  # slow to import; here, because no cycle of a loop may wait for it

        super().__init__()
        self._transition = kernels.transition
        self._constants = rings, first, second
        self._elapsed = math.nan
        self._matrix = (0.0,) * 8
        self._free, self._direct = 0.0, 1.0

    def begin(self, elapsed: float) -> None:
        if not self._state:
            return
        if elapsed != self._elapsed:
            self._elapsed, self._matrix = elapsed, self._transition(*self._constants, elapsed)
        y, rate, x = self._state
        m = self._matrix
        self._free, self._direct = m[0] * y + m[1] * rate + m[2] * x, m[3]

    def value(self, x: float) -> float:
        self.asked = x
        return self._free + self._direct * x

    def keep(self, x: float) -> None:
        if not self._state:
            self._state = self.resting(x)
            return
        y, rate, last = self._state
        m, state = self._matrix, self._state
        state[0] = self._free + self._direct * x
        state[1] = m[4] * y + m[5] * rate + m[6] * last + m[7] * x
        state[2] = x

    def resting(self, x: float) -> list[float]:
        return [x, 0.0, x]

    def set(self, state: Sequence[float]) -> None:
        super().set(state)
        self._free, self._direct = 0.0, 1.0


class Dahl(Live):
    """Evaluate `dahl` cycle by cycle; the state is z and the last x, and time has no influence."""

    __slots__ = ("_width",)

    def __init__(self, width: float) -> None:
        """Prepare the hysteresis; `width` in units of x."""
        super().__init__()
        self._width = width

    def value(self, x: float) -> float:
        self.asked = x
        if not self._state:
            return 0.0
        z, last = self._state
        step = x - last
        if step > 0.0:
            return 1.0 + (z - 1.0) * math.exp(-step / self._width)
        return -1.0 + (z + 1.0) * math.exp(step / self._width) if step < 0.0 else z

    def keep(self, x: float) -> None:
        z = self.value(x)
        if self._state:
            self._state[0], self._state[1] = z, x
        else:
            self._state = [z, x]

    def resting(self, x: float) -> list[float]:
        return [0.0, x]


class Memories:
    """Evaluate the memories of one formula cycle by cycle.

    `begin` first stores the values that the last cycle accepted. Until `accept`, any number of values may be computed.
    A cycle with a value that is not finite accepts nothing, and its time is added to the next cycle.
    """

    __slots__ = ("_accepted", "_since", "parts")

    def __init__(self, memories: Sequence[Memory]) -> None:
        self.parts = tuple(memory.live() for memory in memories)
        self._accepted, self._since = False, 0.0

    def reset(self) -> None:
        """Reset all memories."""
        self._accepted, self._since = False, 0.0
        for part in self.parts:
            part.set(())

    def begin(self, elapsed: float) -> None:
        """Begin a cycle `elapsed` s after the last one."""
        if not self.parts:
            return
        if self._accepted:
            self._accepted, self._since = False, 0.0
            for part in self.parts:
                part.keep(part.taken)
        self._since += elapsed
        for part in self.parts:
            part.begin(self._since)

    def accept(self) -> None:
        """Accept the last values as the values of this cycle."""
        for part in self.parts:
            if not math.isfinite(part.asked):
                return
        for part in self.parts:
            part.taken = part.asked
        self._accepted = True
