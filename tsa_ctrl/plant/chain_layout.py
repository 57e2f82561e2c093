"""How a tendon becomes a chain: what its rows hold, and where a sheath's bends put contacts and springs."""

from __future__ import annotations

import itertools
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

RIGID = 1e10  # N/m, contact without bristle
_MIN_LENGTH = 2e-5  # of the tendon, shortest spring: a bend at the very end of a sheath has nothing in between


class Row(IntEnum):
    """Rows of a chain, an array of shape (rows, contacts + 1); there is one spring more than contacts.

    The last column of a row of contacts has no contact and keeps: GRIP x of the whole tendon, PLACE and PLACE_OLD the
    joint end, FORCE and FORCE_OLD the motor end, MODE whether the solution was found in pieces, BRISTLE the energy
    that friction took on that way.
    """

    STIFFNESS = 0  # of springs, N/m
    LENGTH_SHARE = 1  # of springs, 1
    BEND_SHARE = 2  # of springs, 1: path length that bending adds
    BEND = 3  # of contacts, 1: share of the bending angle
    BRISTLE = 4  # of contacts, N/m
    PRELOAD = 5  # of springs, m: elongation at equal ends
    PLACE_OLD = 6  # of contacts, m
    FORCE_OLD = 7  # of contacts, N
    PLACE = 8
    FORCE = 9
    TENSION = 10  # of springs, N
    MODE = 11  # of contacts: 0 sticks, +1 slides to the motor, -1 to the joint
    GRIP = 12  # of contacts, tanh(x_i / 2)
    UPPER = 13  # of the elimination
    RIGHT = 14
    BY_MOTOR = 15


def build_chain(
    curve: NDArray[np.float64],
    elements: int,
    stiffness: float,
    length: float,
    series_length: float,
    bristle: float,
    series_at_joint: bool = False,
) -> NDArray[np.float64]:
    """Chain of one tendon at rest, shape (rows, elements + 1).

    curve (2, n): fraction of length, fraction of bending; stiffness E A in N; length, series_length (E A / k_s) in m,
    before the first or behind the last contact; bristle: N/m of the whole tendon on its liner, 0 for rigid.
    """
    chain = np.zeros((len(Row), elements + 1))
    edges = np.linspace(0.0, 1.0, elements + 1)
    bends = np.array([_bending(curve, a, b, last=b == 1.0) for a, b in itertools.pairwise(edges)])
    chain[Row.BEND, :elements] = [upper - lower for lower, upper in bends]
    places = np.array([_place(curve, 0.5 * (a + b), e) for (a, b), e in zip(bends, edges[:-1], strict=True)])
    lengths = np.diff(np.concatenate(([0.0], places, [1.0]))) * length
    lengths[-1 if series_at_joint else 0] += series_length
    lengths = np.maximum(lengths, _MIN_LENGTH * length)
    lengths *= (length + series_length) / lengths.sum()
    chain[Row.STIFFNESS] = stiffness / lengths
    chain[Row.LENGTH_SHARE] = lengths / (length + series_length)
    half = 0.5 * chain[Row.BEND, :elements]
    chain[Row.BEND_SHARE, :elements] += half
    chain[Row.BEND_SHARE, 1:] += half
    chain[Row.BRISTLE, :elements] = bristle * chain[Row.BEND, :elements]
    if bristle <= 0.0:
        chain[Row.BRISTLE, :elements] = np.where(chain[Row.BEND, :elements] > 0.0, RIGID, 0.0)
    return chain


def _bending(curve: NDArray[np.float64], start: float, end: float, last: bool) -> tuple[float, float]:
    """Bending up to the two ends of an element; a point bend on a border belongs to the element that it begins."""

    def before(place: float) -> float:
        i = int(np.searchsorted(curve[0], place, side="left"))
        if i == 0:
            return 0.0
        a, b = i - 1, min(i, curve.shape[1] - 1)
        width = curve[0, b] - curve[0, a]
        return float(curve[1, a] + (curve[1, b] - curve[1, a]) * ((place - curve[0, a]) / width if width > 0 else 1.0))

    return before(start), 1.0 if last else before(end)


def _place(curve: NDArray[np.float64], bending: float, otherwise: float) -> float:
    """Where along the length this much of the bending is reached."""
    i = int(np.searchsorted(curve[1], bending, side="left"))
    if i == 0:
        return max(otherwise, float(curve[0, 0]))
    a, b = i - 1, i
    rise = curve[1, b] - curve[1, a]
    place = curve[0, a] + (curve[0, b] - curve[0, a]) * ((bending - curve[1, a]) / rise if rise > 0.0 else 1.0)
    return max(otherwise, float(place))
