"""Compute the wrap angles of sheaths that cross joints, from `[routing]` of an actuator model file.

    Theta_i(q) = Theta_0 + sum over joints of g_ij q_j, or of a table of that joint        (rad; i: tendon a or b)
    Delta l_i(q) = (p + d/2) (Theta_i(q) - Theta_0)                                        (m; (3.52))

Theta_0 is `[sheath] bending_angle`, with all joints at 0. The names of the joints are those of the axes of controller
and plant. A table is linear between its points and constant beyond them. Plant, control law and identification use the
same functions, so that a file always describes the same machine.
"""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.functions import Array

MOST_GAIN = 10.0  # rad/rad; no sheath bends by ten times the joint angle, so a larger gain is in degrees
TURNS = 6.0 * math.pi  # rad, three turns: most of a sheath; a larger angle is in degrees
Points = tuple[tuple[float, float], ...]  # (rad of the joint, rad of wrap angle beyond [sheath] bending_angle)
Span = tuple[float, float]  # rad, lowest and highest angle of a joint


class RouteSection(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define the table [routing.tendon_b]: the sheath of one tendon."""

    joints: dict[str, float] = {}  # rad/rad by axis name
    table: dict[str, tuple[tuple[float, float], ...]] = {}  # [[q, theta], ...] in rad by axis name

    def __post_init__(self) -> None:
        twice = sorted(self.joints.keys() & self.table.keys())
        if twice:
            raise ValueError(f"joint '{twice[0]}' has a gain and a table; keep one of them")
        for name, gain in self.joints.items():
            if abs(gain) > MOST_GAIN:
                raise ValueError(
                    f"joints.{name} = {gain:g}; allowed is -{MOST_GAIN:g} to {MOST_GAIN:g}, "
                    "rad of wrap angle per rad of the joint; correct the unit"
                )
        for name, points in self.table.items():
            if len(points) < 2 or any(a[0] >= b[0] for a, b in itertools.pairwise(points)):
                raise ValueError(
                    f"table.{name} = {[list(point) for point in points]}; give two or more points "
                    "[rad of the joint, rad of wrap angle] with increasing first numbers"
                )
            for (q, theta), (q_next, theta_next) in itertools.pairwise(points):
                if abs(theta_next - theta) > MOST_GAIN * (q_next - q):
                    raise ValueError(
                        f"table.{name} changes by {theta_next - theta:g} rad from {q:g} to {q_next:g} rad; allowed is "
                        f"a slope of -{MOST_GAIN:g} to {MOST_GAIN:g} rad/rad; correct the unit or the points"
                    )
            widest = max(points[-1], points[0], key=lambda point: abs(point[0]))[0]
            if abs(widest) > TURNS:
                raise ValueError(
                    f"table.{name} has a joint angle of {widest:g} rad; allowed is at most {TURNS:.4g} rad either "
                    "way; degrees times 0.01745"
                )


class RoutingSection(RouteSection, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """Define the table [routing]: both tendons, or only tendon a if `tendon_b` is given."""

    tendon_b: RouteSection | None = None  # the tendon with T3 and T4; a joint that is not listed does not bend it


@dataclass(frozen=True)
class Route:
    """Compute the contribution of the joints to the wrap angle of one tendon."""

    gains: Mapping[str, float]  # rad/rad
    tables: Mapping[str, Points]

    @classmethod
    def of(cls, section: RouteSection) -> Route:
        return cls(dict(section.joints), dict(section.table))

    @property
    def joints(self) -> tuple[str, ...]:
        """Return the names of the joints that this sheath crosses."""
        return (*self.gains, *self.tables)

    def plus(self, gains: Mapping[str, float]) -> Route:
        """Return this route with `gains` (rad/rad) added by joint; the slope of a table changes between its ends."""
        sums = {**self.gains}
        tables = dict(self.tables)
        for name, gain in gains.items():
            if name in tables:
                tables[name] = tuple((q, theta + gain * q) for q, theta in tables[name])
            else:
                sums[name] = sums.get(name, 0.0) + gain
        return Route(sums, tables)

    def only(self, joint: str) -> tuple[float, Points]:
        """Return the gain (rad/rad; 0 without one) and the table (empty without one) of one joint."""
        return self.gains.get(joint, 0.0), self.tables.get(joint, ())

    def added(self, angles: Mapping[str, float]) -> float:
        """Return the wrap angle (rad) minus its value with all joints at 0; `angles`: rad of all joints, by name."""
        return sum((self.added_by(name, angles[name]) for name in self.joints), 0.0)

    def added_over(self, angles: Mapping[str, Array]) -> Array:
        """Return `added` over a log, rad, (n,); `angles`: rad of all joints, by name, (n,) each."""
        bent = np.zeros(len(next(iter(angles.values()))))
        for name, gain in self.gains.items():
            bent += gain * angles[name]
        for name, points in self.tables.items():
            bent += np.interp(angles[name], *np.transpose(points))
        return bent

    def added_by(self, joint: str, angle: float) -> float:
        """Return the wrap angle (rad) that one joint adds at `angle` (rad); 0 if it does not bend this sheath."""
        points = self.tables.get(joint)
        return self.gains.get(joint, 0.0) * angle if points is None else _between(points, angle)

    def slope_by(self, joint: str, angle: float) -> float:
        """Return d Theta / d q of one joint at `angle` (rad), rad/rad; 0 beyond a table or for a joint not crossed."""
        points = self.tables.get(joint)
        return self.gains.get(joint, 0.0) if points is None else _slope(points, angle)

    def extremes_by(self, joint: str, span: Span) -> Span:
        """Return the smallest and the largest angle that one joint within `span` (rad) adds, rad."""
        ends = self.added_by(joint, span[0]), self.added_by(joint, span[1])
        reached = [theta for q, theta in self.tables.get(joint, ()) if span[0] < q < span[1]]
        return min(*ends, *reached), max(*ends, *reached)

    def extremes(self, travel: Mapping[str, Span]) -> Span:
        """Return the smallest and the largest angle that joints within `travel` add, rad.

        The terms of the joints are independent, so their extremes are added. A joint without travel contributes over
        the range of its table, or at 0 if it has a gain.
        """
        spans = {name: travel.get(name, (0.0, 0.0)) for name in self.gains}
        spans |= {name: travel.get(name, (points[0][0], points[-1][0])) for name, points in self.tables.items()}
        ends = [self.extremes_by(name, span) for name, span in spans.items()]
        return sum(low for low, _ in ends), sum(high for _, high in ends)


@dataclass(frozen=True)
class Routing:
    """Hold the routes of both tendons of a pair: a has the tensions T1 and T2, b has T3 and T4."""

    a: Route
    b: Route

    @classmethod
    def of(cls, section: RoutingSection | None) -> Routing | None:
        """Return the routing of a file; None if no joint bends a sheath."""
        if section is None:
            return None
        first = Route.of(section)
        made = cls(first, first if section.tendon_b is None else Route.of(section.tendon_b))
        return made if made.joints else None

    @classmethod
    def sum_of(cls, routing: Routing | None, gains: Mapping[str, float]) -> Routing | None:
        """Return a routing with `gains` (rad/rad) added by joint, on both tendons."""
        if not gains:
            return routing
        first, second = (Route({}, {}),) * 2 if routing is None else (routing.a, routing.b)
        return cls(first.plus(gains), second.plus(gains))

    @property
    def joints(self) -> tuple[str, ...]:
        """Return the names of all joints that bend either sheath, each once, in the order of the file."""
        return tuple(dict.fromkeys((*self.a.joints, *self.b.joints)))

    @property
    def alike(self) -> bool:
        """Return True if both tendons are routed in the same way."""
        return self.a == self.b

    def wrap_angles(self, angles: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return the wrap angles of a and b minus Theta_0 over a log, rad, (n,) each; `angles`: (n,) by joint."""
        return self.a.added_over(angles), self.b.added_over(angles)

    def section(self) -> dict[str, Any]:
        """Return the `[routing]` table of this routing."""
        table = _table(self.a)
        return table if self.alike else {**table, "tendon_b": _table(self.b)}

    def check_joints(self, known: Iterable[str], where: str) -> None:
        """Raise UsageError for a joint that is not an axis; `where` begins the message."""
        names = tuple(known)
        for joint in self.joints:
            if joint not in names:
                raise UsageError(
                    f"{where}: [routing] names joint '{joint}'; the axes are {', '.join(names)}; "
                    "give the name of one of them, or add an axis of that name"
                )

    def check_travel(self, bending_angle: float, travel: Mapping[str, Span], where: str) -> None:
        """Raise UsageError if a wrap angle is below 0 or above three turns within the joints' travel."""
        for name, route in (("a", self.a), ("b", self.b)):
            low, high = route.extremes(travel)
            spans = {joint: travel[joint] for joint in route.joints if joint in travel}
            _check_range(name, (bending_angle + low, bending_angle + high), spans, f"{where}: [routing]", "the travel")

    def check_log(self, bending_angle: float, angles: Mapping[str, Array], where: str) -> None:
        """Raise UsageError if a wrap angle is below 0 or above three turns in a log; `angles`: rad, (n,) by joint."""
        for name, route in (("a", self.a), ("b", self.b)):
            theta = bending_angle + route.added_over(angles)
            spans = {joint: (float(np.min(angles[joint])), float(np.max(angles[joint]))) for joint in route.joints}
            span = float(np.min(theta)), float(np.max(theta))
            _check_range(name, span, spans, f"{where}: [routing]", "the columns q_j.NAME")


def _check_range(tendon: str, theta: Span, spans: Mapping[str, Span], where: str, source: str) -> None:
    """Raise UsageError if the wrap angle of a tendon, which joints within `spans` give, leaves its range (rad)."""
    low, high = theta
    if low >= 0.0 and high <= TURNS:
        return
    joints = ", ".join(f"{joint} from {low:.4g} to {high:.4g} rad" for joint, (low, high) in spans.items())
    over = f" over {source} ({joints})" if joints else ""
    raise UsageError(
        f"{where} tendon {tendon} has a wrap angle of {low if low < 0.0 else high:.4g} rad{over}; allowed is 0 to "
        f"{TURNS:.4g} rad; correct gains, tables or [sheath] bending_angle, or {source}"
    )


def _between(points: Points, angle: float) -> float:
    if angle <= points[0][0]:
        return points[0][1]
    if angle >= points[-1][0]:
        return points[-1][1]
    i = bisect.bisect_right(points, angle, key=lambda point: point[0])
    (q, theta), (q_next, theta_next) = points[i - 1], points[i]
    return theta + (theta_next - theta) * (angle - q) / (q_next - q)


def _slope(points: Points, angle: float) -> float:
    if not points[0][0] <= angle < points[-1][0]:
        return 0.0
    i = bisect.bisect_right(points, angle, key=lambda point: point[0])
    return (points[i][1] - points[i - 1][1]) / (points[i][0] - points[i - 1][0])


def _table(route: Route) -> dict[str, Any]:
    table: dict[str, Any] = {}
    if route.gains:
        table["joints"] = dict(route.gains)
    if route.tables:
        table["table"] = {name: [list(point) for point in points] for name, points in route.tables.items()}
    return table
