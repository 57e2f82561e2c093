"""A step and a wave in time are found with their moment and frequency. A drifting zero has neither.

The data are synthetic.
"""

from __future__ import annotations

import math
import re
import tomllib

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.identify.diagnosis.parameters.swinging import HALF_LOOP, NOMINAL, PERIOD, recorded
from tsa_ctrl.identify.diagnosis import Diagnosis, diagnose
from tsa_ctrl.identify.diagnosis.parameters.terms import _likely
from tsa_ctrl.identify.diagnosis.report.words import remarks

Array = NDArray[np.float64]
NOISE = 4e-3  # N*m
T = PERIOD * np.arange(6000)


def diagnosed(factor: Array | float, start: float = 0.0, zero: Array | float = 0.0) -> Diagnosis:
    """Return the diagnosis of a log of 24 s whose clock begins at `start` (s).

    `factor` (n,) multiplies the friction, and `zero` (n,) in N*m adds to the measured torque.
    """
    columns = recorded(np.random.default_rng(6), len(T), NOISE, lambda tau: tau + zero, factor)
    return diagnose({"log.csv": {**columns, "t": start + T}}, NOMINAL)


@pytest.mark.slow
@pytest.mark.parametrize("start", [0.0, pytest.param(1.7e9, marks=pytest.mark.soak)], ids=["from 0", "Unix time"])
def test_a_step_is_told_with_its_moment(start: float) -> None:
    """After 12.3 s an anchor slips and a quarter of the friction is lost."""
    found = diagnosed(np.where(T > 12.3, 0.75, 1.0), start)
    assert all(cause.alternatives for cause in found.causes)
    assert found.formula is not None
    assert found.formula.expression == "a*(1 + tanh((t - b)/0.05))*sigma"
    assert found.formula.gain > 0.8
    told = tomllib.loads(found.formula.toml())["effects"]["custom"]
    assert told["a"] == pytest.approx(-0.125 * HALF_LOOP, rel=0.05)
    assert told["b"] - start == pytest.approx(12.3, abs=0.1)
    assert "a controller cannot use it" in " ".join(remarks(found))


@pytest.mark.slow
def test_a_wave_is_told_with_its_frequency() -> None:
    """The pretension oscillates at 0.63 Hz."""
    found = diagnosed(1.0 + 0.2 * np.sin(2.0 * np.pi * 0.63 * T + 1.0))
    assert found.formula is not None
    assert found.formula.expression.startswith("a*sin(6.283185*b*(t - 0))*sigma + c*cos(")
    assert found.formula.constants["b"].value == pytest.approx(0.63, rel=0.01)
    a, c = (found.formula.constants[name].value for name in "ac")
    assert math.hypot(a, c) == pytest.approx(0.2 * HALF_LOOP, rel=0.05)


@pytest.mark.slow
def test_a_zero_that_walks_has_no_rhythm() -> None:
    found = diagnosed(1.0, zero=np.cumsum(np.random.default_rng(8).normal(0.0, 8e-4, len(T))))
    assert found.formula is None or "t" not in found.formula.expression.replace("tau", "").replace("tanh", "")


@pytest.mark.parametrize("factor", [1.0, np.nan])
def test_of_an_hours_frequencies_few_are_tried_and_the_best_is_among_them(factor: float) -> None:
    """The reference is an exact sum over all samples of two logs with a gap between them.

    The regressor is constant or a direction.
    """
    rng = np.random.default_rng(4)
    period, hidden = 0.05, 0.7123
    t = period * np.concatenate([np.arange(36_000), 40_000 + np.arange(30_000)])
    slices = [slice(0, 36_000), slice(36_000, 66_000)]
    signal = np.full(len(t), factor) if np.isfinite(factor) else np.sign(np.sin(0.9 * t) + 0.2)
    y = signal * (signal * np.sin(6.283185 * hidden * t + 0.4) + rng.normal(0.0, 3.0, len(t)))
    frequencies = np.arange(3.0 / 1800.0, 3.0, 1.0 / (4.0 * 1800.0))
    found = _likely(frequencies, y, t, slices, period)
    near = frequencies[np.abs(frequencies - hidden) < 0.002]
    sums = [abs(np.sum(y * np.exp(-2j * np.pi * f * t))) for f in near]
    assert len(frequencies) > 20_000
    assert len(found) <= 40
    assert near[int(np.argmax(sums))] in found


@pytest.mark.parametrize(
    ("zero", "words"),
    [(5e-3 * T, r"\*t\b"), (0.12 * np.exp(-T / 4.0), r"exp\(\(0 - t\)/")],
    ids=["line", "exponential"],
)
def test_a_steady_change_is_a_line_or_an_exponential(zero: Array, words: str) -> None:
    found = diagnosed(1.0, zero=zero).formula
    assert found is not None
    assert re.search(words, found.expression)
    assert "tanh" not in found.expression
    assert found.gain > 0.9
