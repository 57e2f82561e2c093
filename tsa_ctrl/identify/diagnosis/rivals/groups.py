"""Compare each identified cause with the competing hypotheses that the logs cannot exclude.

For each comparison, the competing hypothesis replaces the cause, and all parameters are fitted again. It remains an
alternative unless its fit is worse by more than the noise explains, including the scatter between blocks.
`parameter_error` is the competing hypothesis without an effect: a recalibration that ignores [uncertainty].

If most of the residual is structure, the simulation error decides instead of the noise (`residual.structure`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tsa_ctrl.identify.diagnosis.criteria import BY_NOISE, MOST_SPREAD, PER_COORDINATE, UNDOUBTED
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, fit_or_none
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import models_reversals, simulation_error
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import Catalogue, all_but
from tsa_ctrl.identify.diagnosis.residual.structure import ErrorCriterion
from tsa_ctrl.identify.diagnosis.rivals.elsewhere import elsewhere
from tsa_ctrl.identify.diagnosis.rivals.sensor import sensor_fits
from tsa_ctrl.identify.diagnosis.selection.step import backward_step, best_steps, step_from_nominal
from tsa_ctrl.model.catalogue import PARAMETER_ERROR, SENSOR_ERROR, twins_of
from tsa_ctrl.model.effects.search import Coordinate, Value, Variant
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.signals import Signals

INPUT_TOLERANCE = 0.02  # share of the decrease due to the cause: inputs and filters are not known more accurately
STILL = 0.3  # rad, range of the joint angle within which a gravity load looks like an offset
UNRECORDED = "thermal_friction_drift"  # the competing hypothesis of a temperature that was not recorded
# K, rise of the assumed temperature while the drive warms up: any value would do, because the coefficient scales with
# its inverse
RISE = 10.0
REFERENCE = 25.0  # deg C, room temperature: only differences of the assumed temperature matter
# Number of competing hypotheses that are fitted completely, in addition to the effects that the catalogue lists as
# indistinguishable from the cause: a larger group would not help the reader
FITTED = 6


@dataclass(frozen=True)
class Rival:
    """Competing hypothesis in place of an identified cause."""

    name: str
    fitted: Fit
    worse: float  # white units, increase of the sum of squares, corrected for the scatter between blocks
    tolerance: float  # white units, part of `worse` that errors of the inputs can explain
    limit: bool = False  # the cause is a limiting case of this hypothesis, or the effect of this hypothesis vanished
    within_structure: bool = False  # the residual is mostly structure, and the simulation error does not separate both
    fails_elsewhere: bool = False  # the cause has a clearly smaller error on samples outside the fit
    against_stretch: bool = False  # the angles of both pulleys contradict it
    # Decrease of the error on samples outside the fit, as a share of the decrease by the cause; None: not compared
    share: float | None = None

    @property
    def excluded(self) -> bool:
        if self.limit or self.fails_elsewhere or self.against_stretch:
            return True
        return self.worse > BY_NOISE + self.tolerance and not self.within_structure

    @property
    def weight(self) -> float:
        """Return the likelihood relative to the identified cause, from the same evidence that decides `excluded`."""
        return 1.0 if self.within_structure else float(np.exp(-0.5 * max(self.worse - self.tolerance, 0.0)))


@dataclass(frozen=True)
class Group:
    """An identified cause and the competing hypotheses with which it was compared, in the order of `worse`."""

    name: str
    rivals: tuple[Rival, ...]

    @property
    def alternatives(self) -> tuple[Rival, ...]:
        return tuple(rival for rival in self.rivals if not rival.excluded)

    @property
    def catalogued(self) -> tuple[Rival, ...]:
        """Return the alternatives except a torque sensor error, which a formula may describe instead of a cause."""
        return tuple(rival for rival in self.alternatives if rival.name != SENSOR_ERROR)

    @property
    def probabilities(self) -> dict[str, float]:
        """Return the probability of the cause and of each alternative within the group."""
        weights = {self.name: 1.0} | {rival.name: rival.weight for rival in self.alternatives}
        total = sum(weights.values())
        return {name: weight / total for name, weight in weights.items()}


def groups(problem: Problem, fitted: Fit, catalogue: Catalogue, structure: ErrorCriterion | None = None) -> list[Group]:
    """Return one group for each cause of `fitted`.

    structure: the simulation-error criterion if most of the residual is structure; None if the noise decides.
    """
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
    tolerance = min(INPUT_TOLERANCE * (smaller.rss - fitted.rss), UNDOUBTED)
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
    if all(rival.excluded for rival in found):
        sensor = [_sensor_error(problem, fitted, index, each) for each in sensor_fits(problem, fitted, index)]
        if structure is not None:
            sensor = _by_simulation_error(problem, sensor, structure, smaller, models_reversals(fitted))
        found += _judged_elsewhere(problem, fitted, smaller, sensor)
    best: dict[str, Rival] = {}  # the best hypothesis of each name
    for rival in sorted(found, key=lambda rival: (rival.excluded, rival.worse)):
        best.setdefault(rival.name, rival)
    return Group(name, tuple(sorted(best.values(), key=lambda rival: rival.worse)))


def _by_simulation_error(
    problem: Problem, found: Sequence[Rival], structure: ErrorCriterion, smaller: Fit, reversals: bool
) -> list[Rival]:
    """Return the same hypotheses, with `within_structure` set if only the noise excludes them.

    The simulation error then does not exclude them.
    """
    judged = []
    without_any = simulation_error(problem, smaller, reversals)
    for rival in found:
        covers = rival.excluded and not made_up(problem, rival.name)
        covers = covers and structure.covers(simulation_error(problem, rival.fitted, reversals), without_any)
        judged.append(dataclasses.replace(rival, within_structure=covers))
    return judged


def _judged_elsewhere(problem: Problem, fitted: Fit, smaller: Fit, found: Sequence[Rival]) -> list[Rival]:
    """Return the same hypotheses after a comparison on samples outside the fit.

    The comparison sets `fails_elsewhere` and `share` of each hypothesis that is not excluded yet.
    """
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
    """Return True if the hypothesis assumes a temperature that the logs do not contain.

    `_temperature_confound` invents this temperature, so the logs cannot be simulated with the hypothesis.
    """
    return name == UNRECORDED and not problem.frame.has("temperature")


def _vanished(rival: Fit) -> bool:
    """Return True if the effect of a competing hypothesis has vanished in its fit.

    An example is presliding over zero distance, which depends only on the direction of motion.
    """
    hypothesis = rival.hypothesis
    if not hypothesis.nonsmooth.any() or not hypothesis.nonsmooth[-1]:
        return False
    return bool(rival.point[-1] - hypothesis.low[-1] < hypothesis.steps[-1])


def _limits(problem: Problem, name: str) -> set[str]:
    """Return the effects that have `name` as a limiting case.

    A torque offset is a limiting case of a joint stiffness. If the joint angle varies by more than STILL, the offset
    also counts as a limiting case of a gravity load. For any other name, the set is empty.
    """
    if name != "torque_offset":
        return set()
    turned = max(float(np.ptp(run.angle)) for run in problem.frame.runs) > STILL
    return {"joint_stiffness", "gravity_load"} if turned else {"joint_stiffness"}


def _sensor_error(problem: Problem, fitted: Fit, index: int, found: Fit) -> Rival:
    """Return a sensor error as a competing hypothesis in place of cause number `index` of `fitted`.

    The choice among several laws costs as much as one coordinate. A wrong zero and a wrong gain of the sensor are
    effects themselves. A sensor error that replaces only such an effect is excluded unless it explains more.
    """
    rival = compared(problem, fitted, found, SENSOR_ERROR)
    itself = len(found.names) == len(fitted.names) and fitted.names[index] in ("torque_offset", "torque_constant_error")
    worse = rival.worse + PER_COORDINATE
    return dataclasses.replace(rival, worse=worse, limit=itself and worse > 0.0)


def compared(problem: Problem, fitted: Fit, rival: Fit, name: str, tolerance: float = 0.0) -> Rival:
    """Return `rival` as a competing hypothesis called `name`, with the increase of the sum of squares over `fitted`.

    If `rival` has fewer coordinates than `fitted`, the increase is reduced by PER_COORDINATE for each missing one.

    In white noise the increase has the standard deviation 2 |d|, where d is the difference of the predictions. The
    products of d and the residual may scatter more between blocks than in white noise. The increase is then divided by
    the square of this ratio, which is limited to MOST_SPREAD.
    """
    difference = fitted.residual - rival.residual
    total = rival.rss - fitted.rss
    within = np.bincount(problem.blocks, difference * fitted.residual)
    expected = max(float(np.linalg.norm(difference)), 1e-9)
    spread = min(max(1.0, float(np.linalg.norm(within - within.mean())) / expected), MOST_SPREAD)
    extra = PER_COORDINATE * (len(rival.point) - len(fitted.point))
    return Rival(name, rival, (total + min(extra, 0.0)) / spread**2, tolerance)


def _temperature_confound(problem: Problem, fitted: Fit, smaller: Fit, index: int) -> Fit | None:
    """Return the fit of `smaller` with a hidden warm-up in place of the relaxation, cause number `index` of `fitted`.

    A temperature that was not recorded may follow any curve. To imitate the relaxation best, the assumed temperature
    follows the curve of the relaxation. Only the slope distinguishes the two, because it depends on the friction and
    not on the pretension. The result is None if a temperature was recorded, or if the fit fails.
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
