"""Build the prescribed motion of a joint: a table of angle and speed on a constant grid, for cubic Hermite pieces.

A sine, a gait and a CSV file all become a table, so that the inner loop handles only one kind of motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.plant.settings import MotionSettings

_GRID = 1e-3  # s
_FEWEST = 4  # rows that a cubic spline needs
_MAX_SAMPLES = 4_000_000  # of a motion file on the grid; more than an hour

# Knee flexion over one cycle of level walking: fraction of the cycle, degrees (typical values from the literature).
_KNEE = (
    (0.00, 5.0), (0.07, 12.0), (0.15, 18.0), (0.25, 14.0), (0.40, 5.0),
    (0.50, 11.0), (0.60, 35.0), (0.72, 61.0), (0.85, 34.0), (0.95, 6.0),
)  # fmt: skip


@dataclass(frozen=True)
class Motion:
    """Hold `angle` (rad) and `speed` (rad/s) at multiples of `grid` (s); with `repeat`, the end meets the start.

    The motion grows from standstill in `ramp` s.
    """

    angle: NDArray[np.float64]
    speed: NDArray[np.float64]
    grid: float
    repeat: bool
    ramp: float


def build_motion(settings: MotionSettings) -> Motion:
    """Return the motion that these settings describe; raises UsageError for an unusable file."""
    if settings.kind == "still":
        return Motion(np.full(2, settings.offset), np.zeros(2), _GRID, False, 0.0)
    if settings.kind == "sine":
        period = 1.0 / settings.frequency
        t, grid = _cycle(period)
        argument = 2.0 * math.pi * settings.frequency * t + settings.phase
        angle = settings.offset + settings.amplitude * np.sin(argument)
        speed = settings.amplitude * 2.0 * math.pi * settings.frequency * np.cos(argument)
        return Motion(angle, speed, grid, True, settings.ramp)
    if settings.kind == "gait":
        points = np.array([*_KNEE, (1.0, _KNEE[0][1])])
        t, grid = _cycle(settings.period)
        angle, speed = _smooth_cycle(points[:, 0] * settings.period, np.radians(points[:, 1]), t)
        return Motion(settings.scale * angle, settings.scale * speed, grid, True, settings.ramp)
    return _from_file(settings)


def _cycle(period: float) -> tuple[NDArray[np.float64], float]:
    """Return the sample times over one period, end included."""
    count = max(8, math.ceil(period / _GRID))
    return np.linspace(0.0, period, count + 1), period / count


def _smooth_cycle(
    x: NDArray[np.float64], y: NDArray[np.float64], t: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return value and slope at `t` of the periodic cubic spline through points whose last value equals the first.

    The result equals that of scipy, whose import would take as long as the rest of the plant's startup.
    """
    h = np.diff(x)
    chord, before = np.diff(y) / h, np.roll(h, 1)  # slope of each piece, and length of the piece before it
    each = np.arange(h.size)
    system = np.zeros((h.size, h.size))  # the second derivative is continuous at each point
    system[each, each - 1] = h
    system[each, each] = 2.0 * (before + h)
    system[each, (each + 1) % h.size] = before
    slope = np.linalg.solve(system, 3.0 * (h * np.roll(chord, 1) + before * chord))
    i = np.clip(np.searchsorted(x, t, side="right") - 1, 0, h.size - 1)
    begin, end = slope[i], np.roll(slope, -1)[i]
    quadratic, cubic = (3.0 * chord[i] - 2.0 * begin - end) / h[i], (begin + end - 2.0 * chord[i]) / h[i] ** 2
    u = t - x[i]
    return y[i] + u * (begin + u * (quadratic + u * cubic)), begin + u * (2.0 * quadratic + u * 3.0 * cubic)


def _from_file(settings: MotionSettings) -> Motion:
    from scipy.interpolate import CubicHermiteSpline, CubicSpline  # slow to import

    from tsa_ctrl.log.table import read_waypoints  # also slow to import

    table = read_waypoints(str(settings.file), ("q_j",), ("omega_j",))
    t, columns = table.columns["t"], table.columns
    if t.size < _FEWEST:
        raise UsageError(f"{settings.file}: {t.size} rows; a motion needs at least {_FEWEST}")
    duration = t[-1] - t[0]
    count = max(2, math.ceil(duration / _GRID))
    if count > _MAX_SAMPLES:
        raise UsageError(
            f"{settings.file}: a motion of {duration:g} s is too long; give at most {_MAX_SAMPLES * _GRID:g} s"
        )
    if "omega_j" in columns:
        spline = CubicHermiteSpline(t, columns["q_j"], columns["omega_j"])
    else:
        spline = CubicSpline(t, columns["q_j"])
    grid = np.linspace(t[0], t[-1], count + 1)
    angle, speed = settings.scale * spline(grid), settings.scale * spline(grid, 1)
    if settings.repeat:
        _close(angle, speed, grid - t[0], duration)
    return Motion(angle, speed, duration / count, settings.repeat, settings.ramp)


def _close(angle: NDArray[np.float64], speed: NDArray[np.float64], t: NDArray[np.float64], duration: float) -> None:
    """Blend the end of a repeated motion into its beginning, in place, over its last tenth (at most 1 s)."""
    width = min(1.0, 0.1 * duration)
    y = np.clip((t - duration + width) / width, 0.0, 1.0)
    gap = angle[-1] - angle[0]
    angle -= gap * y * y * (3.0 - 2.0 * y)
    speed -= gap * 6.0 * y * (1.0 - y) / width
