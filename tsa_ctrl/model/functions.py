"""Provide the functions of the model's formulas, once for arrays (logs) and once for plain floats (the control loop).

Every formula of the model is written once, generic in `F`, and receives `ARRAYS` or `SCALARS`. For single numbers,
numpy takes ten times as long as `math`, which is too slow for a loop at 1 kHz.
"""

from __future__ import annotations

import math
from typing import Protocol, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]
F = TypeVar("F", float, Array)
LARGEST = 700.0  # exp(709.8) is the largest double; beyond it results saturate instead of overflowing
BLOCK = 8192  # samples processed at a time, so that temporary arrays stay in the cache: a third of the time


class Functions(Protocol[F]):
    """Define elementwise functions of numbers of type `F`."""

    def exp(self, x: F, /) -> F: ...
    def expm1(self, x: F, /) -> F: ...
    def sin(self, x: F, /) -> F: ...
    def log10(self, x: F, /) -> F: ...
    def sign(self, x: F, /) -> F: ...
    def power(self, x: F, y: float, /) -> F: ...
    def at_least(self, x: F, low: float, /) -> F: ...
    def expm1_ratio(self, x: F, /) -> F: ...


class _Arrays:
    """Implement `Functions` for numpy arrays; results may be 0-dimensional."""

    def exp(self, x: Array, /) -> Array:
        return np.asarray(np.exp(x))

    def expm1(self, x: Array, /) -> Array:
        return np.asarray(np.expm1(x))

    def sin(self, x: Array, /) -> Array:
        return np.asarray(np.sin(x))

    def log10(self, x: Array, /) -> Array:
        return np.asarray(np.log10(x))

    def sign(self, x: Array, /) -> Array:
        return np.asarray(np.sign(x))

    def power(self, x: Array, y: float, /) -> Array:
        return np.asarray(x**y)

    def at_least(self, x: Array, low: float, /) -> Array:
        return np.maximum(x, low)

    def expm1_ratio(self, x: Array, /) -> Array:
        """Return (exp(x) - 1)/x, 1 at x = 0."""
        safe = np.where(x == 0.0, 1.0, x)
        return np.where(x == 0.0, 1.0, np.expm1(safe) / safe)


class _Scalars:
    """Implement `Functions` for plain floats; results saturate instead of raising OverflowError."""

    def exp(self, x: float, /) -> float:
        return math.exp(x if x < LARGEST else LARGEST)

    def expm1(self, x: float, /) -> float:
        return math.expm1(x if x < LARGEST else LARGEST)

    def sin(self, x: float, /) -> float:
        return math.sin(x) if math.isfinite(x) else math.nan

    def log10(self, x: float, /) -> float:
        return math.log10(x)

    def sign(self, x: float, /) -> float:
        return 1.0 if x > 0.0 else -1.0 if x < 0.0 else 0.0

    def power(self, x: float, y: float, /) -> float:
        try:
            return float(x**y)
        except OverflowError:
            return math.inf

    def at_least(self, x: float, low: float, /) -> float:
        return low if x < low else x  # nan stays nan, because a missing value must not become a number

    def expm1_ratio(self, x: float, /) -> float:
        """Return (exp(x) - 1)/x, 1 at x = 0."""
        return 1.0 if x == 0.0 else self.expm1(x) / x


ARRAYS: Functions[Array] = _Arrays()
SCALARS: Functions[float] = _Scalars()
