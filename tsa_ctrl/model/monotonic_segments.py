"""Split a path into monotonic segments, and compute the state of friction and backlash along it.

A state that depends on its last value normally requires a loop over the samples. Within one segment ("leg"), however,
each of these states has a closed form. Only the values at the ends of the legs depend on each other, by maps that can
be composed in blocks. A few operations on whole arrays therefore suffice. A compiled loop takes as long per log, plus
half a second for loading.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.model.functions import Array


@dataclass(frozen=True)
class MonotonicSegments:
    """Hold a path (n,) in m legs, each with one direction of motion.

    `first` (m,) is the first sample of each leg, and `way` (m,) its direction, +1 or -1. `leg` (n,) is the number of
    the leg in which a sample is reached.
    """

    path: Array
    first: NDArray[np.int64]
    way: Array
    leg: NDArray[np.int64]

    @staticmethod
    def of(path: Array) -> MonotonicSegments:
        """Return the legs of a path; at rest the path keeps its direction."""
        steps = np.diff(path)
        moves = np.flatnonzero(steps)
        up = steps[moves] > 0.0
        first = np.concatenate([[0], moves[1:][up[1:] != up[:-1]]]).astype(np.int64)
        way = np.where(np.arange(len(first)) % 2 == 0, 1.0, -1.0) * (1.0 if len(up) == 0 or up[0] else -1.0)
        leg = np.zeros(len(path), dtype=np.int64)
        leg[first[1:] + 1] = 1
        return MonotonicSegments(path, first, way, np.cumsum(leg))

    @cached_property
    def gone(self) -> Array:
        """Return the distance (n,) of each sample from the start of its leg."""
        distance = self.path - self.path[self.first].take(self.leg)
        return np.abs(distance, out=distance)

    @cached_property
    def lengths(self) -> Array:
        """Return the length (m - 1,) of each leg except the last one."""
        return np.abs(np.diff(self.path[self.first]))

    @property
    def nbytes(self) -> int:
        """Return the size in memory with the cached results, bytes."""
        return self.leg.nbytes + 8 * len(self.path)


def dahl(legs: MonotonicSegments, distance: float, start: float) -> Array:
    """Return the friction state z, (n,), of dz/ds = (1 - sign(ds) z)/q_p along s, from z = `start`; exact on each leg.

    `distance`: q_p, in the unit of the path.
    """
    gained = -np.expm1(-legs.lengths / distance)
    begin = _after_each(start, np.stack([1.0 - gained, legs.way[:-1] * gained]), _affine_after, _affine)
    state = np.multiply(legs.gone, -1.0 / distance)
    np.exp(state, out=state)
    state *= (begin - legs.way).take(legs.leg)
    state += legs.way.take(legs.leg)
    return state


def maxwell_slip(legs: MonotonicSegments, distance: float, elements: int, start: float) -> Array:
    """Return the mean (n,) of N elements that slip at +-1 after distances q_p i/N from rest, i = 1..N; exact.

    Each element starts at `start`.
    """
    stiffness = elements / (distance * np.arange(1, elements + 1))
    shifts = np.outer(legs.way[:-1] * legs.lengths, stiffness).T
    ones = np.ones_like(shifts)
    begin = _after_each(start, np.stack([shifts, -ones, ones]), _clipped_after, _clipped)
    gone = legs.gone * legs.way.take(legs.leg)
    total, state, moved = np.zeros(len(gone)), np.empty(len(gone)), np.empty(len(gone))
    for each, from_ in zip(stiffness, begin, strict=True):
        from_.take(legs.leg, out=state, mode="clip")  # all indices are valid, and any other mode makes a copy
        state += np.multiply(gone, each, out=moved)
        np.maximum(state, -1.0, out=state)
        total += np.minimum(state, 1.0, out=state)
    total /= elements
    return total


def last_reversal(legs: MonotonicSegments, threshold: float) -> Array:
    """Return the position (n,) of the last reversal by more than `threshold`; nan before the first one.

    A reversal is confirmed only after the motion has returned by `threshold`, but it counts from its extreme on.
    """
    path = legs.path
    ends = [*legs.first[1:].tolist(), len(path) - 1]
    turned: list[int] = []
    extreme, reached, direction = float(path[0]), 0, 0.0
    for at, angle in zip(ends, path[ends].tolist(), strict=True):
        away = angle - extreme
        if direction == 0.0:
            if abs(away) <= threshold:
                continue
            direction = 1.0 if away > 0.0 else -1.0
        elif away * direction < 0.0:
            if -away * direction <= threshold:
                continue
            turned.append(reached)
            direction = -direction
        extreme, reached = angle, at
    out = np.full(len(path), np.nan)
    for begin, end in pairwise([*turned, len(path) - 1]):
        out[begin + 1 : end + 1] = path[begin]
    return out


def _after_each(
    start: float, maps: Array, after: Callable[[Array, Array], Array], apply: Callable[[Array, Array], Array]
) -> Array:
    """Return `start` and the value after each of m maps, shape (..., m + 1).

    Args:
        start: value before the first map.
        maps: coefficients of the maps, shape (k, ..., m).
        after: composes a map with its predecessor.
        apply: applies a map to a value.
    """
    count = maps.shape[-1]
    begin = np.full((*maps.shape[1:-1], 1), start)
    if count == 0:
        return begin
    length = math.isqrt(count - 1) + 1
    blocks = np.concatenate([maps, np.repeat(maps[..., -1:], -count % length, axis=-1)], axis=-1)
    blocks = np.ascontiguousarray(np.moveaxis(blocks.reshape(*maps.shape[:-1], -1, length), -1, 0))
    for one, other in pairwise(blocks):
        other[...] = after(other, one)
    begins = [begin[..., 0]]
    for number in range(blocks.shape[-1] - 1):
        begins.append(apply(blocks[-1][..., number], begins[-1]))
    inside = np.moveaxis(apply(np.moveaxis(blocks, 1, 0), np.stack(begins, axis=-1)), 0, -1)
    return np.concatenate([begin, inside.reshape(*maps.shape[1:-1], -1)[..., :count]], axis=-1)


def _affine(maps: Array, z: Array) -> Array:
    """Return a z + b."""
    return np.asarray(maps[0] * z + maps[1])


def _affine_after(second: Array, first: Array) -> Array:
    return np.stack([second[0] * first[0], second[0] * first[1] + second[1]])


def _clipped(maps: Array, z: Array) -> Array:
    """Return z + a, limited to b and c."""
    return np.asarray(np.minimum(np.maximum(z + maps[0], maps[1]), maps[2]))


def _clipped_after(second: Array, first: Array) -> Array:
    shift, low, high = second
    return np.stack([first[0] + shift, *np.minimum(np.maximum(first[1:] + shift, low), high)])
