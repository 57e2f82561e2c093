"""Compute the set-point: the desired joint torque, N*m, as a function of the time since the enable.

A source is a function of time, or the last value received over the local socket. `SetPoint` scales it, limits its rate,
and starts at 0. After the end of a file or of the socket's values, it returns to 0.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

from tsa_ctrl.control.settings import MOST_TORQUE, Component, SetPointSettings
from tsa_ctrl.errors import UsageError

Source = Callable[[float], float]
# Samples of a sum of sines over its common period: their number at most (20 ms per sine), and per period of the fastest
# sine. 200 leave 0.012 % uncertain, 20 leave 1.2 %.
_MOST_SAMPLES, _FEWEST, _ENOUGH = 500_000, 20, 200


class SetPoint:
    """Compute the set-point of one axis; `gain` scales the source.

    `value` is the desired torque now. `acting` and `ahead` are the desired torque `delay` and `horizon` later, `rate`
    (N*m/s) is its slope `lead` later. The future of a source is known if it is a function of time, but not for the
    socket.
    """

    def __init__(
        self,
        settings: SetPointSettings,
        period: float,
        folder: str | Path = ".",
        delay: float = 0.0,
        lead: float = 0.0,
        horizon: float = 0.0,
        limit: float = math.inf,
    ) -> None:
        """Prepare the source; times in s.

        Args:
            settings: [axis.setpoint].
            period: s.
            folder: folder of a relative file.
            delay, lead, horizon: times ahead, see the class.
            limit: largest size of the set-point with any gain, N*m.

        Raises:
            UsageError: the file cannot be played.
        """
        self.gain = 1.0
        self.is_received = settings.kind == "socket"
        self._limit = limit
        self._source = None if settings.kind == "socket" else waveform(settings, folder)
        self._period = period
        self._step = settings.rate * period
        self._timeout = settings.timeout
        self._delay, self._delay_part = _place(delay, period)
        self._lead = _place(lead, period)[0]
        self._ahead, self._ahead_part = _place(max(delay, lead, horizon), period)
        self._count = self._ahead + 2
        self.reset()

    def receive(self, value: float, t: float) -> None:
        """Replace the last set-point of the local socket by `value` (N*m), received at `t` (s since the enable).

        A value that is not finite or is older than the enable only clears the last set-point.
        """
        wanted = math.isfinite(value) and t >= 0.0
        self._received, self._received_at = (value, t) if wanted else (0.0, -math.inf)

    def reset(self) -> None:
        """Start from 0 again, and discard the received set-point."""
        self.value = self.acting = self.ahead = self.rate = 0.0
        self.silent = False  # no current set-point from the socket
        self._received = 0.0
        self._received_at = -math.inf
        self._known: list[float] = []  # values from now on, one per period
        self._last = 0.0  # the newest value
        self._at = 0.0  # s, time of the first value

    def update(self, t: float) -> float:
        """Return the desired joint torque (N*m) at `t` s since the enable."""
        if self._source is None:
            self.silent = t - self._received_at > self._timeout
            before = self._last
            self.value = self.acting = self.ahead = self._next(t)
            self.rate = (self.value - before) / self._period
            return self.value
        known, period = self._known, self._period
        passed = t - self._at
        if passed > self._count * period:
            known.clear()
        while known and passed > 0.5 * period:
            del known[0]
            self._at += period
            passed -= period
        if not known:
            self._at = t
        while len(known) < self._count:
            known.append(self._next(self._at + len(known) * period))
        self.value = known[0]
        i, part = self._delay, self._delay_part
        self.acting = known[i] + part * (known[i + 1] - known[i])
        i, part = self._ahead, self._ahead_part
        self.ahead = known[i] + part * (known[i + 1] - known[i])
        self.rate = (known[self._lead + 1] - known[self._lead]) / period
        return self.value

    def _next(self, t: float) -> float:
        """Return the set-point at `t`, N*m, limited in size and rate."""
        if self._source is not None:
            target = self.gain * self._source(t)
        elif t - self._received_at <= self._timeout:
            target = self.gain * self._received
        else:
            target = 0.0
        limit = self._limit
        if target > limit:
            target = limit
        elif target < -limit:
            target = -limit
        change, step = target - self._last, self._step
        self._last += step if change > step else -step if change < -step else change
        return self._last


def _place(time: float, period: float) -> tuple[int, float]:
    """Return the number of whole periods in `time`, and the fraction of the next one."""
    whole, part = divmod(time / period, 1.0)
    return int(whole), part


def waveform(settings: SetPointSettings, folder: str | Path = ".") -> Source:
    """Return the set-point as a function of time; raise UsageError for a file that cannot be played."""
    offset, amplitude = settings.offset, settings.amplitude
    if settings.kind == "constant":
        return lambda t: offset
    if settings.kind == "sine":
        omega = 2.0 * math.pi * settings.frequency
        return lambda t: offset + amplitude * math.sin(omega * t)
    if settings.kind == "step":
        at = settings.at
        return lambda t: offset + (amplitude if t >= at else 0.0)
    if settings.kind == "multi_sine":
        parts = [(c.amplitude, 2.0 * math.pi * c.frequency, c.phase) for c in settings.components]
        return lambda t: offset + math.fsum(a * math.sin(w * t + phase) for a, w, phase in parts)
    if settings.kind == "chirp":
        return _chirp(offset, amplitude, settings.frequency, settings.end_frequency, settings.duration)
    if settings.kind == "file":
        times, values = read_file(Path(folder) / settings.file)
        return _played(times, values, offset, settings.loop)
    raise UsageError(f'setpoint: kind "{settings.kind}" has no waveform; its values come over the local socket')


def largest(settings: SetPointSettings, folder: str | Path = ".") -> float:
    """Return the largest size that the set-point can reach, N*m; 0 for a socket, whose values are clamped one by one.

    Raises:
        UsageError: a file cannot be played.
    """
    offset = settings.offset
    match settings.kind:
        case "socket":
            return 0.0
        case "constant":
            return abs(offset)
        case "step":
            return max(abs(offset), abs(offset + settings.amplitude))
        case "sine" | "chirp":
            return abs(offset) + abs(settings.amplitude)
        case "multi_sine":
            return _peak(offset, settings.components)
    _, values = read_file(Path(folder) / settings.file)
    return max(abs(offset + value) for value in values)


def _peak(offset: float, components: Sequence[Component]) -> float:
    """Return the peak of a sum of sines, N*m, from above: it is sampled over its period, or else all amplitudes count.

    With n samples per period of the fastest sine, w, the largest sample is at least M cos(pi / n) for the peak M.
    Source: f'^2 + w^2 f^2 <= w^2 M^2 (R. J. Duffin, A. C. Schaeffer, Bull. AMS 43, 1937), so f does not fall faster
    from its peak than M cos(w t).
    """
    most = abs(offset) + math.fsum(abs(c.amplitude) for c in components)
    fastest, exact = max(c.frequency for c in components), [Fraction(repr(c.frequency)) for c in components]
    common = Fraction(math.lcm(*(f.denominator for f in exact)), math.gcd(*(f.numerator for f in exact)))  # s
    periods = Fraction(repr(fastest)) * common
    per_period = min(_ENOUGH, math.floor(_MOST_SAMPLES / periods))
    if per_period < _FEWEST:
        return most
    t = np.arange(math.ceil(periods * per_period)) / (fastest * per_period)
    values = offset + sum(c.amplitude * np.sin(2.0 * math.pi * c.frequency * t + c.phase) for c in components)
    return min(most, float(np.abs(values).max()) / math.cos(math.pi / per_period))


def _chirp(offset: float, amplitude: float, first: float, last: float, duration: float) -> Source:
    """Return a repeated chirp whose frequency changes linearly from `first` to `last` Hz within `duration` s."""
    slope = (last - first) / duration

    def source(t: float) -> float:
        t %= duration
        return offset + amplitude * math.sin(2.0 * math.pi * (first + 0.5 * slope * t) * t)

    return source


def _played(times: Sequence[float], values: Sequence[float], offset: float, loop: bool) -> Source:
    """Return the linear interpolation of a file; after its end, it is repeated or 0."""
    end = times[-1]

    def source(t: float) -> float:
        if t > end:
            if not loop:
                return 0.0
            t %= end
        after = bisect_right(times, t)
        if after == 0:
            return offset + values[0]
        if after == len(times):
            return offset + values[-1]
        t0, v0 = times[after - 1], values[after - 1]
        return offset + v0 + (values[after] - v0) * (t - t0) / (times[after] - t0)

    return source


def read_file(path: Path) -> tuple[list[float], list[float]]:
    """Return times (s, from 0) and joint torques (N*m) of a file; raise UsageError with file, column and row."""
    from tsa_ctrl.log.table import from_zero, read_waypoints  # slow to import

    table = read_waypoints(path, ("tau_j_des",))
    values = table.columns["tau_j_des"]
    beyond = np.flatnonzero(np.abs(values) > MOST_TORQUE)
    if beyond.size:
        row = int(beyond[0])
        raise UsageError(
            f"{path}: column 'tau_j_des', {table.place(row)}: {values[row]:g} N*m is beyond {MOST_TORQUE:g}; give N*m"
        )
    return from_zero(table.columns["t"]).tolist(), values.tolist()
