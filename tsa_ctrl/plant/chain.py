"""Model a tendon in its sheath as a chain of springs and contacts that stick or slide with Coulomb (capstan) friction.

Contact i represents the bend of element i. It is pulled to the motor by T_{i-1}, to the joint by T_i, and held by

    F_i = clip(F_i,old + k_b (y_i - y_i,old), -B_i, B_i),     B_i = tanh(x_i / 2) (T_{i-1} + T_i)

The displacement y is positive toward the motor. At a bound, T_{i-1} / T_i = exp(+-x_i), which is exactly the capstan
equation. Springs have no mass, so every sub-step is an equilibrium T_{i-1} - T_i = F_i of all contacts. Newton's method
finds the set of sticking and sliding contacts. Each of its steps solves one tridiagonal system with an M-matrix. Slip
fronts along the chain result without further equations. A contact always slips along F, so friction never creates
energy. The dissipated energy is summed.

With capstan friction a tendon is slack everywhere or nowhere, because a contact next to T = 0 cannot hold any tension.
"""

from __future__ import annotations

import itertools
import math
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.plant.compiled import compiled
from tsa_ctrl.plant.effects import tension_factor

# This part builds the chain of a tendon: the meaning of its rows, and the contacts and springs of the sheath's bends.

RIGID = 1e10  # N/m, contact without bristle
_LEAK = 0.01  # largest share of a change of the tension that a sticking contact passes on, because RIGID is finite


class Row(IntEnum):
    """Number the rows of a chain, an array of shape (rows, contacts + 1) with one spring more than contacts.

    The rows of contacts hold other values in the last column. GRIP: x of the whole tendon. PLACE and PLACE_OLD:
    displacement of the joint end. FORCE and FORCE_OLD: displacement of the motor end. MODE: 1 if the solution was found
    in pieces. BRISTLE: the energy (J) that friction dissipated in these pieces.
    """

    STIFFNESS = 0  # of springs, N/m
    LENGTH_SHARE = 1  # of springs, 1
    BEND_SHARE = 2  # of springs, 1: share of the path length that bending adds
    BEND = 3  # of contacts, 1: share of the bending angle
    BRISTLE = 4  # of contacts, N/m
    PRELOAD = 5  # of springs, m: elongation at equal ends
    PLACE_OLD = 6  # of contacts, m
    FORCE_OLD = 7  # of contacts, N
    PLACE = 8
    FORCE = 9
    TENSION = 10  # of springs, N
    MODE = 11  # of contacts: 0 sticks, +1 slides to the motor, -1 to the joint
    GRIP = 12  # of contacts, tanh(x_i / 2)
    UPPER = 13  # of the elimination
    RIGHT = 14
    BY_MOTOR = 15


def build_chain(
    curve: NDArray[np.float64],
    elements: int,
    stiffness: float,
    length: float,
    series_length: float,
    bristle: float,
    series_at_joint: bool = False,
) -> NDArray[np.float64]:
    """Return the chain of one tendon at rest, shape (rows, elements + 1).

    Args:
        curve: fractions of length and of bending, shape (2, n).
        elements: number of contacts.
        stiffness: E A, N.
        length: length of the tendon, m.
        series_length: E A / k_s, m, of the series spring.
        bristle: stiffness of the whole tendon on its liner, N/m; 0 for a rigid liner.
        series_at_joint: put the series spring behind the last contact, not before the first.
    """
    chain = np.zeros((len(Row), elements + 1))
    edges = np.linspace(0.0, 1.0, elements + 1)
    bends = np.array([_bending(curve, a, b, last=b == 1.0) for a, b in itertools.pairwise(edges)])
    chain[Row.BEND, :elements] = [upper - lower for lower, upper in bends]
    places = np.array([_place(curve, 0.5 * (a + b), e) for (a, b), e in zip(bends, edges[:-1], strict=True)])
    lengths = np.diff(np.concatenate(([0.0], places, [1.0]))) * length
    lengths[-1 if series_at_joint else 0] += series_length
    # Behind a sticking contact, a spring of the length l receives the share EA / (l RIGID) of a change. A bend at the
    # very end of a sheath would have l = 0.
    lengths = np.maximum(lengths, stiffness / (_LEAK * RIGID))
    lengths *= (length + series_length) / lengths.sum()
    chain[Row.STIFFNESS] = stiffness / lengths
    chain[Row.LENGTH_SHARE] = lengths / (length + series_length)
    half = 0.5 * chain[Row.BEND, :elements]
    chain[Row.BEND_SHARE, :elements] += half
    chain[Row.BEND_SHARE, 1:] += half
    chain[Row.BRISTLE, :elements] = bristle * chain[Row.BEND, :elements]
    if bristle <= 0.0:
        chain[Row.BRISTLE, :elements] = np.where(chain[Row.BEND, :elements] > 0.0, RIGID, 0.0)
    return chain


