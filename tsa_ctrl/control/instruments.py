"""Joint torque, tendon tensions and sheath bending of one axis: from a node on the bus, or from sensors beside it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from tsa_ctrl.bus.live.image import Image

Source = Callable[[float], float]  # monotonic time now (s) -> SI value, nan when there is none that is young enough


class Instruments:
    """What one axis' instruments say in this cycle; nan where there is none, or its value is too old."""

    __slots__ = ("_image", "_t1", "_t3", "_tau_j", "_theta", "t1", "t3", "tau_j", "theta")

    temperature = math.nan  # K: no instrument measures it yet

    def __init__(self, image: Image) -> None:
        self._image = image
        self._tau_j: Source | None = None
        self._t1: Source | None = None
        self._t3: Source | None = None
        self._theta: Source | None = None
        self.tau_j = math.nan  # N*m, joint torque
        self.t1 = math.nan  # N, motor-side tension of tendon a
        self.t3 = math.nan  # N, motor-side tension of tendon b
        self.theta = math.nan  # rad, bending of the sheath

    def connect(self, sources: Mapping[str, Source]) -> None:
        """Take "tau_j", "t1", "t3" or "theta" from these instead of from the bus."""
        self._tau_j, self._t1, self._t3, self._theta = (sources.get(name) for name in ("tau_j", "t1", "t3", "theta"))

    def update(self, now: float) -> None:
        """Read all, at monotonic `now` in s; about a microsecond for each source."""
        self.tau_j = self._image.tau_j if self._tau_j is None else self._tau_j(now)
        if self._t1 is not None:
            self.t1 = self._t1(now)
        if self._t3 is not None:
            self.t3 = self._t3(now)
        if self._theta is not None:
            self.theta = self._theta(now)
