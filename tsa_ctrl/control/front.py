"""How a reversal travels into the sheath: the slip front that starts at the motor, and the stretch that it needs.

Until the motor turns round, each tendon slides one way: its tension falls, or grows, along the bends by exp(-+x). From
the turn on it slides the other way from the motor up to a front, and beyond that is what it was. A front at the share p
of the bending (p x of the friction angle) has changed the motor-side tension by 2 p x T, to first order in x, and has
let the motor move by

    s(p) = 2 x T l/EA S(p),     S(p) = integral over u from 0 to 1 of max(0, p - b(u)),     S(1) = s_c

with b(u) the share of the bending up to the share u of the length (`tsa_ctrl.model.curvature`) and s_c its centre. The
joint feels nothing of it before the front is through, p = 1. Evenly bent S = p^2/2: the first half of the loop costs
the motor a quarter of the way. All at the joint S = p: a plain spring. All at the motor S = 0: no way at all. A series
spring belongs to the length, without bends: at the motor it comes before them all, at the joint after.
"""

from __future__ import annotations

import itertools
from bisect import bisect_right

from tsa_ctrl.model.curvature import Points
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.stretch import profile_of

_STEPS = 64  # of p


class Front:
    """S(p) of a sheath as a table, its inverse, and the moments of the bending seen from the joint."""

    def __init__(self, points: Points, before: float = 0.0, after: float = 0.0) -> None:
        """`points`: (share of the length, share of the bending); `before`, `after`: series springs at motor and joint.

        The springs as lengths of tendon, in lengths of the tendon.
        """
        whole = 1.0 + before + after
        start = [(0.0, 0.0), (before / whole, 0.0)] if before > 0.0 else []
        middle = [((before + u) / whole, b) for u, b in points]
        end = [(1.0, 1.0)] if after > 0.0 else []
        course = start + middle + end
        self.table = tuple(_mean_above(course, i / _STEPS) for i in range(_STEPS + 1))
        self.centre = self.table[-1]  # s_c, 1

    def lengths(self, contacts: int) -> tuple[float, ...]:
        """Return the shares of the length before, between and after so many contacts of equal wrap angle, 1."""
        each = _STEPS // contacts
        before = [contacts * (self.table[each * (i + 1)] - self.table[each * i]) for i in range(contacts)]
        return tuple(after - now for now, after in itertools.pairwise([0.0, *before, 1.0]))

    def depth(self, stretch: float) -> float:
        """p in [0, 1] for S(p) = `stretch`."""
        table = self.table
        if stretch >= table[-1]:
            return 1.0
        if stretch <= 0.0:
            return 0.0
        i = bisect_right(table, stretch) - 1
        return (i + (stretch - table[i]) / (table[i + 1] - table[i])) / _STEPS


def front_of(model: TendonSheath) -> Front:
    """That of a model; evenly bent where it does not say how the sheath bends."""
    points = profile_of(model).points
    spring = model.series_length / model.unstrained_length
    return Front(points, 0.0, spring) if model.series_at_joint else Front(points, spring, 0.0)


def _mean_above(course: list[tuple[float, float]], p: float) -> float:
    """Integral of max(0, p - b) along a course of straight pieces."""
    total = 0.0
    for (u, b), (v, c) in itertools.pairwise(course):
        if v > u and b < p:
            if c <= p:
                total += (v - u) * (p - 0.5 * (b + c))
            else:
                total += 0.5 * (v - u) * (p - b) ** 2 / (c - b)
    return total
