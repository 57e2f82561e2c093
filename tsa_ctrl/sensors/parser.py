"""Bytes of an ASCII line protocol to values: pure, bounded, and forgiving of noise, cuts and half lines."""

from __future__ import annotations

import math
import re

from tsa_ctrl.sensors.settings import SerialSensorSettings

MOST_LINE = 256  # bytes: longer is noise, thrown away up to the next line end
_END = re.compile(rb"[\r\n]+")


class LineParser:
    """Feed bytes, get SI values. The first, possibly cut, line after a (re)connection is never used."""

    def __init__(self, settings: SerialSensorSettings) -> None:
        self._pattern = re.compile(settings.pattern)
        self._unit = settings.unit
        self._scale = settings.scale
        self._offset = settings.offset
        self._low = settings.low
        self._high = settings.high
        self._rest = b""
        self._synchronised = False
        self.rejected = 0

    def reset(self) -> None:
        """The connection was cut: what is half read is worth nothing."""
        self._rest = b""
        self._synchronised = False

    def feed(self, data: bytes) -> list[float]:
        """Values of the complete lines in `data` and what was left before, oldest first."""
        pieces = _END.split(self._rest + data)
        self._rest = pieces.pop()
        if len(self._rest) > MOST_LINE:
            self._rest = b""
            self._synchronised = False
            self.rejected += 1
        values = []
        for line in pieces:
            if not self._synchronised:
                self._synchronised = True
                continue
            if not line:
                continue
            value = self._value(line)
            if value is None:
                self.rejected += 1
            else:
                values.append(value)
        return values

    def _value(self, line: bytes) -> float | None:
        if len(line) > MOST_LINE:
            return None
        match = self._pattern.search(line.decode("ascii", errors="replace"))
        if match is None or (self._unit and match["unit"] != self._unit):
            return None
        try:
            value = float(match["value"]) * self._scale + self._offset
        except (TypeError, ValueError):
            return None
        return value if math.isfinite(value) and self._low <= value <= self._high else None