def _bending(curve: NDArray[np.float64], start: float, end: float, last: bool) -> tuple[float, float]:
    """Return the fraction of bending up to each end of an element. A point bend on a border is in the next element."""

    def before(place: float) -> float:
        i = int(np.searchsorted(curve[0], place, side="left"))
        if i == 0:
            return 0.0
        a, b = i - 1, min(i, curve.shape[1] - 1)
        width = curve[0, b] - curve[0, a]
        return float(curve[1, a] + (curve[1, b] - curve[1, a]) * ((place - curve[0, a]) / width if width > 0 else 1.0))

    return before(start), 1.0 if last else before(end)


def _place(curve: NDArray[np.float64], bending: float, otherwise: float) -> float:
    """Return the fraction of length at which this fraction of the bending is reached, at least `otherwise`."""
    i = int(np.searchsorted(curve[1], bending, side="left"))
    if i == 0:
        return max(otherwise, float(curve[0, 0]))
    a, b = i - 1, i
    rise = curve[1, b] - curve[1, a]
    place = curve[0, a] + (curve[0, b] - curve[0, a]) * ((bending - curve[1, a]) / rise if rise > 0.0 else 1.0)
    return max(otherwise, float(place))


_ITERATIONS = 10  # plus one for every second contact: a slip front passes at least one contact per iteration
_FINER, _MOST_PIECES = 8, 512  # refinement factor and most pieces of a movement whose modes were not found at once
_TOLERANCE = 1e-6  # N, between a trial force and its bound
_ROUNDING = 5e-6  # N/m; RIGID times the rounding error of a place, which exceeds the tolerance from 0.2 m on


Pair = tuple[float, float]  # values of tendon a (T1, T2) and of tendon b (T3, T4)
Slopes = tuple[float, float, float, float]  # derivatives of first and last place by motor_end, then by joint_end


_STIFFNESS, _LENGTH_SHARE, _BEND_SHARE = int(Row.STIFFNESS), int(Row.LENGTH_SHARE), int(Row.BEND_SHARE)
_BEND, _BRISTLE, _PRELOAD = int(Row.BEND), int(Row.BRISTLE), int(Row.PRELOAD)
_PLACE_OLD, _FORCE_OLD, _PLACE, _FORCE = int(Row.PLACE_OLD), int(Row.FORCE_OLD), int(Row.PLACE), int(Row.FORCE)
_TENSION, _MODE, _GRIP = int(Row.TENSION), int(Row.MODE), int(Row.GRIP)
_UPPER, _RIGHT, _BY_MOTOR = int(Row.UPPER), int(Row.RIGHT), int(Row.BY_MOTOR)


