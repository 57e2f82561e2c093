"""Define the curvature profile of a sheath, and its elongation integrals alpha and beta, (3.36) and (3.39).

    Theta(s) = integral of the curvature from the motor end, s = 0, to s;     b(u) = Theta(u l_us) / Theta
    alpha / l_us = A(+x),     beta / l_us = A(-x),     A(rho) = integral over u from 0 to 1 of exp(rho b(u))

x = sigma mu Theta, signed. b is a line through points: horizontal where the sheath is straight, vertical at a sharp
bend.
Source: section 3.2, (3.31)-(3.39); figure 3-19.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import TypeAlias

from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.functions import F, Functions

Points: TypeAlias = tuple[tuple[float, float], ...]  # (fraction of the length, fraction of the bending)

NAMED: Mapping[str, Points] = MappingProxyType(
    {
        "uniform": ((0.0, 0.0), (1.0, 1.0)),  # the same curvature everywhere
        "motor_end": ((0.0, 1.0), (1.0, 1.0)),  # all bending at s = 0: the extreme of figure 3-19
        "joint_end": ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0)),  # all bending at s = l_us: (3.55) is exact
    }
)
POINTS = "[[fraction of length, fraction of bending], ...] that never decrease, from [0, ...] to [1, 1]"


@dataclass(frozen=True)
class Profile:
    """Hold the curvature profile of a sheath as points that never decrease, from (0, .) to (1, 1)."""

    points: Points

    @classmethod
    def of(cls, chosen: str | Points) -> Profile:
        """Return the profile of a name ("uniform", "motor_end", "joint_end") or of checked points."""
        return cls(NAMED[chosen] if isinstance(chosen, str) else chosen)

    @cached_property
    def _pieces(self) -> tuple[tuple[float, float, float], ...]:
        """Return (width, b at its start, rise of b) of each piece of the length, without vertical pieces."""
        pairs = itertools.pairwise(self.points)
        return tuple((end[0] - start[0], start[1], end[1] - start[1]) for start, end in pairs if end[0] > start[0])

    def mean_exponential(self, functions: Functions[F], rho: F) -> F:
        """Return A(rho): alpha/l_us at rho = x, beta/l_us at rho = -x."""
        total = 0.0 * rho  # zeros in the shape of rho
        for width, start, rise in self._pieces:
            part = width if start == 0.0 else width * functions.exp(rho * start)
            total = total + (part if rise == 0.0 else part * functions.expm1_ratio(rho * rise))
        return total

    def elongations(self, functions: Functions[F], x: F) -> tuple[F, F]:
        """Return alpha and beta over l_us at the signed friction angle x, (3.36) and (3.39)."""
        return self.mean_exponential(functions, x), self.mean_exponential(functions, -x)

    @cached_property
    def centre(self) -> float:
        """Return s_c, 1: centre of the bending as a fraction of the length from the motor end; 1/2 if uniform."""
        return 1.0 - sum(width * (start + 0.5 * rise) for width, start, rise in self._pieces)


def centred(profile: Profile, centre: float) -> Profile:
    """Return the profile compressed towards the motor or the joint, so that its centre is `centre`, from 0 to 1.

    A profile with all bends at one end has no width to be compressed. An even bend is compressed in its place.
    """
    if abs(centre - profile.centre) < 1e-9:
        return profile
    if min(profile.centre, 1.0 - profile.centre) < 1e-9:
        profile = Profile.of("uniform")
    now = profile.centre
    if centre < now:
        share = centre / now
        return Profile((*((share * u, b) for u, b in profile.points), (1.0, 1.0)))
    share = (1.0 - centre) / (1.0 - now)
    straight = ((0.0, 0.0),) if profile.points[0][1] == 0.0 else ((0.0, 0.0), (1.0 - share, 0.0))
    return Profile((*straight, *((1.0 - share * (1.0 - u), b) for u, b in profile.points)))


def course_of(given: Points, where: str) -> Profile:
    """Return the profile of [sheath] bending_course; raises UsageError if it is invalid."""
    points = as_points(given)
    if points is None:
        raise UsageError(f"{where}: [sheath] bending_course is {[list(pair) for pair in given]}; give {POINTS}")
    return Profile(points)


def as_points(value: object) -> Points | None:
    """Return a list of pairs as points, or None if it is not a curvature profile."""
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) < 2:
        return None
    points = []
    for pair in value:
        if not isinstance(pair, Sequence) or isinstance(pair, str) or len(pair) != 2:
            return None
        if not all(isinstance(part, int | float) and not isinstance(part, bool) for part in pair):
            return None
        points.append((float(pair[0]), float(pair[1])))
    rising = all(a[0] <= b[0] and a[1] <= b[1] for a, b in itertools.pairwise(points))  # also false for nan
    ends = points[0][0] == 0.0 and points[0][1] >= 0.0 and points[-1] == (1.0, 1.0)
    return tuple(points) if rising and ends else None
