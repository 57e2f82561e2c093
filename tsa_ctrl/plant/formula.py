"""A formula of the plant file (effect `custom`), run by a stack machine of the plant's own once per sub-step.

The text is read by the parameter files' parser; a step is an operation and a number: a constant, which of the signals
omega_j, q_j, q_m, tau, sigma, t, temperature it pushes, or which memory it is, and then that one's constants. A memory
holds whether it has begun, its value, a lag's rate, and the last input, which goes straight to the next.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.model.catalogue import formula_of
from tsa_ctrl.plant.compiled import compiled

_DEEPEST = 32  # values on the stack; the parser allows fewer
_SATURATED = 700.0  # exp(709.8) is the largest double
_LAG, _RING = 15, 16  # operations; above them Dahl's hysteresis


def steps_of(effects: Mapping[str, Mapping[str, Any]]) -> NDArray[np.float64]:
    """(4, n) operations and numbers of the plant file's formula; n = 0 without one."""
    if "custom" not in effects:
        return np.zeros((4, 0))
    return np.ascontiguousarray(np.array(formula_of(effects["custom"]), dtype=np.float64).T)


def memory_of(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the initial state of these steps, (memories, 4)."""
    return np.zeros((int(np.sum(steps[0] >= _LAG)), 4))


@compiled
def formula(s: Any, steps: Any, memory: Any, tau: float, sigma: float, since: float, h: float) -> float:
    """The formula's value now, N*m; 0 where it has none, and without one. Once for each sub-step of h s."""
    count = steps.shape[1]
    if count == 0:
        return 0.0
    stack = np.zeros(_DEEPEST)
    top = -1
    for i in range(count):
        op, number = int(steps[0, i]), steps[1, i]
        if op == 0:
            top += 1
            stack[top] = number
        elif op == 1:
            top += 1
            stack[top] = _signal(s, int(number), tau, sigma, since)
        elif op >= _LAG:
            stack[top] = _remembered(memory[int(number)], op, steps[2, i], steps[3, i], stack[top], h)
        elif op <= 6:
            top -= 1
            stack[top] = _two(op, stack[top], stack[top + 1])
        else:
            stack[top] = _one(op, stack[top])
    return float(stack[0]) if math.isfinite(stack[0]) else 0.0


@compiled
def _signal(s: Any, number: int, tau: float, sigma: float, since: float) -> float:
    if number == 0:
        return float(s.omega_j)
    if number == 1:
        return float(s.q_j)
    if number == 2:
        return float(s.q_m)
    if number == 3:
        return tau
    if number == 4:
        return sigma
    if number == 5:
        return since
    return float(s.temperature)


@compiled
def _two(op: int, left: float, right: float) -> float:
    if op == 2:
        return left + right
    if op == 3:
        return left - right
    if op == 4:
        return left * right
    if op == 5:
        return left / right if right != 0.0 else math.nan
    return math.nan if left == 0.0 and right < 0.0 else float(left**right)


@compiled
def _one(op: int, x: float) -> float:
    if op == 7:
        return -x
    if op == 8:
        return math.sin(x)
    if op == 9:
        return math.cos(x)
    if op == 10:
        return math.tanh(x)
    if op == 11:
        return math.exp(min(x, _SATURATED))
    if op == 12:
        return abs(x)
    if op == 13:
        return 1.0 if x > 0.0 else -1.0 if x < 0.0 else x
    return math.sqrt(x) if x >= 0.0 else math.nan


@compiled
def _remembered(own: Any, op: int, first: float, second: float, x: float, h: float) -> float:
    """The memory's value at x, h s after the last; nothing moves if x is not a number."""
    if not math.isfinite(x):
        return math.nan
    if own[0] == 0.0:
        own[0], own[1], own[2], own[3] = 1.0, 0.0 if op > _RING else x, 0.0, x
        return float(own[1])
    move = x - own[3]
    if op == _LAG:  # y = x - T slope + a decaying part
        late = first * move / h
        own[1] = x - late + (own[1] - own[3] + late) * math.exp(-h / first)
    elif op == _RING:
        w, slope = 2.0 * math.pi * first, move / h
        late = 2.0 * second * slope / w
        a, b = own[1] - own[3] + late, own[2] - slope  # swings freely about a ramp that is late
        turn = w * math.sqrt(max(0.0, 1.0 - second * second))
        sine = math.sin(turn * h) / turn if turn > 0.0 else h
        cosine, decay = math.cos(turn * h), math.exp(-second * w * h)
        own[1] = x - late + decay * (a * cosine + (b + second * w * a) * sine)
        own[2] = slope + decay * (b * cosine - (second * w * b + w * w * a) * sine)
    elif move != 0.0:
        side = math.copysign(1.0, move)
        own[1] = side - (side - own[1]) * math.exp(-abs(move) / first)
    own[3] = x
    return float(own[1])
