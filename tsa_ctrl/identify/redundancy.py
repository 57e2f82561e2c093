"""Compare redundant columns of a log: two columns that follow from each other must agree in scale, sign and time.

The pairs are angle and velocity, velocity and acceleration, the two ends of the transmission, and command and torque.
One function compares each pair as band-limited signals. Let r be the correlation and s the ratio of the RMS values. The
scale then lies between r s (least squares with all noise in the second column) and s / r (all noise in the first). A
factor counts only if this whole range is beyond its limit, so noise alone never rejects a log.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.units import in_other_units
from tsa_ctrl.model.signals import low_pass, zero_phase_derivative

Array = NDArray[np.float64]

BAND = 10.0  # Hz, band in which two columns are compared: a factor of units is visible in any motion
SAMPLES = 60_000  # most samples of a comparison; a longer log is reduced by averaging
LEAST_CORRELATION = 0.9  # below this, two columns are not the same motion, and their scale is meaningless
LONGEST_SHIFT = 0.5  # s, largest time shift that is tried
NOTED = 1.02  # factor above which a difference is reported
WRONG = 1.5  # factor above which two columns of one shaft, or a velocity and its acceleration, cannot both be right
FAR = 3.0  # the same factor for two columns with the drive or the tendons between them
NOTED_SHIFT, WRONG_SHIFT = 0.02, 0.2  # s: the delay of a filter is reported, and a shift too long for one is rejected
FEWEST_TURNS = 4  # least number of crossings of the mean for which time shift and scale are separately identifiable
CERTAIN = 0.99  # correlation above which a shift in time is reported

UNITS = {180.0 / math.pi: "degrees", 30.0 / math.pi: "rpm", 1000.0: "mrad"}  # number of units in one rad or rad/s
NEAR = 1.25  # factor either way within which a unit is recognised


@dataclass(frozen=True)
class Agreement:
    """Agreement of a second column with a first one: its scale is `low` to `high`, and its delay is `shift` s."""

    correlation: float
    low: float
    high: float
    shift: float
    turns: int  # number of times the first column crosses its mean

    @property
    def scale(self) -> float:
        """Return the most likely scale; it is negative if the columns have opposite signs."""
        return math.copysign(math.sqrt(self.low * self.high), self.correlation)

    def beyond(self, factor: float) -> bool:
        """Return True if the whole range of the scale is above `factor` or below its inverse."""
        return self.low > factor or self.high < 1.0 / factor


def compare(first: Array, second: Array, period: float) -> Agreement | None:
    """Return the agreement of `second` with `first`; None if one is constant or they are not the same motion."""
    step = max(1, -(-len(first) // SAMPLES))
    n = len(first) // step * step
    x, y = (values[:n].reshape(-1, step).mean(axis=1) for values in (first, second))
    x, y, period = x - x.mean(), y - y.mean(), period * step
    turns = int(np.count_nonzero(np.diff(np.signbit(x))))
    shift = _shift(x, y, int(LONGEST_SHIFT / period)) if turns >= FEWEST_TURNS else 0
    x, y = (x[: len(x) - shift], y[shift:]) if shift >= 0 else (x[-shift:], y[:shift])
    xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
    if xx <= 0.0 or yy <= 0.0:
        return None
    correlation = xy / math.sqrt(xx * yy)
    if abs(correlation) < LEAST_CORRELATION:
        return None
    ratio = math.sqrt(yy / xx)
    return Agreement(correlation, abs(correlation) * ratio, ratio / abs(correlation), shift * period, turns)


def _shift(x: Array, y: Array, most: int) -> int:
    """Return the delay of `y` in samples, of either sign, limited to `most` and to a quarter of the log."""
    most = min(len(x) // 4, most)
    size = 1 << (2 * len(x) - 1).bit_length()
    circular = np.fft.irfft(np.fft.rfft(y, size) * np.conj(np.fft.rfft(x, size)), size)
    both = np.concatenate([circular[len(circular) - most :], circular[: most + 1]])  # of shifts from -most to most
    return int(np.argmax(np.abs(both))) - most


def check_columns(label: str, columns: Mapping[str, Array], period: float) -> list[str]:
    """Compare every pair of columns for which no model is required, and return remarks.

    Raises:
        UsageError: Two columns disagree by a factor, a sign or a time that cannot be right.
    """
    remarks = []
    for joint in ("j", "m"):
        angle, velocity, acceleration = (columns.get(f"{name}_{joint}") for name in ("q", "omega", "acceleration"))
        names = f"dq_{joint}/dt", f"omega_{joint}", f"d(omega_{joint})/dt", f"acceleration_{joint}"
        if angle is not None and velocity is not None:
            pair = zero_phase_derivative(angle, period, BAND), low_pass(velocity, period, BAND)
            remarks += judge(label, names[0], names[1], compare(*pair, period), WRONG, signed=False)
        if acceleration is not None:
            rate = velocity if angle is None and velocity is not None else None
            if rate is None and angle is not None:
                rate = zero_phase_derivative(angle, period, BAND)
            if rate is not None:
                pair = zero_phase_derivative(rate, period, BAND), low_pass(acceleration, period, BAND)
                remarks += judge(label, names[2], names[3], compare(*pair, period), WRONG)
    if "tau_m_cmd" in columns:
        pair = low_pass(columns["tau_m_cmd"], period, BAND), low_pass(columns["tau_m"], period, BAND)
        remarks += judge(label, "tau_m_cmd", "tau_m", compare(*pair, period), FAR)
    return remarks


def check_ends(label: str, columns: Mapping[str, Array], period: float, ratio: float) -> None:
    """Compare the motion of motor and joint; `ratio` is r_J / r_M.

    The tendons between the two ends elongate, so only a factor that no stiffness explains is an error. A reversed end
    is detected by another check, which uses the energy.

    Raises:
        UsageError: The two ends disagree by a factor that no stiffness explains.
    """
    for name, derive in (("q", zero_phase_derivative), ("omega", low_pass)):
        joint, motor = f"{name}_j", f"{name}_m"
        if joint in columns and motor in columns:
            pair = derive(ratio * columns[joint], period, BAND), derive(columns[motor], period, BAND)
            judge(label, f"{joint} times r_J/r_M", motor, compare(*pair, period), FAR, signed=False)


def judge(
    label: str,
    first: str,
    second: str,
    found: Agreement | None,
    wrong: float,
    signed: bool = True,
) -> list[str]:
    """Return remarks on a pair of columns; raise UsageError if they cannot both be right.

    Args:
        label: The log.
        first: The first column, or the signal derived from it.
        second: The column that must agree with it.
        found: The agreement of both, or None.
        wrong: The factor above which they cannot both be right.
        signed: True if a reversed sign is an error here; otherwise another check detects it.
    """
    if found is None or (signed and found.turns < FEWEST_TURNS):
        return []
    where = f"{label}: column {column_of(first)} and column {second} disagree"
    factor = abs(found.scale)
    if found.beyond(wrong):
        raise UsageError(f"{where}: {second} is {in_words(factor)} times {first}; {likely(first, second, factor)}")
    if signed and found.correlation < 0.0:
        raise UsageError(f"{where}: {second} runs against {first}: one of the two is reversed; turn its sign")
    late = f"{second} is {1e3 * abs(found.shift):.3g} ms {'later' if found.shift > 0.0 else 'earlier'} than {first}"
    if abs(found.shift) > WRONG_SHIFT and abs(found.correlation) > CERTAIN:
        raise UsageError(f"{where}: {late}; align the two columns, or leave one out")
    if found.turns < FEWEST_TURNS:
        return []
    remarks = [f"column {second} is {factor:.3f} times {first}"] if found.beyond(NOTED) else []
    if abs(found.shift) > NOTED_SHIFT and abs(found.correlation) > CERTAIN:
        remarks.append(f"column {late}")
    return remarks


def column_of(text: str) -> str:
    """Return the column in a text such as dq_j/dt, "q_j times r_J/r_M" or "simulated tau_j"."""
    return text.removeprefix("simulated ").removeprefix("d").strip("()").partition(")")[0].partition("/")[0].split()[0]


def in_words(factor: float) -> str:
    """Return a factor as text."""
    return "180/pi" if _near(factor, 180.0 / math.pi) else f"{factor:.4g}"


def likely(first: str, second: str, factor: float) -> str:
    """Return the unit that would explain the factor by which `second` exceeds `first`, and the remedy."""
    over = factor > 1.0
    larger, smaller = (second, column_of(first)) if over else (column_of(first), second)
    size = factor if over else 1.0 / factor
    proper = {"t": "N*m", "q": "rad", "o": "rad/s", "a": "rad/s^2"}[larger[0]]
    unknown = f"one of them has another unit, gain or source: convert it to {proper}"
    if second.startswith("tau"):
        fitting = in_other_units(size / NEAR, size * NEAR)
        return f"{larger} seems to be {fitting}: use N*m" if fitting.startswith("in ") else unknown
    if _near(size, 1000.0) and first.startswith("d") and over:
        return "t seems to be in milliseconds: use s"
    for known, unit in UNITS.items():
        if _near(size, known):
            per = "/s" if unit != "rpm" and proper.endswith("/s") else ""
            return f"{larger} seems to be in {unit}{per}: use {proper}"
    if _near(size, 2.0 * math.pi):
        return f"{smaller} seems to be in revolutions: convert it"
    if size > 10.0:
        return f"{larger} seems to be in counts or mm, or a column of another log: convert it to {proper}"
    return unknown


def _near(size: float, factor: float) -> bool:
    return 1.0 / NEAR < size / factor < NEAR
