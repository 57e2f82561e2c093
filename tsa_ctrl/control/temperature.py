"""Provide the temperature for the control law: checked, and changed no faster than a mechanism can warm up."""

from __future__ import annotations

import math

LOWEST, HIGHEST = -40.0, 150.0  # degC; a value outside is a broken sensor and is ignored
FASTEST = 2.0  # K/s; a jump of the reading must not become a jump of the torque


class Temperature:
    """Follow a temperature sensor; the last value is held while the sensor is silent."""

    __slots__ = ("_step", "value")

    def __init__(self, period: float) -> None:
        """Start without a reading; `period` of the loop in s."""
        self._step = FASTEST * period
        self.value = math.nan  # degC; nan until the first reading

    def update(self, reading: float) -> float:
        """Return the temperature in degC after a cycle with this reading; nan means no reading."""
        if LOWEST <= reading <= HIGHEST:
            if self.value != self.value:
                self.value = reading
            else:
                self.value += min(self._step, max(-self._step, reading - self.value))
        return self.value