def settle(chain: NDArray[np.float64], motor_end: float, joint_end: float, pretension: float) -> None:
    """Set the whole tendon to one tension (N) without friction, with its ends at these displacements (m)."""
    count = chain.shape[1] - 1
    share = np.cumsum(chain[Row.LENGTH_SHARE])[:count]
    chain[Row.PLACE_OLD, :count] = chain[Row.PLACE, :count] = motor_end + share * (joint_end - motor_end)
    chain[Row.PLACE_OLD, count] = chain[Row.PLACE, count] = joint_end
    chain[Row.FORCE_OLD, count] = chain[Row.FORCE, count] = motor_end
    chain[Row.TENSION] = pretension


@compiled
def prepare_chains(p: Any, pretensions: Pair, thetas: Pair, x: Pair, chains: Any) -> Pair:
    """Write bending, pretension and friction of both tendons in this sub-step to chains (2, rows, contacts + 1).

    A bend lengthens the path at its own place (3.50). The rest of the pretension is distributed along the tendon.

    Returns:
        The elongation (m) of tendons a and b at equal displacements of motor and joint pulley.
    """
    length = p.length + p.series_length
    total_a, total_b = pretensions[0] * length / p.stiffness, pretensions[1] * length / p.stiffness
    for tendon in range(2):
        chain = chains[tendon]
        n = chain.shape[1] - 1
        angle = x[0] if tendon == 0 else x[1]
        bend = p.bending_arm * ((thetas[0] if tendon == 0 else thetas[1]) - p.theta)
        rest = (total_a if tendon == 0 else total_b) - bend
        for i in range(n + 1):
            chain[_PRELOAD, i] = rest * chain[_LENGTH_SHARE, i] + bend * chain[_BEND_SHARE, i]
        if p.tension_exponent != 0.0:
            for i in range(n):
                local = tension_factor(p, 0.5 * (chain[_TENSION, i] + chain[_TENSION, i + 1]))
                chain[_GRIP, i] = math.tanh(0.5 * angle * local * chain[_BEND, i])
        elif angle != chain[_GRIP, n]:
            chain[_GRIP, n] = angle
            for i in range(n):
                chain[_GRIP, i] = math.tanh(0.5 * angle * chain[_BEND, i])
    return float(total_a), float(total_b)


@compiled
def chain_tensions(p: Any, totals: Pair, chains: Any, u: float, v: float, f: Any) -> bool:
    """Write T1..T4 to f[0:4], and the derivatives of each by u and v to f[4:12].

    Args:
        p: parameter record.
        totals: elongations from `prepare_chains`, m.
        chains: shape (2, rows, contacts + 1).
        u: displacement of the motor pulley, m.
        v: displacement of the joint pulley, m.
        f: receives the tensions and derivatives.

    Returns:
        True if the set of sticking and sliding contacts was found.
    """
    settled = True
    for tendon in range(2):
        side = -1.0 if tendon == 0 else 1.0
        chain = chains[tendon]
        place = 2 * tendon
        torn = p.torn_a if tendon == 0 else p.torn_b
        total = totals[0] if tendon == 0 else totals[1]
        if torn or total + side * (u - v) <= 0.0:
            _slacken(chain, side * u, side * v)
            for i in range(2):
                f[place + i] = f[4 + 2 * (place + i)] = f[5 + 2 * (place + i)] = 0.0
            continue
        settled = _equilibrium(chain, side * u, side * v, place, side, f) and settled
    return settled


@compiled
def _slacken(chain: Any, motor_end: float, joint_end: float) -> None:
    """Set all tensions to 0, and distribute the missing elongation along the tendon."""
    n = chain.shape[1] - 1
    chain[_PLACE, n], chain[_FORCE, n], chain[_MODE, n] = joint_end, motor_end, 0.0
    lack = motor_end - joint_end
    for i in range(n + 1):
        lack += chain[_PRELOAD, i]
    place = motor_end
    for i in range(n + 1):
        chain[_TENSION, i] = 0.0
        if i < n:
            place += chain[_PRELOAD, i] - lack * chain[_LENGTH_SHARE, i]
            chain[_PLACE, i] = place
            chain[_FORCE, i] = 0.0
            chain[_MODE, i] = 0.0


