"""The terms that a formula of what is left may have: what transmissions are known to have and the catalogue lacks.

A lever arm, an eccentric pulley or a friction that changes with the angle (products of the load or the direction with
harmonics of q_j or q_m) or at one place in the sheath, losses that grow with speed and load, sensors that saturate or
have a dead zone, and zeros or losses that follow the temperature. What is one thing is one term of one or more parts: a
wave with its phase, a zero with the temperature at which it is right.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from tsa_ctrl.identify.diagnosis.fitting.problem import Problem, orthonormal
from tsa_ctrl.identify.diagnosis.residual.features import direction_and_load
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model, RigidDrive, TendonSheath

# Of an angle: waves of any phase once and twice a turn, a straight line, a parabola
WAVES: tuple[tuple[str, ...], ...] = (("sin({0})", "cos({0})"), ("sin(2*{0})", "cos(2*{0})"))
COURSES: tuple[tuple[str, ...], ...] = (*WAVES, ("{0}",), ("{0}**2",))
FACTORS = ("", "*tau", "*sigma", "*sigma*abs(tau)")
LOADS = ("tau", "abs(tau)", "tau*abs(tau)", "tau**3", "sigma", "sigma*tau", "sigma*abs(tau)", "sigma*tau**2")
# What a dead zone takes of a torque: all of it up to a limit, and no more beyond
DEAD_ZONE = "(abs(tau + {0}) - abs(tau - {0}))"
DEAD_ZONES = (
    0.1,
    0.3,
)  # of the RMS torque, limits: below a tenth it is an offset of either sign, above most is cut off
# What is cut off a torque beyond a limit
CUT = "sign(tau)*(abs(tau) - {0} + abs(abs(tau) - {0}))"
CUTS = (0.05, 0.2)  # of the samples, that lie beyond it: of fewer no law shows, and more are no limit of a sensor
# Friction at one place: a bump as wide as the way between two of so many places over the range of the angle
PLACES, RUB = 9, "sigma*exp(-((q_j - {0})/{1})**2)"
SPEEDS = ("omega_j", "abs(omega_j)", "omega_j*abs(omega_j)", "omega_j*abs(tau)", "tau*abs(omega_j)")
WARMTH = ("*sigma", "*omega_j", "*tau")
ONE = "1"
FURTHER = 3.0  # times narrower or wider than at the beginning that a width may come out: beyond is another term


@dataclass(frozen=True)
class Term:
    """What enters a formula as one: parts with a coefficient each, and numbers within them.

    `inside` are those numbers to begin with, `low` and `high` how far they may go; a part has {0}, {1} for them.
    """

    parts: tuple[str, ...]
    inside: tuple[float, ...] = ()
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()

    def texts(self, numbers: Sequence[object]) -> tuple[str, ...]:
        """The parts with these numbers, or names of them, inside."""
        return tuple(part.format(*numbers) for part in self.parts)


def terms(problem: Problem, model: Model, predicted: Array) -> list[Term]:
    """The terms that these logs have the signals for. predicted: N*m, (n).

    Of both angles the joint's is taken, and the motor's as it would be on stiff tendons: their difference is the
    tendons' stretch, a second measurement of the torque that is to be explained, and a wave of one against a wave of
    the other takes up any cause.
    """
    frame = problem.frame
    rigid = isinstance(model, RigidDrive)
    angles = [("q_j", COURSES)] if rigid or frame.has("q_j") else []
    if isinstance(model, TendonSheath) and frame.has("q_j") and frame.has("q_m"):
        angles.append((f"{model.joint_pulley_radius / model.motor_pulley_radius:.6g}*q_j", WAVES))
    elif frame.has("q_m") and not rigid:
        angles.append(("q_m", COURSES))
    out = [Term((text,)) for text in (*LOADS, *SPEEDS)]
    scale = max(float(np.sqrt(np.mean(np.square(frame.target[problem.mask])))), 1e-9)
    out += [_wide(DEAD_ZONE, share * scale) for share in DEAD_ZONES]
    out += [_wide(CUT, float(np.quantile(np.abs(predicted[problem.mask]), 1.0 - share))) for share in CUTS]
    for angle, courses in angles:
        for course, factor in product(courses, FACTORS):
            out.append(Term(tuple(part.format(angle) + factor for part in course)))
    if frame.has("q_j"):
        low, high = np.quantile(frame.column("q_j")[problem.mask], (0.02, 0.98))
        width = float(high - low) / (PLACES - 1)
        if width > 0.0:
            for place in np.linspace(low, high, PLACES).tolist():
                ends = (place - width, width / FURTHER), (place + width, width * FURTHER)
                out.append(Term((RUB,), (place, width), *ends))
    if frame.has("temperature"):
        warm = f"(temperature - {float(np.mean(frame.column('temperature'))):.4g})"
        out += [Term((warm, ONE)), *(Term((warm + factor,)) for factor in WARMTH)]
    return out


def _wide(text: str, number: float) -> Term:
    return Term((text,), (number,), (number / FURTHER,), (number * FURTHER,))


# Terms of time that a formula of the residual may have: a step and a wave.
#
# An anchor slips, a tensioner oscillates, a fan starts: torque, friction or gain changes at a moment or periodically.
# One term of each kind is tried, at the moment or the frequency where it explains most. It describes these logs only,
# because other logs have other moments.

STEP = "(1 + tanh((t - {{0}})/{0:g}))"
WIDTH = 0.05  # s, of a step: shorter than a reversal, and long enough for its moment to be found by its slope
MOMENTS = 200  # of a log, at which a step is looked for: of 20 s every tenth of a second, twice the step's width
END = 0.1  # of a log, at either end: with less on one side of it a step is the fit of one stretch
WAVE = ("sin(6.283185*{{0}}*(t - {0:.12g}))", "cos(6.283185*{{0}}*(t - {0:.12g}))")
CYCLES = 3.0  # that a wave must have in a log: fewer are a drift
FASTEST = 3.0  # Hz: faster are ripples and ringing, which have terms of their own
MOST_OF_RATE = 0.4  # of the rate at which a long log is averaged: above half of it a wave has a slower alias
FINER = 5  # times that the way between two frequencies is halved: the phase at a log's end is then right to 3 degrees
PER_LINE = 4  # frequencies tried within the width of a line, so that the best one loses a twentieth at most
# Frequencies kept after the Fourier transform, which ignores the other terms: five lines with their neighbours
LIKELY = 40


def time_terms(
    problem: Problem, predicted: Array, fitting: NDArray[np.bool_], residual: Array, others: Array
) -> list[Term]:
    """Return the steps and waves that explain most of `residual` (n,) besides `others` (n, k); `predicted`: N*m."""
    frame = problem.frame
    sigma, load = direction_and_load(frame, predicted)
    t = frame.stack([run.signals.t for run in frame.runs])
    basis = orthonormal(others[fitting])
    left = residual[fitting] - basis @ (basis.T @ residual[fitting])

    def taken(columns: Array) -> float:
        """Return the part of the sum of squares that these columns (n, k) explain."""
        own = columns[fitting]
        own = orthonormal(own - basis @ (basis.T @ own))
        return float(np.sum((own.T @ left) ** 2))

    start = float(frame.runs[0].signals.t[0])
    seconds = max(float(t[part][-1] - t[part][0]) for part in frame.slices)
    lowest = CYCLES / seconds
    fastest = min(FASTEST, MOST_OF_RATE / frame.period)
    frequencies = np.arange(lowest, fastest, 1.0 / (PER_LINE * seconds)) if lowest < fastest else np.zeros(0)
    moments = np.concatenate([np.quantile(t[part], np.linspace(END, 1.0 - END, MOMENTS)) for part in frame.slices])
    moments = np.unique(moments)
    if len(moments) > MOMENTS:
        moments = moments[:: len(moments) // MOMENTS]
    apart = float(np.median(np.diff(moments))) if len(moments) > 1 else WIDTH
    whole = np.zeros(len(t))
    whole[fitting] = left
    out = []
    for factor, signal in (("", np.ones(len(t))), ("*sigma", sigma), ("*tau", load)):
        at = max(moments, key=lambda moment: taken((signal * (t > moment))[:, None]))
        step = STEP.format(WIDTH) + factor
        out.append(Term((step,), (float(at),), (float(at) - 2.0 * apart,), (float(at) + 2.0 * apart,)))
        if len(frequencies):
            likely = _likely(frequencies, whole * signal, t - start, frame.slices, frame.period)
            best = float(max(likely, key=lambda f: taken(_wave(signal, t - start, f))))
            for halves in range(1, FINER + 1):
                apart_now = 0.5**halves / (PER_LINE * seconds)
                near_by = (best, best - apart_now, best + apart_now)
                best = max(near_by, key=lambda f: taken(_wave(signal, t - start, f)))
            parts = tuple(part.format(start) + factor for part in WAVE)
            near = 0.5 / seconds
            out.append(Term(parts, (best,), (best - near,), (best + near,)))
    return out


def _likely(frequencies: Array, y: Array, t: Array, slices: Sequence[slice], period: float) -> Array:
    """Return the frequencies (Hz) that explain most of `y` (n,), by the Fourier transform of all logs."""
    if len(frequencies) <= LIKELY:
        return frequencies
    count = next_fast_len(2 * PER_LINE * max(part.stop - part.start for part in slices), real=True)
    place = np.rint(frequencies * count * period).astype(int)
    moved = np.zeros(len(place), dtype=complex)
    for part in slices:
        moved += np.fft.rfft(y[part], count)[place] * np.exp(-2.0j * np.pi * place / (count * period) * t[part.start])
    return np.asarray(frequencies[np.sort(np.argsort(-np.abs(moved), kind="stable")[:LIKELY])])


def _wave(signal: Array, t: Array, frequency: float) -> Array:
    """A wave of any phase as a factor of the signal, (n, 2)."""
    phase = 2.0 * math.pi * frequency * t
    return np.column_stack([signal * np.sin(phase), signal * np.cos(phase)])
