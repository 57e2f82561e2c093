"""Identify causes that only the tendon elongation shows, for logs with the angles of both pulleys.

The causes of the torque error leave a residual of the elongation. Effects of the catalogue are fitted to this residual,
one at a time. An effect is an identified cause if it clearly reduces the residual. A series spring is also identified
if the fitted stiffness would contradict the model file without it. Effects that fit equally well remain alternatives.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tsa_ctrl.identify.diagnosis.criteria import BEYOND
from tsa_ctrl.identify.diagnosis.rivals.stretch import ENOUGH, VISIBLY
from tsa_ctrl.identify.diagnosis.rivals.stretch_fit import BASE, ONCE, Stretch, StretchFit, Term
from tsa_ctrl.identify.diagnosis.selection.forward import Selection
from tsa_ctrl.identify.quantity import NOISE, Quantity, half_width
from tsa_ctrl.model.catalogue import CATALOGUE, PARAMETER_ERROR, of_the_stretch
from tsa_ctrl.model.effects.search import Scales, Value
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Effects

SPRING = "series_spring"
MOST = 3  # largest number of identified effects, of four in the catalogue: four at once would fit almost any curve
FROM_FILE = 16.0  # cost of a clear contradiction to the model file: 4 standard deviations of its [uncertainty]
FOR_ONCE = 1.5  # Student's t of the differences for a transient effect: if k blocks show all of it, t is sqrt(k)
ALIKE = 9.0  # largest difference in cost between equally good effects: 3 standard deviations
# Least share of the mean square of the elongation, without zero, drift and the effects, that the tensions explain:
# below it, an unknown cause elongates the tendons
LEAST_TOLD = 0.9
DOUBLINGS, HALVINGS = 24, 16  # largest numbers of steps to the end of an interval: 16 halvings resolve it to 2e-5
NOT_FOLLOWED = "the angles of both pulleys do not follow the tendons' tensions"
NOT_AS_STIFF = "the angles of both pulleys contradict the stiffness or shape of the model file beyond its [uncertainty]"

Candidates = Mapping[str, Sequence[Term]]


@dataclass(frozen=True)
class StretchCause:
    """An identified effect of the tendon elongation, with the same fields as `Cause`."""

    effect: str
    alternatives: tuple[str, ...]
    probability: float
    parameters: Mapping[str, Quantity | str]
    log: str = ""  # name of the log in which it occurred; empty if it acts in all logs


@dataclass(frozen=True)
class ByStretch:
    """Result of the test of the tendon elongation."""

    causes: tuple[StretchCause, ...] = ()
    rms: tuple[float, float] | None = None  # m, residual of the elongation with the model's compliances and of the fit
    unasked: str = ""  # reason why the test was not possible; empty if it was, or if the logs lack an angle

    @property
    def effects(self) -> Effects:
        """Return the effects for a model file: an event in a single log is not part of the model."""
        return {
            cause.effect: {name: v if isinstance(v, str) else v.value for name, v in cause.parameters.items()}
            for cause in self.causes
            if not cause.log
        }


def by_stretch(chosen: Selection, scales: Scales) -> ByStretch:
    """Return the effects that the elongation shows in addition to the causes of the torque error."""
    stretch = Stretch.of(chosen)
    if stretch is None:
        return ByStretch()
    given = chosen.problem.base.given.effects
    candidates = {name: stretch.terms(CATALOGUE[name], scales) for name in of_the_stretch(given)[1]}
    found = stretch.fit(())
    for _ in range(MOST):
        named = {term.name for term in found.terms}
        more = [_with_one_more(stretch, found, terms) for name, terms in candidates.items() if name not in named]
        shown = [(gain, fit) for gain, fit in more if fit is not None and gain > 0.0]
        if not shown:
            break
        found = max(shown, key=lambda entry: entry[0])[1]
    if not _follows_the_tensions(stretch, found):
        return ByStretch(unasked=NOT_FOLLOWED)
    if found.beside > FROM_FILE:
        return ByStretch(unasked=NOT_AS_STIFF)
    logs = [run.name for run in chosen.problem.frame.runs]
    causes = tuple(_cause(stretch, found, index, candidates, logs) for index in range(len(found.terms)))
    return ByStretch(causes, (_rms(stretch.as_given()), _rms(found.rest)))


def _with_one_more(stretch: Stretch, found: StretchFit, terms: Sequence[Term]) -> tuple[float, StretchFit | None]:
    """Return the decrease of the cost, and the fit with one of `terms` added to the terms of `found`.

    The result is (0.0, None) if the logs do not show the effect, or if its amplitude lies at a bound.
    """
    term = stretch.best(found, terms)
    if term is None:
        return 0.0, None
    more = stretch.fit((*found.terms, term))
    less = stretch.fit(found.terms, more.noise)
    by_file = less.beside - more.beside
    shown = _visibly_less(stretch, more, less, once=bool(term.shape)) or (term.name == SPRING and by_file > FROM_FILE)
    within = term.variant.coordinates[0].low < more.amplitudes[-1] < term.variant.coordinates[0].high
    return (less.cost - more.cost, more) if shown and within else (0.0, None)


def _visibly_less(stretch: Stretch, more: StretchFit, less: StretchFit, once: bool) -> bool:
    """Return True if the residual of `more` is clearly smaller than that of `less`, beyond the scatter of the blocks.

    The test of a permanent effect uses the square roots of the differences. Such an effect may change one block a
    hundred times as much as another, and the roots ensure that many blocks must show it.

    once: True for a transient effect or a single event, which a few blocks may show completely.
    """
    gained = np.bincount(stretch.seen.blocks, less.squares - more.squares)
    total, left = float(gained.sum()), float(more.squares.sum())
    judged, beyond = (gained, FOR_ONCE) if once else (np.copysign(np.sqrt(np.abs(gained)), gained), BEYOND)
    spread = float(np.std(judged, ddof=1)) * math.sqrt(len(judged)) if len(judged) > 1 else math.inf
    return total > ENOUGH and total > (VISIBLY - 1.0) * left and float(judged.sum()) > beyond * spread


def _follows_the_tensions(stretch: Stretch, found: StretchFit) -> bool:
    """Return True if the tensions explain the part of the elongation that the effects do not explain.

    They must explain more than LEAST_TOLD of its mean square, after zero, drift and the ratio of the radii are removed.
    """
    own = found.columns[:, len(found.columns[0]) - len(found.terms) :]
    alone = stretch.seen.stretch - own @ found.amplitudes
    slow = found.columns[:, BASE : found.columns.shape[1] - len(found.terms)]
    change = alone - slow @ np.linalg.lstsq(slow, alone, rcond=None)[0]
    return float(found.rest @ found.rest) < (1.0 - LEAST_TOLD) * float(change @ change)


def _cause(
    stretch: Stretch, found: StretchFit, index: int, candidates: Candidates, logs: Sequence[str]
) -> StretchCause:
    """Return effect number `index` of a fit as a cause, with its alternatives and its parameters."""
    term = found.terms[index]
    others = (*found.terms[:index], *found.terms[index + 1 :])
    named = {other.name for other in found.terms}
    smaller = stretch.fit(others, found.noise)
    worse: dict[str, float] = {}
    for name, terms in candidates.items():
        rival = None if name in named else stretch.best(smaller, terms)
        if rival is not None:
            worse[name] = stretch.fit((*others, rival), found.noise).cost - found.cost
    if term.name == SPRING:
        stiffer = stretch.fit(others, found.noise, whatever_stiffness=True)
        worse[PARAMETER_ERROR] = stiffer.cost - found.cost
    alike = {name: more for name, more in worse.items() if more < ALIKE}
    weights = [math.exp(-0.5 * max(more, 0.0)) for more in alike.values()]
    return StretchCause(
        term.name,
        tuple(sorted(alike, key=lambda name: alike[name])),
        1.0 / (1.0 + sum(weights)),
        _parameters(stretch, found, index),
        logs[term.run] if term.run is not None and term.name == ONCE else "",
    )


def _parameters(stretch: Stretch, found: StretchFit, index: int) -> dict[str, Quantity | str]:
    """Return the parameters of effect number `index` of a fit, with their 95 % intervals."""
    term, amplitude = found.terms[index], float(found.amplitudes[index])
    factor = half_width(NOISE)
    half = factor * float(found.deviations[index])
    coordinate = term.variant.coordinates[0]
    corners = [term.values(min(max(amplitude + side * half, coordinate.low), coordinate.high)) for side in (-1.0, 1.0)]
    if term.shape:
        ends = [_end(stretch, found, index, side, factor**2) for side in (-1.0, 1.0)]
        for corner, place in zip(corners, ends, strict=True):
            shaped = term.at(place).values(amplitude)
            name = next(name for name, value in shaped.items() if value != term.values(amplitude)[name])
            corner[name] = shaped[name]
    out: dict[str, Quantity | str] = {}
    for parameter in term.spec.parameters:
        value = term.values(amplitude).get(parameter.name)
        if isinstance(value, str) or value is None:
            out |= {parameter.name: value} if value is not None else {}
            continue
        low, high = sorted(_number(corner[parameter.name]) for corner in corners)
        out[parameter.name] = Quantity(float(value), low, high, parameter.unit)
    return out


def _end(stretch: Stretch, found: StretchFit, index: int, side: float, allowed: float) -> float:
    """Return the shape coordinate at which the cost has increased by `allowed`, or the bound if that comes first.

    side: 1.0 for the upper end of the interval, -1.0 for the lower end.
    """
    term = found.terms[index]
    coordinate, place = term.variant.coordinates[1], term.shape[0]

    def cost(at: float) -> float:
        terms = (*found.terms[:index], term.at(at), *found.terms[index + 1 :])
        return stretch.fit(terms, found.noise).cost - found.cost

    near, step = 0.0, coordinate.step
    for _ in range(DOUBLINGS):
        beyond = not coordinate.low < place + side * step < coordinate.high
        if beyond or cost(place + side * step) > allowed:
            break
        near, step = step, 2.0 * step
    step = min(step, coordinate.high - place if side > 0.0 else place - coordinate.low)
    for _ in range(HALVINGS):
        middle = 0.5 * (near + step)
        near, step = (middle, step) if cost(place + side * middle) <= allowed else (near, middle)
    return place + side * step


def _number(value: Value) -> float:
    assert not isinstance(value, str)
    return float(value)


def _rms(y: Array) -> float:
    return float(np.sqrt(np.mean(np.square(y))))
