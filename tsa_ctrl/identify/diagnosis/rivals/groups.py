"""Which other effects this log cannot exclude in place of a named one.

A rival takes the place of the cause and everything is fitted anew; it stays an alternative unless it fits worse by more
than noise explains, that of the blocks included. `parameter_error` is the rival that needs no effect: recalibration
without regard to [uncertainty].

Where most of what is left is structure, the simulation error decides (`residual.structure`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, fit_or_none
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import models_reversals, simulation_error
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import Catalogue, all_but
from tsa_ctrl.identify.diagnosis.residual.structure import ErrorCriterion
from tsa_ctrl.identify.diagnosis.rivals.elsewhere import elsewhere
from tsa_ctrl.identify.diagnosis.selection.forward import PER_COORDINATE
from tsa_ctrl.identify.diagnosis.selection.meaning import BY_NOISE
from tsa_ctrl.identify.diagnosis.selection.step import backward_step, best_steps, step_from_nominal
from tsa_ctrl.model.catalogue import PARAMETER_ERROR, twins_of
from tsa_ctrl.model.effects.search import Coordinate, Value, Variant
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.signals import Signals

# Times the deviation in white noise that blocks may show: as much as an interval may be widened (refit.WIDEST)
MOST_SPREAD = 3.0
INPUT_TOLERANCE = 0.02  # of what the cause explains: inputs and filters are no better known than that
# White units, of that tolerance: what is sure by 60 is not made unsure by how much it explains
MOST_INPUT_TOLERANCE = 60.0
STILL = 0.3  # rad, range of the joint angle in which a weight may pass for an offset
UNRECORDED = "thermal_friction_drift"  # a rival under a temperature that nobody recorded
# K, of the temperature that is made up: a drive that warms up; its coefficient is in proportion, so that any would do
RISE = 10.0
REFERENCE = 25.0  # deg C: a room; of a temperature that is made up only differences count
FITTED = 6  # rivals that are fitted in full, beside the cause's own twins: a group of more would tell nobody anything


@dataclass(frozen=True)
class Rival:
    """`worse`: increase of the sum of squares, in units in which its deviation is that of white noise.

    `limit`: the named cause is a limit of this one, which needs further parameters for nothing, or this one has
    vanished. `within_structure`: most of what is left is structure, and the simulation
    error does not tell them apart. On samples that no fit has seen this one `fails_elsewhere`, as it leaves visibly
    more than the named cause. `against_stretch`: the angles of both pulleys contradict it.
    """

    name: str
    fitted: Fit
    worse: float
    tolerance: float  # of `worse`, that errors of the inputs explain
    limit: bool = False
    within_structure: bool = False
    fails_elsewhere: bool = False
    against_stretch: bool = False
    share: float | None = None  # of what the cause takes off the error there, that this one does; None: not compared

    @property
    def excluded(self) -> bool:
        if self.limit or self.fails_elsewhere or self.against_stretch:
            return True
        return self.worse > BY_NOISE + self.tolerance and not self.within_structure

    @property
    def weight(self) -> float:
        """Return the likelihood relative to the named cause, by the same evidence that decides `excluded`."""
        return 1.0 if self.within_structure else float(np.exp(-0.5 * max(self.worse - self.tolerance, 0.0)))


@dataclass(frozen=True)
class Group:
    """A cause with the effects that it was compared to, best first."""

    name: str
    rivals: tuple[Rival, ...]

    @property
    def alternatives(self) -> tuple[Rival, ...]:
        return tuple(rival for rival in self.rivals if not rival.excluded)

    @property
    def probabilities(self) -> dict[str, float]:
        """Return the probability of the cause and of each alternative within the group."""
        weights = {self.name: 1.0} | {rival.name: rival.weight for rival in self.alternatives}
        total = sum(weights.values())
        return {name: weight / total for name, weight in weights.items()}


def groups(problem: Problem, fitted: Fit, catalogue: Catalogue, structure: ErrorCriterion | None = None) -> list[Group]:
    """One group for each cause of `fitted`. `structure`: what is left of it, where that is more than noise."""
    return [_group(problem, fitted, index, catalogue, structure) for index in range(len(fitted.names))]


def _group(problem: Problem, fitted: Fit, index: int, catalogue: Catalogue, structure: ErrorCriterion | None) -> Group:
    smaller = backward_step(problem, fitted, index)
    name = fitted.names[index]
    fits: list[tuple[str, Fit | None]]
    near = best_steps(problem, smaller, catalogue, fitted.names, FITTED, twins_of(name))
    fits = [(rival.names[-1], rival) for rival in near]
    wide = dataclasses.replace(smaller.hypothesis, wide_prior=True)
    if not np.all(smaller.free[: len(wide.base.coordinates())]):
        fits.append((PARAMETER_ERROR, fit_or_none(problem, wide, smaller.point)))
    if name == "pretension_relaxation" and UNRECORDED not in catalogue:
        fits.append((UNRECORDED, _temperature_confound(problem, fitted, smaller, index)))
    others = all_but(fitted.names, catalogue)
    bare = [variant for variant in others if not variant.coordinates]
    fits += ((variant.effect, step_from_nominal(problem, smaller, variant)) for variant in bare)
    tolerance = min(INPUT_TOLERANCE * (smaller.rss - fitted.rss), MOST_INPUT_TOLERANCE)
    found = [compared(problem, fitted, rival, other, tolerance) for other, rival in fits if rival is not None]
    limits = _limits(problem, name)
    found = [
        dataclasses.replace(
            rival,
            limit=_vanished(rival.fitted) or (rival.name in limits and rival.worse > -PER_COORDINATE),
        )
        for rival in found
    ]
    if structure is not None:
        found = _by_simulation_error(problem, found, structure, smaller, models_reversals(fitted))
    found = _judged_elsewhere(problem, fitted, smaller, found)
    best: dict[str, Rival] = {}  # of each name
    for rival in sorted(found, key=lambda rival: (rival.excluded, rival.worse)):
        best.setdefault(rival.name, rival)
    return Group(name, tuple(sorted(best.values(), key=lambda rival: rival.worse)))


def _by_simulation_error(
    problem: Problem, found: Sequence[Rival], structure: ErrorCriterion, smaller: Fit, reversals: bool
) -> list[Rival]:
    """The same, with what the simulation error says of those that noise would exclude."""
    judged = []
    without_any = simulation_error(problem, smaller, reversals)
    for rival in found:
        covers = rival.excluded and not made_up(problem, rival.name)
        covers = covers and structure.covers(simulation_error(problem, rival.fitted, reversals), without_any)
        judged.append(dataclasses.replace(rival, within_structure=covers))
    return judged


def _judged_elsewhere(problem: Problem, fitted: Fit, smaller: Fit, found: Sequence[Rival]) -> list[Rival]:
    """The same, with what samples that no fit has seen say of those that are left."""
    judged = list(found)
    reversals = models_reversals(fitted)
    own = without = None
    for number, rival in enumerate(found):
        if made_up(problem, rival.name) or rival.excluded:
            continue
        if own is None or without is None:
            own, without = (elsewhere(problem, each, reversals) for each in (fitted, smaller))
        other = elsewhere(problem, rival.fitted, reversals)
        judged[number] = dataclasses.replace(
            rival,
            fails_elsewhere=own.clearly_beats(other),
            share=(without.error - other.error) / max(without.error - own.error, 1e-300),
        )
    return judged


def made_up(problem: Problem, name: str) -> bool:
    """A warm-up that nobody recorded is made up by `_temperature_confound`: no simulation of these logs has it."""
    return name == UNRECORDED and not problem.frame.has("temperature")


def _vanished(rival: Fit) -> bool:
    """Whether a rival does without what its name says: presliding over no distance is the angle's direction alone."""
    hypothesis = rival.hypothesis
    if not hypothesis.nonsmooth.any() or not hypothesis.nonsmooth[-1]:
        return False
    return bool(rival.point[-1] - hypothesis.low[-1] < hypothesis.steps[-1])


