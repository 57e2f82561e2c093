"""Which of two parameter sets follows the wanted joint torque better: alternating blocks, paired, with an interval.

Blocks go A B B A A B B A ..., so that a slow drift (warming, relaxation) meets both alike. Each neighbouring pair gives
one difference of the blocks' RMS errors; their mean has Student's t interval with pairs - 1 degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.outputs import json_types

FEWEST_PAIRS = 3


@dataclass(frozen=True)
class Comparison:
    """RMS joint torque error (N*m) of A and of B, and the mean difference B - A with its 95 % interval."""

    a: float
    b: float
    difference: Quantity
    pairs: int

    @property
    def verdict(self) -> str:
        """In words, for people; "A" and "B" are the two sets."""
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
        """JSON-ready."""
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
    """ "a" or "b" of each block, in pairs that alternate which comes first; `blocks` is rounded up to whole pairs."""
    pairs = (blocks + 1) // 2
    return tuple(name for pair in range(pairs) for name in (("a", "b") if pair % 2 == 0 else ("b", "a")))


def compare(errors: Sequence[tuple[str, float]]) -> Comparison:
    """From (set, RMS error) of blocks in the order of `order`."""
    firsts, seconds = errors[0::2], errors[1::2]
    a = [e if name == "a" else f for (name, e), (_, f) in zip(firsts, seconds, strict=True)]
    b = [f if name == "a" else e for (name, e), (_, f) in zip(firsts, seconds, strict=True)]
    difference = np.subtract(b, a)
    pairs = difference.size
    mean = float(np.mean(difference))
    error = float(np.std(difference, ddof=1) / np.sqrt(pairs))
    half = float(stats.t.ppf(0.975, pairs - 1)) * error
    return Comparison(
        a=float(np.sqrt(np.mean(np.square(a)))),
        b=float(np.sqrt(np.mean(np.square(b)))),
        difference=Quantity(mean, mean - half, mean + half, "N*m"),
        pairs=pairs,
    )


def alternate(
    blocks: int, apply: Callable[[str], None], measure: Callable[[], float], tell: Callable[[int, str, float], None]
) -> Comparison:
    """Apply "a" or "b", measure the RMS error of the block, tell it, and so on; the caller restores what was before."""
    errors = []
    for number, name in enumerate(order(max(blocks, 2 * FEWEST_PAIRS))):
        apply(name)
        errors.append((name, measure()))
        tell(number, name, errors[-1][1])
    return compare(errors)
