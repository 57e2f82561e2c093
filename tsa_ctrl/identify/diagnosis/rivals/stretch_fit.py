"""Fit effects of the catalogue to the measured tendon elongation by least squares.

In addition to the effects, the fit has these free parameters:

- the compliances for T3 - T1 and T4 - T2, within [uncertainty] of the model file;
- motor friction that recalibration hides from the torque, within the same [uncertainty];
- the zero and the drift of each log;
- the ratio of the pulley radii.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.rivals.stretch import (
    LIKELY,
    Seen,
    deviation,
    ends_of,
    of_the_file,
    pinv,
    seen_of,
    solved,
)
from tsa_ctrl.identify.diagnosis.selection.forward import Selection
from tsa_ctrl.model.effects.lever import State
from tsa_ctrl.model.effects.search import Scales, Value, Variant
from tsa_ctrl.model.effects.specification import Specification
from tsa_ctrl.model.functions import ARRAYS, Array
from tsa_ctrl.model.signals import hold_direction
from tsa_ctrl.model.stretch import compliances

ONCE = "pulley_slip"  # an effect that occurs once, in a single log
BASE = 3  # columns with a prior from the model file: T3 - T1, T4 - T2 and motor friction
LEAST_NEW = 1e-10  # least share of an effect's squares that the other columns do not reproduce: less is rounding


@dataclass(frozen=True)
class Term:
    """A variant of an effect at fixed shape coordinates."""

    spec: Specification
    variant: Variant
    run: int | None  # number of the log in which it acts; None if it acts in all logs
    shape: tuple[float, ...]  # its coordinates without the amplitude

    @property
    def name(self) -> str:
        return self.spec.name

    def values(self, amplitude: float) -> dict[str, Value]:
        """Return the parameters of the effect at this amplitude."""
        return self.variant.parameters(np.array([amplitude, *self.shape]))

    def at(self, place: float) -> Term:
        """Return the same term with `place` as its shape coordinate."""
        return replace(self, shape=(place,))


@dataclass(frozen=True)
class StretchFit:
    """Result of a fit with k free parameters to m samples.

    The order of the parameters is: c_M, c_J, motor friction, zero and drift of each log, ratio of the pulley radii,
    amplitudes of the terms.
    """

    terms: tuple[Term, ...]
    noise: float  # m, standard deviation
    rest: Array  # (m,) in m, residual
    beside: float  # 1, sum of squared deviations from the values of the model file, in standard deviations
    amplitudes: Array  # (terms,)
    columns: Array  # (m, k)
    gram: Array  # (k, k), matrix of the normal equations, with the prior from the model file

    @property
    def squares(self) -> Array:
        return np.square(self.rest / self.noise)

    @property
    def cost(self) -> float:
        return float(self.squares.sum()) + self.beside

    @property
    def deviations(self) -> Array:
        """Return the standard deviations of the amplitudes, (terms,)."""
        sizes = np.sqrt(np.maximum(np.diag(self.gram), 1e-300))
        variances = np.diag(np.linalg.pinv(self.gram / np.outer(sizes, sizes), rcond=1e-12)) / sizes**2
        return np.asarray(np.sqrt(np.maximum(variances[len(variances) - len(self.terms) :], 0.0)))


@dataclass(frozen=True)
class Stretch:
    """Measured tendon elongation of some logs at m samples, and the data that all fits share."""

    seen: Seen
    ends: Array  # (m, 2), N, T3 - T1 and T4 - T2
    direction: Array  # (m, 1), 1, direction of motion, averaged over each score sample
    times: tuple[Array, ...]  # s, times of each log's samples
    places: tuple[NDArray[np.int64], ...]  # indices of each log's samples among the m samples
    starts: tuple[float, ...]  # s, time of each log's first sample
    joint_radius: float  # m
    softness: Array  # c_M and c_J of the model, m/N
    file: tuple[Array, Array]  # prior equations from `of_the_file`, with a row for the motor friction

    @classmethod
    def of(cls, chosen: Selection) -> Stretch | None:
        """Return the elongation in the logs of a selection, under its causes.

        The result is None if a log lacks an angle or if the drive has no tendons.
        """
        problem, fitted = chosen.problem, chosen.fitted
        seen = seen_of(problem)
        if seen is None:
            return None
        ends, model = ends_of(problem, fitted, fitted.point)
        times, places, before = [], [], 0
        for run, part in zip(problem.frame.runs, problem.frame.slices, strict=True):
            used = problem.mask[part]
            times.append(run.average(run.signals.t)[used])
            places.append(np.arange(before, before + len(times[-1])))
            before += len(times[-1])
        starts = tuple(float(run.signals.t[0]) for run in problem.frame.runs)
        moving = [hold_direction(run.signals.omega_j) for run in problem.frame.runs]
        direction = problem.frame.stack(moving)[problem.mask, None]
        soft = np.array(compliances(model))
        hidden = max(model.friction_angle_uncertainty, model.pretension_uncertainty) / LIKELY
        hidden *= soft[0] * 2.0 * model.pretension * math.tanh(model.friction_angle)  # m, by motor friction
        wanted, told = of_the_file(model, shaped=False)
        friction = np.array([0.0, 0.0, 1.0 / max(hidden, 1e-9)])
        file = np.append(wanted, 0.0), np.vstack([np.pad(told, ((0, 0), (0, 1))), friction])
        radius = model.joint_pulley_radius
        return cls(seen, ends, direction, tuple(times), tuple(places), starts, radius, soft, file)

    def terms(self, spec: Specification, scales: Scales) -> list[Term]:
        """Return a term for each starting point of each variant of an effect.

        An effect that occurs once gets separate terms for each log.
        """
        if spec.name != ONCE:
            return [Term(spec, v, None, start[1:]) for v in spec.search(spec.name, scales) for start in v.starts]
        found = []
        for run, times in enumerate(self.times):
            if len(times):
                own = replace(scales, begin=self.starts[run], seconds=float(times[-1]) - self.starts[run])
                found += [Term(spec, v, run, start[1:]) for v in spec.search(spec.name, own) for start in v.starts]
        return found

    def column(self, term: Term) -> Array:
        """Return the elongation that the term adds at amplitude 1, (m,) in m."""
        effect = term.spec.build(term.values(1.0))
        column = np.zeros(len(self.seen.stretch))
        for run, (t, part, start) in enumerate(zip(self.times, self.places, self.starts, strict=True)):
            if term.run in (None, run):
                ends = self.ends[part, 0], self.ends[part, 1]
                column[part] = effect.lengthens(ARRAYS, ends, self.joint_radius, _at(t, start))
        return column

    def fit(self, terms: Sequence[Term], noise: float | None = None, *, whatever_stiffness: bool = False) -> StretchFit:
        """Return the fit of these terms to the elongation.

        Args:
            terms: terms to fit.
            noise: standard deviation, m; None estimates it from the residual of a fit without the prior.
            whatever_stiffness: True to ignore the sum of the compliances that follows from the model file.
        """
        columns = np.column_stack([self.ends, self.direction, self.seen.slow, *(self.column(term) for term in terms)])
        y = self.seen.stretch
        if noise is None:
            noise = deviation(y - columns @ solved(columns, y))
        wanted, told = (part[1:] if whatever_stiffness else part for part in self.file)
        gram, right = columns.T @ columns / noise**2, columns.T @ y / noise**2
        gram[:BASE, :BASE] += told.T @ told
        right[:BASE] += told.T @ wanted
        solution = pinv(gram, right)
        for end in (0, 1):
            if solution[end] < 0.0:  # no tendon shortens under its tension
                kept = np.arange(len(right)) != end
                solution = np.zeros(len(right))
                solution[kept] = pinv(gram[np.ix_(kept, kept)], right[kept])
        beside = float(np.sum(np.square(told @ solution[:BASE] - wanted)))
        own = solution[len(right) - len(terms) :]
        return StretchFit(tuple(terms), noise, y - columns @ solution, beside, own, columns, gram)

    def as_given(self) -> Array:
        """Return the residual of the elongation with the model's own compliances, (m,) in m.

        Zero, drift and the ratio of the pulley radii are fitted and subtracted.
        """
        rest = self.seen.stretch - self.ends @ self.softness
        return np.asarray(rest - self.seen.slow @ solved(self.seen.slow, rest))

    def best(self, found: StretchFit, terms: Sequence[Term]) -> Term | None:
        """Return the term that reduces the cost of `found` most, with its shape coordinate refined.

        The result is None if no term reduces the cost.
        """
        gains = [self._gain(found, term) for term in terms]
        number = int(np.argmax(gains)) if gains else -1
        if number < 0 or gains[number] <= 0.0:
            return None
        best = terms[number]
        if not best.shape:
            return best
        alike = sorted(t.shape[0] for t in terms if t.run == best.run and t.variant.label == best.variant.label)
        place, (_, coordinate) = alike.index(best.shape[0]), best.variant.coordinates
        low = alike[place - 1] if place else coordinate.low
        high = alike[place + 1] if place + 1 < len(alike) else coordinate.high

        from scipy.optimize import minimize_scalar  # slow to import

        def left(at: float) -> float:
            return -self._gain(found, best.at(at))

        refined = best.at(float(minimize_scalar(left, bounds=(low, high), method="bounded").x))
        return refined if self._gain(found, refined) > gains[number] else best

    def _gain(self, found: StretchFit, term: Term) -> float:
        """Return the decrease of the cost due to the term.

        The result is 0 if its amplitude would be out of bounds, or if the columns of `found` already reproduce it.
        """
        column = self.column(term)
        shared = found.columns.T @ column / found.noise**2
        whole = float(column @ column) / found.noise**2
        alike = pinv(found.gram, shared)  # coefficients with which the present columns reproduce it best
        beyond = column - found.columns @ alike
        new = float(beyond @ beyond) / found.noise**2 + float(np.sum(np.square(self.file[1] @ alike[:BASE])))
        towards = float(column @ found.rest) / found.noise**2
        if not new > LEAST_NEW * whole:
            return 0.0
        coordinate = term.variant.coordinates[0]
        return towards**2 / new if coordinate.low < towards / new < coordinate.high else 0.0


def _at(t: Array, start: float) -> State[Array]:
    """Return a state that has only the time of a log, because the effects on the elongation use no other signal."""
    none = np.asarray(math.nan)
    return State(
        t=t, omega=none, acceleration=none, q_j=none, q_m=none, temperature=none, theta=none, sigma=none, start=start
    )
