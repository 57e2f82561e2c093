"""Compiled interpolation: tables that change with time, and the imposed motion of a joint."""

from __future__ import annotations

from typing import Any

from tsa_ctrl.plant.compiled import compiled


@compiled
def table_value(table: Any, x: float, before: float) -> float:
    """Linear interpolation, constant beyond the ends; `before` when the table is empty."""
    n = table.shape[1]
    if n == 0:
        return before
    if x <= table[0, 0]:
        return float(table[1, 0])
    for i in range(1, n):
        if x < table[0, i]:
            w = (x - table[0, i - 1]) / (table[0, i] - table[0, i - 1])
            return float((1.0 - w) * table[1, i - 1] + w * table[1, i])
    return float(table[1, n - 1])


@compiled
def hand(s: Any, p: Any, table: Any, time: float) -> None:
    """Stiffness, damping, angle and speed of the hand at `time` s since the start, into the state.

    Stiffness and damping are linear between rows; the angle rests at each of them and goes smoothly between.
    """
    n = table.shape[1]
    if n == 0:
        return
    last = table[0, n - 1]
    if p.hand_repeat and time > last > 0.0:
        time = time % last
    i = 1
    while i < n and time >= table[0, i]:
        i += 1
    if i >= n or time <= table[0, 0]:
        row = n - 1 if i >= n else 0
        stiffness, damping, s.hand_angle, s.hand_speed = table[1, row], table[2, row], table[3, row], 0.0
    else:
        width = table[0, i] - table[0, i - 1]
        y = (time - table[0, i - 1]) / width
        stiffness = (1.0 - y) * table[1, i - 1] + y * table[1, i]
        damping = (1.0 - y) * table[2, i - 1] + y * table[2, i]
        way = table[3, i] - table[3, i - 1]
        s.hand_angle = table[3, i - 1] + way * y * y * (3.0 - 2.0 * y)
        s.hand_speed = way * 6.0 * y * (1.0 - y) / width
    s.hand_stiffness, s.hand_damping = p.hand_factor * stiffness, p.hand_factor * damping


@compiled
def imposed_motion(p: Any, motion: Any, time: float) -> tuple[float, float, float]:
    """Angle, speed and acceleration of the imposed motion, `time` s after its beginning; negative: it waits."""
    last = motion.shape[1] - 1
    duration = last * p.motion_grid
    if time <= 0.0:
        return motion[0, 0], 0.0, 0.0
    local = time
    if local >= duration:
        if not p.motion_repeat:
            return motion[0, last], 0.0, 0.0
        local = local % duration
    g = p.motion_grid
    i = min(last - 1, int(local / g))
    x = local / g - i
    a, b, c, d = motion[0, i], motion[0, i + 1], motion[1, i] * g, motion[1, i + 1] * g
    e, f = b - a, c + d
    q = a + x * (c + x * (3.0 * e - 2.0 * c - d + x * (f - 2.0 * e)))
    w = (c + x * (2.0 * (3.0 * e - 2.0 * c - d) + 3.0 * x * (f - 2.0 * e))) / g
    acceleration = (2.0 * (3.0 * e - 2.0 * c - d) + 6.0 * x * (f - 2.0 * e)) / (g * g)
    if time < p.motion_ramp:
        y = time / p.motion_ramp
        r, r1, r2 = y * y * (3.0 - 2.0 * y), 6.0 * y * (1.0 - y) / p.motion_ramp, (6.0 - 12.0 * y) / p.motion_ramp**2
        d0 = q - motion[0, 0]
        acceleration = r2 * d0 + 2.0 * r1 * w + r * acceleration
        w = r1 * d0 + r * w
        q = motion[0, 0] + r * d0
    return q, w, acceleration
