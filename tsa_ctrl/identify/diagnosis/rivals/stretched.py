"""Use the tendon elongation as a second measurement to exclude hypotheses that fit the torque.

If the logs contain the angles of both pulleys, the elongation s follows from the tensions at both ends of the tendons:

    s = r_M q_M - r_J q_J = zero + drift + e q_J + c_M (T3 - T1) + c_J (T4 - T2)

Each hypothesis predicts these tensions. They contain every effect that acts ahead of the tendons (torque constant,
ripple, motor friction) or in the tendons (slack, curvature profile, presliding). They do not contain effects behind the
tendons (joint, load, delay of the torque sensor).

A hypothesis must fit both the torque and the elongation. The fit to the elongation may vary the stiffness and the
curvature profile within the uncertainty of the model file. It may also vary the coordinates of the hypothesis to the
extent that the torque does not determine them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.diagnosis.criteria import BEYOND, MOST_SPREAD
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import Catalogue
from tsa_ctrl.identify.diagnosis.residual.dependence import Finding
from tsa_ctrl.identify.diagnosis.residual.structure import error_criterion
from tsa_ctrl.identify.diagnosis.rivals.groups import Group, Rival, groups
from tsa_ctrl.identify.diagnosis.rivals.stretch import (
    ENOUGH,
    SHAPE,
    VISIBLY,
    Seen,
    deviation,
    ends_of,
    of_the_file,
    pinv,
    seen_of,
    softness,
    solved,
)
from tsa_ctrl.identify.diagnosis.selection.forward import Selection
from tsa_ctrl.identify.diagnosis.selection.meaning import meaningless
from tsa_ctrl.model.functions import Array

# Largest difference in total cost (torque, model file and elongation): 3 standard deviations at the largest spread
# of the blocks
ASIDE = 9.0 * MOST_SPREAD**2
# Ratio of the best sum of squares to the one with free stiffness and curvature profile: above it, no hypothesis
# explains the elongation
HONEST = 1.5
# Least share of the mean square of the elongation, without zero and drift, that the best hypothesis explains: below it,
# the elongation does not follow the predicted tensions
LEAST_TOLD = 0.5
ROUNDS = 2  # iterations of Gauss-Newton: they start from the fit to the torque, which is close to the optimum
# Largest number of exchanged causes: each one repeats the search for competing hypotheses, and the second search
# already starts from a smaller group
MOST_CHANGES = 3


@dataclass(frozen=True)
class _Told:
    """A fit of the tendon elongation under one hypothesis."""

    squares: Array  # (m,) in m^2, squared residuals of the elongation
    beside: float  # 1, increase of the cost of the torque, plus the deviation from the model file


def parted(
    chosen: Selection, catalogue: Catalogue, findings: Sequence[Finding], grouped: Sequence[Group]
) -> tuple[Selection, tuple[Group, ...]]:
    """Return the selection and its groups after the hypotheses were compared with the tendon elongation.

    Alternatives that the elongation contradicts are marked as excluded. A contradicted cause is replaced by the best
    alternative, if that is an effect that can be identified. The search for competing hypotheses is then repeated.
    Selection and groups are returned unchanged if a log lacks an angle, if the drive has no tendons, or if no group has
    an alternative.
    """
    seen = seen_of(chosen.problem) if any(group.alternatives for group in grouped) else None
    if seen is None:
        return chosen, tuple(grouped)
    for _ in range(MOST_CHANGES):
        judged = [_judged(chosen, group, seen) for group in grouped]
        grouped = [group for group, _ in judged]
        better = next((rival for _, rival in judged if rival is not None), None)
        if better is None:
            break
        chosen = chosen.with_fit(better.fitted)
        structure = error_criterion(chosen.problem, chosen.fitted, findings)
        grouped = groups(chosen.problem, chosen.fitted, catalogue, structure)
    return chosen, tuple(grouped)


def _judged(chosen: Selection, group: Group, seen: Seen) -> tuple[Group, Rival | None]:
    """Return the group with its excluded alternatives marked, and the alternative that replaces the cause.

    The second value is None if the cause is not replaced. The group is returned unchanged in these cases:

    - The tensions cannot be computed for the cause.
    - The tensions cannot be computed for any of the alternatives.
    - No hypothesis explains the elongation.
    - The elongation contradicts the cause itself.
    """
    members: list[tuple[Rival | None, Fit]] = [(None, chosen.fitted)]
    members += [(rival, rival.fitted) for rival in group.alternatives]
    shaped = any(SHAPE in fitted.names for _, fitted in members)
    free = {id(rival): _left_free(chosen.problem, fitted, seen) for rival, fitted in members}
    members = [(rival, fitted) for rival, fitted in members if free[id(rival)] is not None]
    if len(members) < 2 or members[0][0] is not None:
        return group, None
    least = min((rest for rest in free.values() if rest is not None), key=lambda rest: float(rest @ rest))
    noise = deviation(least)
    told = [(rival, _told(chosen.problem, fitted, seen, noise, shaped)) for rival, fitted in members]
    best, winner = min(told, key=lambda entry: float(entry[1].squares.sum()) / noise**2 + entry[1].beside)
    left = float(winner.squares.sum())
    change = seen.stretch - seen.slow @ solved(seen.slow, seen.stretch)
    if left > HONEST * float(least @ least) or left > (1.0 - LEAST_TOLD) * float(change @ change):
        return group, None
    excluded = [rival for rival, found in told if _contradicted(found, winner, seen, noise)]
    if None in excluded:
        return group, best if best is not None and _can_be_named(chosen.problem, best) else None
    names = {rival.name for rival in excluded if rival is not None}
    rivals = (dataclasses.replace(rival, against_stretch=rival.name in names) for rival in group.rivals)
    return dataclasses.replace(group, rivals=tuple(rivals)), None


def _can_be_named(problem: Problem, rival: Rival) -> bool:
    """Return True if the hypothesis adds a meaningful effect; a recalibration beyond [uncertainty] does not."""
    fitted = rival.fitted
    named = not fitted.hypothesis.wide_prior and rival.name in fitted.names[-1:]
    return named and not meaningless(problem, fitted)


def _contradicted(found: _Told, best: _Told, seen: Seen, noise: float) -> bool:
    """Return True if the elongation contradicts the hypothesis `found`.

    This is the case if its sum of squared residuals is clearly larger than for `best`, beyond the scatter of the
    blocks. It is also the case if its total cost of torque, model file and elongation is larger by more than ASIDE.
    """
    more = np.bincount(seen.blocks, found.squares - best.squares) / noise**2
    total = float(more.sum())
    spread = float(np.std(more, ddof=1)) * np.sqrt(len(more)) if len(more) > 1 else np.inf
    visible = max(ENOUGH, (VISIBLY - 1.0) * float(best.squares.sum()) / noise**2)
    return (total > visible and total > BEYOND * spread) or found.beside - best.beside + total > ASIDE


def _left_free(problem: Problem, fitted: Fit, seen: Seen) -> Array | None:
    """Return the residual of the elongation, (m,) in m, with free stiffness and curvature profile.

    The result is None if the tensions under the hypothesis cannot be computed.
    """
    try:
        columns = np.hstack([ends_of(problem, fitted, fitted.point)[0], seen.slow])
    except UsageError:
        return None
    return seen.stretch - columns @ solved(columns, seen.stretch)


def _told(problem: Problem, fitted: Fit, seen: Seen, noise: float, shaped: bool) -> _Told:
    """Return the fit of the elongation under a hypothesis with coordinates adjusted to torque and elongation together.

    noise: standard deviation of the elongation, m. shaped: as in `of_the_file`.
    """
    hypothesis, free = fitted.hypothesis, np.flatnonzero(fitted.free)
    point, moved = fitted.point.copy(), np.zeros(len(free))
    ends, model = ends_of(problem, fitted, point)
    wanted, told = of_the_file(model, shaped)
    cost = told.T @ told, told.T @ wanted
    soft = softness(ends, seen, noise, *cost)
    by_torque = fitted.jacobian.T @ fitted.jacobian
    for _ in range(ROUNDS if len(free) else 0):
        columns = np.zeros((len(seen.stretch), len(free)))
        for place, coordinate in enumerate(free):
            there, step = point.copy(), hypothesis.steps[coordinate]
            step = step if point[coordinate] + step <= hypothesis.high[coordinate] else -step
            there[coordinate] += step
            columns[:, place] = (ends_of(problem, fitted, there)[0] - ends) @ soft / step
        rows = np.hstack([columns, ends, seen.slow]) / noise
        rest = (seen.stretch - ends @ soft) / noise
        gram, right = rows.T @ rows, rows.T @ rest
        own, two = slice(0, len(free)), slice(len(free), len(free) + 2)
        gram[own, own] += by_torque
        right[own] -= by_torque @ moved
        gram[two, two] += cost[0]
        right[two] += cost[1] - cost[0] @ soft
        step_to = np.clip(point[free] + pinv(gram, right)[own], hypothesis.low[free], hypothesis.high[free])
        moved += step_to - point[free]
        point[free] = step_to
        ends, model = ends_of(problem, fitted, point)
        soft = softness(ends, seen, noise, *cost)
    rest = seen.stretch - ends @ soft
    rest = rest - seen.slow @ solved(seen.slow, rest)
    beside = float(moved @ by_torque @ moved) + float(np.sum(np.square(told @ soft - wanted)))
    return _Told(np.square(rest), beside)