def _limits(problem: Problem, name: str) -> set[str]:
    """Effects of which `name` is a limit: an offset is a spring without stiffness, or a weight that hardly turns."""
    if name != "torque_offset":
        return set()
    turned = max(float(np.ptp(run.angle)) for run in problem.frame.runs) > STILL
    return {"joint_stiffness", "gravity_load"} if turned else {"joint_stiffness"}


def compared(problem: Problem, fitted: Fit, rival: Fit, name: str, tolerance: float = 0.0) -> Rival:
    """How much worse `rival` fits; a further coordinate counts as in the selection.

    In white noise the increase of the sum of squares has the deviation 2 |d|, where d is the difference of the
    predictions; where the products of d with the residual add up to more within blocks, the increase counts less.
    """
    difference = fitted.residual - rival.residual
    total = rival.rss - fitted.rss
    within = np.bincount(problem.blocks, difference * fitted.residual)
    expected = max(float(np.linalg.norm(difference)), 1e-9)
    spread = min(max(1.0, float(np.linalg.norm(within - within.mean())) / expected), MOST_SPREAD)
    extra = PER_COORDINATE * (len(rival.point) - len(fitted.point))
    return Rival(name, rival, (total + min(extra, 0.0)) / spread**2, tolerance)


def _temperature_confound(problem: Problem, fitted: Fit, smaller: Fit, index: int) -> Fit | None:
    """The fit of `smaller` with a hidden warm-up in place of the relaxation, which is number `index` of `fitted`.

    Any course of a temperature that nobody recorded is possible, so the rival gets the one that imitates the relaxation
    best: its own. Only the slope, which follows friction and not pretension, can part the two. None where a temperature
    was recorded.
    """
    frame = problem.frame
    if frame.has("temperature"):
        return None
    parameters = fitted.hypothesis.variants[index].parameters(fitted.hypothesis.own(fitted.point)[index])
    runs = tuple(dataclasses.replace(run, signals=_with_temperature(run.signals, parameters)) for run in frame.runs)
    warmed = dataclasses.replace(problem, frame=dataclasses.replace(frame, runs=runs))
    return fit_or_none(warmed, smaller.hypothesis.plus(_drift()), np.append(smaller.point, 0.0))


def _with_temperature(signals: Signals, relaxation: dict[str, Value]) -> Signals:
    elapsed = (signals.t - signals.t[0]) / float(relaxation["time_constant"])
    course = np.log10(1.0 + elapsed) if relaxation.get("law") == "logarithmic" else -np.expm1(-elapsed)
    return dataclasses.replace(signals, temperature=REFERENCE + RISE * course)


def _drift() -> Variant:
    def parameters(u: Array) -> dict[str, Value]:
        return {"temperature_coefficient": float(u[0]) / RISE, "reference_temperature": REFERENCE}

    coordinate = Coordinate("temperature_coefficient", -0.95, 0.95, 1e-3)
    return Variant("thermal_friction_drift", (coordinate,), ((0.0,),), (0,), parameters)
