"""Functions with memory, compared with the matrix exponential, closed forms and the loops of the blind benchmark."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import expm

from tests.blind import memory as blind
from tsa_ctrl.model.expression import parse
from tsa_ctrl.model.filters import Memories, Memory

Array = NDArray[np.float64]
EVERY = [Memory("lag", (0.3,)), Memory("ring", (4.0, 0.1)), Memory("ring", (2.0, 1.0)), Memory("dahl", (0.4,))]
IDS = [f"{memory.kind} {memory.constants}" for memory in EVERY]


def course(seed: int = 1, uneven: bool = True) -> tuple[Array, Array]:
    """Return t (s) and x, 400 samples each, with steps of half to twice 10 ms, or of 10 ms."""
    rng = np.random.default_rng(seed)
    steps = 0.01 * (rng.uniform(0.5, 2.0, 400) if uneven else np.ones(400))
    t = np.cumsum(steps)
    return t, np.sin(3.0 * t) + 0.4 * np.sin(17.0 * t) + 0.2


def system(memory: Memory) -> tuple[Array, Array]:
    """Return A and b of dz/dt = A z + b x. The first component of z is the value."""
    if memory.kind == "lag":
        (constant,) = memory.constants
        return np.array([[-1.0 / constant]]), np.array([1.0 / constant])
    w = 2.0 * math.pi * memory.constants[0]
    return np.array([[0.0, 1.0], [-w * w, -2.0 * memory.constants[1] * w]]), np.array([0.0, w * w])


def reference(memory: Memory, x: Array, t: Array) -> Array:
    """Return the reference values (n,): the matrix exponential of each step with x as a ramp.

    The reference of the hysteresis is the loop of the blind benchmark.
    """
    if memory.kind == "dahl":
        return np.asarray(blind.bristle(x, memory.constants[0], 0.0))
    a, b = system(memory)
    n = len(a)
    z = np.zeros(n)
    z[0] = x[0]
    values = [x[0]]
    for i in range(1, len(t)):
        step = t[i] - t[i - 1]
        whole = np.zeros((n + 2, n + 2))
        whole[:n, :n], whole[:n, n], whole[n, n + 1] = a, b, 1.0
        z = (expm(whole * step) @ np.concatenate([z, [x[i - 1], (x[i] - x[i - 1]) / step]]))[:n]
        values.append(z[0])
    return np.array(values)


@pytest.mark.parametrize("memory", EVERY, ids=IDS)
def test_over_a_log_of_uneven_steps_it_is_exact(memory: Memory) -> None:
    t, x = course()
    np.testing.assert_allclose(memory.over(x, t), reference(memory, x, t), atol=1e-12)


@pytest.mark.parametrize("memory", EVERY, ids=IDS)
def test_cycle_by_cycle_it_is_the_same_as_over_the_log(memory: Memory) -> None:
    """Other calls have no influence. A cycle that accepts no value adds its time to the next step."""
    t, x = course()
    rng = np.random.default_rng(2)
    kept = np.sort(rng.choice(len(t), 300, replace=False))
    (part,) = (memories := Memories((memory,))).parts
    found = []
    for i in range(len(t)):
        memories.begin(t[i] - t[i - 1] if i else 0.01)
        for other in rng.normal(size=3):
            part.value(other)
        if i in kept:
            found.append(part.value(x[i]))
            memories.accept()
        part.value(math.nan)
    np.testing.assert_allclose(found, reference(memory, x[kept], t[kept]), atol=1e-12)
    memories.reset()
    memories.begin(0.01)
    assert part.value(0.7) == (0.0 if memory.kind == "dahl" else 0.7)


def test_what_is_no_number_is_not_accepted() -> None:
    (part,) = (memories := Memories((Memory("lag", (0.1,)),))).parts
    for x in (1.0, math.nan, math.inf, 1.0):
        memories.begin(0.01)
        assert part.value(1.0) == 1.0
        part.value(x)
        memories.accept()


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.tuples(st.floats(1e-6, 1e3), st.floats(-1e6, 1e6)), min_size=2, max_size=20),
    st.floats(1e-6, 1e6),
    st.floats(1e-3, 1e5),
    st.floats(1e-6, 1.0),
    st.floats(1e-12, 1e12),
)
def test_whatever_the_steps_it_stays_bounded(
    rows: list[tuple[float, float]], constant: float, frequency: float, damping: float, width: float
) -> None:
    steps, x = np.array(rows).T
    t, most = np.cumsum(steps), float(np.max(np.abs(x))) * (1.0 + 1e-9) + 1e-9
    assert np.all(np.abs(Memory("lag", (constant,)).over(x, t)) <= most)
    assert np.all(np.abs(Memory("dahl", (width,)).over(x, t)) <= 1.0)
    # Each ramp can add its whole amplitude to the oscillation that persists.
    assert np.all(np.abs(Memory("ring", (frequency, damping)).over(x, t)) <= 4.0 * len(x) * most)


def test_a_formula_runs_its_memories_over_a_log() -> None:
    t, x = course()
    program = parse("2*lag(tau + 1, T) - ring(tau, 4, d)*dahl(3, 1)", ("tau",), {"T": 0.3, "d": 0.1}, "x")
    assert program.memories == (Memory("lag", (0.3,)), Memory("ring", (4.0, 0.1)), Memory("dahl", (1.0,)))

    np.testing.assert_allclose(program.over([x], t), 2.0 * reference(EVERY[0], x + 1.0, t), atol=1e-12)