@compiled
def _equilibrium(chain: Any, motor_end: float, joint_end: float, place: int, side: float, f: Any) -> bool:
    """Store the end tensions and their derivatives in f; return True if the modes of all contacts were found."""
    n = chain.shape[1] - 1
    settled, slopes = _find_modes(chain, motor_end, joint_end)
    chain[_MODE, n] = 0.0
    if not settled:
        settled, slopes = _follow(chain, motor_end, joint_end)
        chain[_MODE, n] = 1.0
    chain[_PLACE, n], chain[_FORCE, n] = joint_end, motor_end
    k0, kn = chain[_STIFFNESS, 0], chain[_STIFFNESS, n]
    f[place], f[place + 1] = chain[_TENSION, 0], chain[_TENSION, n]
    f[4 + 2 * place] = side * k0 * (1.0 - slopes[0])
    f[5 + 2 * place] = -side * k0 * slopes[2]
    f[6 + 2 * place] = side * kn * slopes[1]
    f[7 + 2 * place] = side * kn * (slopes[3] - 1.0)
    return settled


@compiled
def _find_modes(chain: Any, motor_end: float, joint_end: float) -> tuple[bool, Slopes]:
    """Find the modes of all contacts by Newton's method, from the present modes; return True if it converged."""
    slopes = (0.0, 0.0, 0.0, 0.0)
    for _ in range((chain.shape[1] - 1) // 2 + _ITERATIONS):
        slopes = _solve(chain, motor_end, joint_end)
        if _sort(chain, motor_end, joint_end):
            return True, slopes
    return False, slopes


@compiled
def _follow(chain: Any, motor_end: float, joint_end: float) -> tuple[bool, Slopes]:
    """Move the ends in pieces if the modes were not found at once: slip fronts meet, or a tendon is nearly slack.

    The dissipated energy is stored in the last column. The old state is not changed.
    """
    n = chain.shape[1] - 1
    old_place, old_force = chain[_PLACE_OLD].copy(), chain[_FORCE_OLD].copy()
    settled, slopes = False, (0.0, 0.0, 0.0, 0.0)
    pieces = 1
    while not settled and pieces < _MOST_PIECES:
        pieces *= _FINER
        taken = 0.0
        for i in range(n):
            chain[_MODE, i] = 0.0
        for piece in range(1, pieces + 1):
            w = piece / pieces
            motor, joint = old_force[n] + w * (motor_end - old_force[n]), old_place[n] + w * (joint_end - old_place[n])
            settled, slopes = _find_modes(chain, motor, joint)
            taken += _taken(chain)
            for i in range(n):
                chain[_PLACE_OLD, i], chain[_FORCE_OLD, i] = chain[_PLACE, i], chain[_FORCE, i]
        chain[_BRISTLE, n] = taken
        chain[_PLACE_OLD], chain[_FORCE_OLD] = old_place, old_force
    return settled, slopes


@compiled
def _solve(chain: Any, motor_end: float, joint_end: float) -> Slopes:
    """Compute the places of all contacts for the present modes by the Thomas algorithm."""
    n = chain.shape[1] - 1
    upper = right = by_motor = by_joint = 0.0
    for i in range(n):
        ka, kb = chain[_STIFFNESS, i], chain[_STIFFNESS, i + 1]
        mode = chain[_MODE, i]
        if mode == 0.0:
            bristle = chain[_BRISTLE, i]
            a, c = ka, kb
            b = -(ka + kb + bristle)
            d = chain[_FORCE_OLD, i] - bristle * chain[_PLACE_OLD, i]
        else:
            grip = mode * chain[_GRIP, i]
            a, c = ka * (1.0 - grip), kb * (1.0 + grip)
            b = -(a + c)
            d = 0.0
        d += c * chain[_PRELOAD, i + 1] - a * chain[_PRELOAD, i]
        e = 0.0
        if i == 0:
            d -= a * motor_end
            e, a = -a, 0.0
        if i == n - 1:
            d -= c * joint_end
            by_joint, c = -c, 0.0
        pivot = 1.0 / (b - a * upper)
        right = (d - a * right) * pivot
        by_motor = (e - a * by_motor) * pivot
        by_joint *= pivot
        upper = c * pivot
        chain[_UPPER, i], chain[_RIGHT, i], chain[_BY_MOTOR, i] = upper, right, by_motor
    chain[_PLACE, n - 1] = right
    last_by_motor, last_by_joint = by_motor, by_joint
    for i in range(n - 2, -1, -1):
        upper = chain[_UPPER, i]
        chain[_PLACE, i] = chain[_RIGHT, i] - upper * chain[_PLACE, i + 1]
        by_motor = chain[_BY_MOTOR, i] - upper * by_motor
        by_joint *= -upper
    return by_motor, last_by_motor, by_joint, last_by_joint


@compiled
def _sort(chain: Any, motor_end: float, joint_end: float) -> bool:
    """Compute tensions and friction forces at these places, and correct the modes. Return True if none changed."""
    n = chain.shape[1] - 1
    left = motor_end
    for i in range(n + 1):
        right = chain[_PLACE, i] if i < n else joint_end
        chain[_TENSION, i] = chain[_STIFFNESS, i] * (left - right + chain[_PRELOAD, i])
        left = right
    settled = True
    tolerance = max(_TOLERANCE, _ROUNDING * abs(joint_end))
    for i in range(n):
        bound = chain[_GRIP, i] * max(0.0, chain[_TENSION, i] + chain[_TENSION, i + 1])
        trial = chain[_FORCE_OLD, i] + chain[_BRISTLE, i] * (chain[_PLACE, i] - chain[_PLACE_OLD, i])
        mode = chain[_MODE, i]
        if mode == 0.0:
            chain[_FORCE, i] = trial
            if abs(trial) > bound + tolerance:
                chain[_MODE, i], settled = math.copysign(1.0, trial), False
        else:
            chain[_FORCE, i] = mode * bound
            if mode * trial < bound - tolerance:
                chain[_MODE, i], settled = 0.0, False
    return settled


@compiled
def _taken(chain: Any) -> float:
    """Return the energy in J that friction dissipates between the old state and the solution."""
    taken = 0.0
    for i in range(chain.shape[1] - 1):
        force, moved = chain[_FORCE, i], chain[_PLACE, i] - chain[_PLACE_OLD, i]
        if chain[_BRISTLE, i] > 0.0:
            moved -= (force - chain[_FORCE_OLD, i]) / chain[_BRISTLE, i]
        taken += force * moved
    return taken


@compiled
def commit_chains(chains: Any) -> tuple[float, float]:
    """Store the solution as the initial state of the next sub-step.

    Returns:
        The energy that friction dissipated (J), and the used share of the friction, -1 to 1. The share is the mean over
        the bending of both tendons. It is positive while they slide and the joint moves forward.
    """
    taken = used = 0.0
    for tendon in range(chains.shape[0]):
        chain = chains[tendon]
        n = chain.shape[1] - 1
        side = -0.5 if tendon == 0 else 0.5
        taken += chain[_BRISTLE, n] if chain[_MODE, n] != 0.0 else _taken(chain)
        for i in range(n + 1):
            chain[_PLACE_OLD, i], chain[_FORCE_OLD, i] = chain[_PLACE, i], chain[_FORCE, i]
        for i in range(n):
            bound = chain[_GRIP, i] * (chain[_TENSION, i] + chain[_TENSION, i + 1])
            if bound > 0.0:
                used += side * chain[_BEND, i] * chain[_FORCE, i] / bound
    return taken, used
