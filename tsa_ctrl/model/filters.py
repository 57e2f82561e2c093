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
from tsa_ctrl.model.monotonic_segments import MonotonicSegments, dahl


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

    def over(self, x: Array, t: Array) -> Array:
        """Return its value along a log, (n,), for x and t (s), (n,) each; the time steps may differ."""
        if self.kind == "dahl":
            return dahl(MonotonicSegments.of(x), self.constants[0], 0.0)
        from tsa_ctrl.model.effects import kernels  # imported only if needed, because it imports numba, which is slow

        x, t = np.require(x, requirements=["C", "W"]), np.require(t, requirements=["C", "W"])
        return np.asarray(getattr(kernels, self.kind)(x, t, *self.constants))

    def live(self) -> Live:
        """Return the same function for cycle-by-cycle evaluation."""
        if self.kind == "lag":
            return Lag(*self.constants)
        return Ring(*self.constants) if self.kind == "ring" else Dahl(*self.constants)

    def level(self, x: Array, part: float) -> Array:
        """Return a possible value, in the shape of x, for any past within the present range of x.

        `part`: position within the possible values, from -1 (lowest) to 1 (highest).
        """
        if self.kind == "dahl":
            return np.full(np.shape(x), part)
        low, high = float(np.min(x)), float(np.max(x))
        reach = 0.5 * (high - low) * (2.0 if self.kind == "ring" else 1.0)  # a step overshoots to twice itself
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


class _Linear(Live):
    """Evaluate a memory whose value within a step is free + direct x; before the first `keep`, the value is x."""

    __slots__ = ("_direct", "_elapsed", "_free")

    def __init__(self) -> None:
        super().__init__()
        self._elapsed = math.nan
        self._free, self._direct = 0.0, 1.0

    def value(self, x: float) -> float:
        self.asked = x
        return self._free + self._direct * x

    def set(self, state: Sequence[float]) -> None:
        super().set(state)
        self._free, self._direct = 0.0, 1.0


class Lag(_Linear):
    """Evaluate `lag` cycle by cycle; the state is y and the last x."""

    __slots__ = ("_constant", "_decay", "_mean")

    def __init__(self, constant: float) -> None:
        """Prepare the lag; `constant`: T in s."""
        super().__init__()
        self._constant = constant
        self._decay = self._mean = 0.0

    def begin(self, elapsed: float) -> None:
        if not self._state:
            return
        if elapsed != self._elapsed:
            steps = elapsed / self._constant
            self._elapsed, self._decay = elapsed, math.exp(-steps)
            self._mean = -math.expm1(-steps) / steps  # mean of exp(-t/T) over the step
        y, x = self._state
        self._direct = 1.0 - self._mean
        self._free = self._decay * y + (self._mean - self._decay) * x

    def keep(self, x: float) -> None:
        y = self._free + self._direct * x
        if self._state:
            self._state[0], self._state[1] = y, x
        else:
            self._state = [y, x]

    def resting(self, x: float) -> list[float]:
        return [x, x]


class Ring(_Linear):
    """Evaluate `ring` cycle by cycle; the state is y, its derivative, and the last x."""

    __slots__ = ("_damping", "_motion", "_omega", "_turn")

    def __init__(self, frequency: float, damping: float) -> None:
        """Prepare the oscillator; `frequency` in Hz, `damping` in 1."""
        super().__init__()
        self._omega, self._damping = 2.0 * math.pi * frequency, damping
        self._turn = self._omega * math.sqrt(max(1.0 - damping * damping, 0.0))
        self._motion = (0.0, 0.0, 0.0, 0.0)

    def begin(self, elapsed: float) -> None:
        if not self._state:
            return
        if elapsed != self._elapsed:
            self._elapsed = elapsed
            decay = math.exp(-self._damping * self._omega * elapsed)
            turn = self._turn * elapsed
            swing = decay * (math.sin(turn) / self._turn if self._turn > 0.0 else elapsed)
            wave, rub = decay * math.cos(turn), self._damping * self._omega * swing
            self._motion = (wave + rub, swing, -self._omega * self._omega * swing, wave - rub)
        y, rate, x = self._state
        stay, by_rate = self._motion[0], self._motion[1]
        behind = 2.0 * self._damping / self._omega  # s, delay of y behind a ramp
        # y - x + behind*slope oscillates freely; the slope is (x' - x)/elapsed
        by_slope = (-behind + stay * behind - by_rate) / elapsed
        self._direct = 1.0 + by_slope
        self._free = stay * (y - x) + by_rate * rate - by_slope * x

    def keep(self, x: float) -> None:
        if not self._state:
            self._state = self.resting(x)
            return
        y, rate, last = self._state
        slope = (x - last) / self._elapsed
        ahead = y - last + 2.0 * self._damping / self._omega * slope
        state, motion = self._state, self._motion
        state[0] = self._free + self._direct * x
        state[1] = slope + motion[2] * ahead + motion[3] * (rate - slope)
        state[2] = x

    def resting(self, x: float) -> list[float]:
        return [x, 0.0, x]


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
