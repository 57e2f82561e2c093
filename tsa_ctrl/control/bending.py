"""Determine the sheath's wrap angle Theta in the loop: fixed, commanded, measured, or by the routing over joints.

    Theta = offset + sum over joints of the angle that each adds        (rad; `tsa_ctrl.model.routing`)

A measured angle is extrapolated by the joint's velocity to the time at which the torque acts. A missing angle is
replaced by the angle within the joint's range at which the sheath is bent least. Friction and pretension grow with the
wrap angle, so this is the least friction that the joint allows. The transition is gradual: the square of the wrap
angle changes evenly, and with it the friction, because friction angle and pretension both grow with the wrap angle.

Tendons a and b may be routed differently. Their friction angles then differ, and so do their path lengths:

    x_a, x_b = x (1 +- i),    i = (Theta_a - Theta_b) / (Theta_a + Theta_b)                    (imbalance)
    q_M - (r_J/r_M) q_J = (tensions) + (p + d/2) (Theta_a - Theta_b) / (2 r_M)                 (3.52), both tendons
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from tsa_ctrl.control.settings import BendingSettings
from tsa_ctrl.model.routing import Route, Routing, Span

Reading = Callable[[], tuple[float, float]]  # returns the present rad and rad/s of a joint; nan if they are unknown

FADE_OUT = 0.044  # s from the loss of an angle to the least wrap angle; 50 ms with three missed answers at 500 Hz
FADE_IN = 1.0  # s back to the measured angle


def routing_of(settings: BendingSettings, routing: Routing | None) -> Routing | None:
    """Return the routing that the law uses; None without one.

    Args:
        settings: [axis.bending], whose gains are used as a routing.
        routing: routing of the model file. A sensor of the wrap angle replaces it.
    """
    if settings.gains:
        route = Route(dict(settings.gains), {})
        return Routing(route, route)
    return None if settings.source == "sensor" else routing


class _Joint:
    """Compute the wrap angle that one joint adds, as the mean of both tendons."""

    def __init__(
        self, name: str, routing: Routing, read: Reading | None, span: Span | None, period: float, ahead: float
    ) -> None:
        self.name = name
        self.missing = read is None
        self.fading = False
        self.difference = 0.0  # rad, half of Theta_a - Theta_b by this joint; held while the angle is missing
        self._routes = (routing.a, routing.b)
        self._read = read
        self._ahead = ahead
        self._apart = 0.0  # rad, `difference` at the time of the measurement
        self._span = span
        self._seen = (math.inf, -math.inf)  # rad, measured range, used for a joint without a travel
        self._added = math.nan
        self._gap = 0.0  # rad, change that the transition spreads
        self._left, self._step = 0.0, 0.0  # share of the change that remains, 1 to 0, and its decrease in a period
        self._period = period

    def extremes(self) -> Span:
        """Return the smallest and the largest angle that the joint may add, rad.

        For a joint without a travel, the range measured so far is used. The fault of that axis soon removes the torque.
        """
        span = self._seen if self._span is None else self._span
        if span[0] > span[1]:
            return 0.0, 0.0
        a, b = (route.extremes_by(self.name, span) for route in self._routes)
        return 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])

    def path_difference(self) -> tuple[float, float]:
        """Return half of Theta_a - Theta_b by this joint at the measurement, and its rate, rad and rad/s.

        Without a measurement, the last angle is returned with the rate 0.
        """
        angle, speed = (math.nan, 0.0) if self._read is None else self._read()
        if not math.isfinite(angle):
            return self._apart, 0.0
        a, b = self._routes
        self._apart = 0.5 * (a.added_by(self.name, angle) - b.added_by(self.name, angle))
        return self._apart, 0.5 * speed * (a.slope_by(self.name, angle) - b.slope_by(self.name, angle))

    def update(self, others: float) -> float:
        """Return the angle that the joint adds now, rad; changes between measured and missing are gradual.

        Args:
            others: wrap angle without this joint and those after it, rad.
        """
        angle, speed = (math.nan, 0.0) if self._read is None else self._read()
        angle += self._ahead * speed
        missing = not math.isfinite(angle)
        if missing:
            added = self.extremes()[0]
        else:
            a, b = self._routes
            on_a, on_b = a.added_by(self.name, angle), b.added_by(self.name, angle)
            added, self.difference = 0.5 * (on_a + on_b), 0.5 * (on_a - on_b)
            low, high = self._seen
            self._seen = min(low, angle), max(high, angle)
        if missing is not self.missing and self._added == self._added:
            self._gap = self._added - added
            self._left, self._step = 1.0, self._period / (FADE_OUT if missing else FADE_IN)
            self.fading = True
        self.missing = missing
        if self.fading:
            self._left = max(0.0, self._left - self._step)
            self.fading = self._left > 0.0
            to = max(0.0, others + added)
            start = max(0.0, to + self._gap)
            added = math.sqrt(to * to + self._left * (start * start - to * to)) - others
        if not missing or self._read is None or self._added == self._added:
            self._added = added
        return added


class Bending:
    """Determine Theta of the sheaths of one axis; `commanded` is the user's value (rad)."""

    def __init__(self, settings: BendingSettings, nominal: float, routing: Routing | None = None) -> None:
        """Prepare the sources; `nominal`: the model file's bending angle, rad; `routing`: result of `routing_of`."""
        self.settable = settings.source in ("command", "joints") or routing is not None
        self.fixed = settings.source == "fixed" and routing is None
        self.commanded = nominal if settings.offset is None else settings.offset
        self.routing = routing
        self._joints: tuple[_Joint, ...] = ()
        self._apart = routing is not None and not routing.alike
        self._measured: Callable[[], float] | None = None

    def connect(
        self, joints: Mapping[str, Reading], ranges: Mapping[str, Span], period: float, ahead: float = 0.0
    ) -> None:
        """Connect the joints of the routing.

        Args:
            joints: function that reads each joint, by name. A joint without a function is never measured.
            ranges: range of each joint by name, rad.
            period: s.
            ahead: time from a reading until the torque acts, s.
        """
        if self.routing is not None:
            self._joints = tuple(
                _Joint(name, self.routing, joints.get(name), ranges.get(name), period, ahead)
                for name in self.routing.joints
            )

    def measure(self, read: Callable[[], float]) -> None:
        """Use this function to read the angle (rad) from a sensor; it returns nan without a value."""
        self._measured = read

    @property
    def difference(self) -> float:
        """Return half of Theta_a - Theta_b at the last update, rad; 0 for tendons with the same routing."""
        return sum([joint.difference for joint in self._joints]) if self._apart else 0.0

    def path_difference(self) -> tuple[float, float]:
        """Return half of Theta_a - Theta_b (rad) and its rate (rad/s) at the time of the present measurements."""
        angle = rate = 0.0
        if self._apart:
            for joint in self._joints:
                by_joint, by_speed = joint.path_difference()
                angle, rate = angle + by_joint, rate + by_speed
        return angle, rate

    @property
    def missing(self) -> tuple[str, ...]:
        """Return the names of the joints whose angle is missing now."""
        return tuple([joint.name for joint in self._joints if joint.missing])

    @property
    def fading(self) -> bool:
        """Return True during the transition after an angle was lost or is measured again."""
        return any(joint.fading for joint in self._joints)

    @property
    def most_more(self) -> float:
        """Return the angle by which the sheath may be bent more than `update` returned for missing angles, rad."""
        more = 0.0
        for joint in self._joints:
            if joint.missing:
                low, high = joint.extremes()
                more += high - low
        return more

    def update(self) -> float:
        """Return the present wrap angle, rad, at least 0; nan if the model fixes it or a measurement is missing."""
        if self.fixed:
            return math.nan
        theta = self.commanded if self._measured is None else self._measured()
        for joint in self._joints:
            theta += joint.update(theta)
        return theta if theta >= 0.0 or theta != theta else 0.0
