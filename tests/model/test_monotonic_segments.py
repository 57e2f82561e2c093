"""The memory of friction and backlash along a path, compared with loops over the samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.monotonic_segments import MonotonicSegments, dahl, last_reversal, maxwell_slip

counted = arrays.arrays(np.int64, st.integers(1, 80), elements=st.integers(-4, 4))  # rests, and returns to a place
sharp = arrays.arrays(np.float64, st.integers(1, 80), elements=st.floats(-1.0, 1.0, allow_subnormal=False))
paths = st.one_of(counted.map(lambda counts: 0.1 * np.cumsum(counts)), sharp)
starts = st.sampled_from([-1.0, 0.0, 1.0])


def dahl_by_steps(path: Array, distance: float, start: float) -> Array:
    """Integrate dz/ds = (1 - sign(ds) z)/q_p over the step of each sample."""
    z = [start]
    for step in np.diff(path):
        way = math.copysign(1.0, step)
        z.append(way + (z[-1] - way) * math.exp(-abs(step) / distance))
    return np.array(z)


def maxwell_by_steps(path: Array, distance: float, elements: int, start: float) -> Array:
    """Return the mean state of springs that slip at +-1, integrated over the step of each sample."""
    states, z = [start] * elements, [start]
    for step in np.diff(path):
        stiffness = [elements / (distance * (k + 1)) for k in range(elements)]
        states = [min(1.0, max(-1.0, state + step * each)) for state, each in zip(states, stiffness, strict=True)]
        z.append(sum(states) / elements)
    return np.array(z)


def reversals_by_steps(path: Array, threshold: float) -> Array:
    """Return the last reversal for each sample: the extreme from which the path returned by more than `threshold`.

    It applies from the sample after the extreme on. It is NaN before the first reversal.
    """
    out = np.full(len(path), math.nan)
    extreme, since, direction = path[0], 0, 0
    for i, place in enumerate(path):
        away = place - extreme
        if direction == 0 and abs(away) > threshold:
            direction = 1 if away > 0.0 else -1
        if direction == 0:
            continue
        if away * direction >= 0.0:
            extreme, since = place, i
        elif -away * direction > threshold:
            out[since + 1 :] = extreme
            direction = -direction
            extreme, since = place, i
    return out


@given(paths, st.floats(0.01, 3.0), starts)
def test_dahl(path: Array, distance: float, start: float) -> None:
    """The closed form over each leg equals the sum of its steps."""
    np.testing.assert_allclose(
        dahl(MonotonicSegments.of(path), distance, start), dahl_by_steps(path, distance, start), atol=1e-12
    )


@given(paths, st.floats(0.01, 3.0), st.integers(1, 8), starts)
def test_maxwell_slip(path: Array, distance: float, elements: int, start: float) -> None:
    """An element that slips continues to slip to the end of its leg."""
    found = maxwell_slip(MonotonicSegments.of(path), distance, elements, start)
    np.testing.assert_allclose(found, maxwell_by_steps(path, distance, elements, start), atol=1e-11)


@given(paths, st.sampled_from([0.0, 0.05, 0.15, 0.25, 1.0]))
def test_last_reversal(path: Array, threshold: float) -> None:
    """The values are equal bit for bit, because they are places of the path."""
    np.testing.assert_array_equal(
        last_reversal(MonotonicSegments.of(path), threshold), reversals_by_steps(path, threshold)
    )


@pytest.mark.parametrize("legs", [2, 3, 16, 17, 1000])
def test_state_passes_through_many_legs(legs: int) -> None:
    """The state at the last sample depends on the first one for any number of composed blocks."""
    rng = np.random.default_rng(legs)
    path = np.cumsum(rng.uniform(0.1, 1.0, legs) * (-1.0) ** np.arange(legs)) * 1e-3
    found = dahl(MonotonicSegments.of(path), 10.0, 1.0), maxwell_slip(MonotonicSegments.of(path), 10.0, 4, 1.0)
    np.testing.assert_allclose(found[0], dahl_by_steps(path, 10.0, 1.0), atol=1e-12)
    np.testing.assert_allclose(found[1], maxwell_by_steps(path, 10.0, 4, 1.0), atol=1e-12)


def test_a_leg_ends_where_the_path_turns_and_goes_on_through_a_standstill() -> None:
    """Both samples at the top belong to the leg upward."""
    legs = MonotonicSegments.of(np.array([0.0, 0.0, 1.0, 1.0, 2.0, 2.0, 1.0, 1.5]))
    assert legs.leg.tolist() == [0, 0, 0, 0, 0, 0, 1, 2]
