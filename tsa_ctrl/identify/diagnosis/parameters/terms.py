"""List the terms that a formula of the residual may have: known effects of transmissions that the catalogue lacks.

- Lever arms, eccentric pulleys and friction that changes with the angle are products of the load or the direction with
  harmonics of q_j or q_m.
- Friction may act at one place in the sheath.
- Losses may grow with speed and load.
- Sensors may saturate or have a dead zone.
- Zeros or losses may depend on temperature.

One physical effect is one term of one or more parts. Examples are a wave with its phase, and a zero with the
temperature at which it is correct.
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
from tsa_ctrl.identify.diagnosis.rivals.sensor import DEAD_ZONES
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model, RigidDrive, TendonSheath

# Functions of an angle: waves of any phase once and twice per turn
WAVES: tuple[tuple[str, ...], ...] = (("sin({0})", "cos({0})"), ("sin(2*{0})", "cos(2*{0})"))
# Functions of an angle: the waves, a straight line and a parabola
COURSES: tuple[tuple[str, ...], ...] = (*WAVES, ("{0}",), ("{0}**2",))
FACTORS = ("", "*tau", "*sigma", "*sigma*abs(tau)")
LOADS = ("tau", "abs(tau)", "tau*abs(tau)", "tau**3", "sigma", "sigma*tau", "sigma*abs(tau)", "sigma*tau**2")
# Effect of a dead zone on a torque: it removes the whole torque up to a limit, and a constant beyond
DEAD_ZONE = "(abs(tau + {0}) - abs(tau - {0}))"
CUT = "sign(tau)*(abs(tau) - {0} + abs(abs(tau) - {0}))"  # Torque beyond a limit, which saturation removes
CUTS = (0.05, 0.2)  # shares of the samples beyond the limit: fewer show no law, and more are not the limit of a sensor
# Friction at one place: a bump as wide as the distance between two of PLACES positions over the range of the angle
PLACES, RUB = 9, "sigma*exp(-((q_j - {0})/{1})**2)"
SPEEDS = ("omega_j", "abs(omega_j)", "omega_j*abs(omega_j)", "omega_j*abs(tau)", "tau*abs(omega_j)")
WARMTH = ("*sigma", "*omega_j", "*tau")
ONE = "1"
FURTHER = 3.0  # factor by which a width may differ from its start value: beyond that, it is another term


@dataclass(frozen=True)
class Term:
    """One term of a formula: its parts, each with a coefficient, and its inner constants.

    Attributes:
        parts: templates of the parts, with {0}, {1} for the inner constants.
        inside: start values of the inner constants.
        low: lower bounds of the inner constants.
        high: upper bounds of the inner constants.
    """

    parts: tuple[str, ...]
    inside: tuple[float, ...] = ()
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()

    def texts(self, numbers: Sequence[object]) -> tuple[str, ...]:
        """Return the parts with these values or names of the inner constants."""
        return tuple(part.format(*numbers) for part in self.parts)


def terms(problem: Problem, model: Model, predicted: Array) -> list[Term]:
    """Return the terms for which these logs have the signals; `predicted` is the predicted torque, (n,) in N*m.

    If a tendon-sheath drive has both angles, the joint angle is used, together with the motor angle that stiff tendons
    would have. The difference of the measured angles is the tendon elongation, which is a second measurement of the
    torque to be explained. With both measured angles, the difference of two waves could replace any cause.
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


# Terms of time that a formula of the residual may have: a line, an exponential, a step and a wave.
#
# Torque, friction or gain may change steadily, at one moment or periodically, for example if an amplifier drifts, a
# liner warms up, an anchor slips, or a tensioner oscillates. A step and a wave are tried at the moment and the
# frequency at which they explain most. Such a term describes only these logs, because other logs have other moments.

LINE = "(t - {0:.12g})"  # "t" if the log starts at 0
SETTLING = "exp(({0:.12g} - t)/{{0}})"
# Time constant of an exponential as shares of a log: the start, the shortest with several samples, and the longest that
# differs from a line
SETTLES = (0.3, 0.03, 1.0)
STEP = "(1 + tanh((t - {{0}})/{0:g}))"
WIDTH = 0.05  # s, width of a step: shorter than a reversal, and long enough to find the time of the step by its slope
# Times in a log at which a step is tried: in a log of 20 s every tenth of a second, twice the width of the step
MOMENTS = 200
END = 0.1  # share of a log at either end: a step with less data on one side fits only that part of the log
WAVE = ("sin(6.283185*{{0}}*(t - {0:.12g}))", "cos(6.283185*{{0}}*(t - {0:.12g}))")
CYCLES = 3.0  # least number of periods of a wave, or of time constants of a lag, in a log: fewer are drift
FASTEST = 3.0  # Hz: faster oscillations are ripple and ringing, which have separate terms
# Highest frequency as a share of the score rate: above half of that rate, a wave appears as a slower alias
MOST_OF_RATE = 0.4
FINER = 5  # halvings of the distance between two frequencies: the phase at a log's end is then correct to 3 degrees
PER_LINE = 4  # number of frequencies tried within the width of a line: the best one loses a twentieth at most
# Frequencies kept after the Fourier transform, which ignores the other terms: five lines with their neighbours
LIKELY = 40


def time_terms(
    problem: Problem, predicted: Array, fitting: NDArray[np.bool_], residual: Array, others: Array
) -> list[Term]:
    """Return the changes in time that explain most of the residual in addition to other columns.

    One line, exponential, step and wave are returned for each of torque, friction and gain. The wave is omitted if the
    logs are too short.

    Args:
        problem: the logs with the noise model.
        predicted: predicted torque, (n,) N*m.
        fitting: samples to fit on, (n,).
        residual: residual of the model, (n,) N*m.
        others: columns that are fitted together with the terms, (n, k).
    """
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
        level = (ONE,) if not factor else ()  # a zero that drifts is wrong from the start
        begin, low, high = (share * seconds for share in SETTLES)
        out.append(Term(((LINE.format(start) if start else "t") + factor, *level)))
        out.append(Term((SETTLING.format(start) + factor, *level), (begin,), (low,), (high,)))
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
    """Return sine and cosine of a frequency (Hz) times the signal, (n, 2)."""
    phase = 2.0 * math.pi * frequency * t
    return np.column_stack([signal * np.sin(phase), signal * np.cos(phase)])
