"""The tendons' stretch as a second measurement: of the names that the torque leaves, those that it contradicts.

Where a log has the angles of both pulleys, s = r_M q_M - r_J q_J follows the tensions at both ends of the tendons,

    s = zero + drift + e q_J + c_M (T3 - T1) + c_J (T4 - T2),

which each hypothesis foretells: what acts before the tendons (torque constant, ripple, friction of the motor) or in
them (slack, shape, presliding) is in them, what acts behind (joint, load, delay of the torque sensor) is not. Stiffness
and shape are free as far as the model file does not know them, and the hypothesis' own coordinates as far as the torque
leaves them free: it must fit both.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import Catalogue
from tsa_ctrl.identify.diagnosis.residual.dependence import Finding
from tsa_ctrl.identify.diagnosis.residual.structure import error_criterion
from tsa_ctrl.identify.diagnosis.rivals.groups import MOST_SPREAD, Group, Rival, groups
from tsa_ctrl.identify.diagnosis.rivals.stretch import (
    SHAPE,
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

VISIBLY = 1.25  # of the squares of the best: encoders and what no hypothesis has leave that much open
BEYOND = 3.0  # t of the difference over the blocks: 0.3 % one-sided
ENOUGH = 30.0  # of the cost, that the difference must be: no matter of a few counts
ASIDE = 9.0 * MOST_SPREAD**2  # of what torque and file cost more: 3 standard deviations of the blocks' largest spread
HONEST = 1.5  # times what is left with stiffness and shape free: more, and none of them is what stretches the tendons
LEAST_TOLD = 0.5  # of the stretch's mean square less zero and drift: less, and the stretch is not of these tensions
ROUNDS = 2  # of Gauss-Newton: a hypothesis starts where the torque has it
MOST_CHANGES = 3  # of a name: each is a search of rivals anew, and the second already comes from a closer group


@dataclass(frozen=True)
class _Told:
    """The squares that a hypothesis leaves of it, (m,) in m^2, and what it costs of torque and model file beside, 1."""

    squares: Array
    beside: float


def parted(
    chosen: Selection, catalogue: Catalogue, findings: Sequence[Finding], grouped: Sequence[Group]
) -> tuple[Selection, tuple[Group, ...]]:
    """The causes and groups without the names that the stretch excludes; as they are where no log has both angles.

    A cause that the stretch contradicts gives its place to the rival of its group that fits best.
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
    """The group with what the stretch excludes, and the rival that takes the cause's place, if one does."""
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
    """Whether it is an effect that means something, and no wider recalibration."""
    fitted = rival.fitted
    named = not fitted.hypothesis.wide_prior and rival.name in fitted.names[-1:]
    return named and not meaningless(problem, fitted)


def _contradicted(found: _Told, best: _Told, seen: Seen, noise: float) -> bool:
    """Whether it leaves visibly more than the best, beyond the blocks' scatter, or asks too much of torque and file."""
    more = np.bincount(seen.blocks, found.squares - best.squares) / noise**2
    total = float(more.sum())
    spread = float(np.std(more, ddof=1)) * np.sqrt(len(more)) if len(more) > 1 else np.inf
    visible = max(ENOUGH, (VISIBLY - 1.0) * float(best.squares.sum()) / noise**2)
    return (total > visible and total > BEYOND * spread) or found.beside - best.beside + total > ASIDE


def _left_free(problem: Problem, fitted: Fit, seen: Seen) -> Array | None:
    """What a hypothesis leaves of the stretch (m,) with stiffness and shape free; None where it cannot be computed."""
    try:
        columns = np.hstack([ends_of(problem, fitted, fitted.point)[0], seen.slow])
    except UsageError:
        return None
    return seen.stretch - columns @ solved(columns, seen.stretch)


def _told(problem: Problem, fitted: Fit, seen: Seen, noise: float, shaped: bool) -> _Told:
    """The stretch under a hypothesis, with its coordinates as torque and stretch together want them."""
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
