"""Check that a controller can invert a formula f, on a grid of the signals and of the memories of f.

tau - f must increase with tau within one period of the loop, for every possible state of the memories. It must also
increase in steady state, because the inverse would otherwise diverge slowly. For a formula with a memory there are two
more conditions. At least the share `LEAST` of a change of tau must have an effect within one period; otherwise the
inverse differentiates the set-point. The inverse of small changes must be stable: no pole outside the unit circle.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.effects.custom import NAMES, Custom
from tsa_ctrl.model.effects.lever import unmoved
from tsa_ctrl.model.expression import Remember
from tsa_ctrl.model.functions import Array

GRID, POINTS = 7, 401  # points per signal, and of the torque, at which the inverse is checked
COARSE, COARSEST = 3, 2  # points per signal if there are many signals, to keep the grid at about a thousand points
NEAR = 1e-6  # N*m, step for the slope: small, so that a wave in the formula cannot alias with the step
LEAST = 0.05  # least share of a change that acts within one period, with a memory; set-points have steps and noise
REACH = {"omega_j": 10.0, "q_j": math.pi, "q_m": math.pi, "sigma": 1.0, "t": 1.0, "temperature": 60.0}
LOADS = 5  # number of torques about which the inverse of small changes is checked
SMALL = 1e-3  # of the largest torque: size of a small change, for which the formula is nearly linear
SETTLES = 1e-5  # tolerance of the unit circle: divergence slower than 100 s at 1 kHz is found by the steady state


def check_invertible(custom: Custom, largest: float, period: float, where: str) -> None:
    """Raise UsageError unless a loop of `period` s can invert the formula everywhere up to `largest` N*m."""
    program = custom.program
    if not program.uses("tau"):
        return
    tau, number = np.linspace(-largest, largest, POINTS), len(program.memories)
    spans = {period: LEAST, math.inf: 0.0} if number else {period: 0.0}  # s, and the least share that acts by then
    for known in _places([name for name in REACH if program.uses(name)], number):
        for (elapsed, least), parts in product(spans.items(), _levels(number)):
            passes = _passed(custom, tau, known, parts, elapsed) > least
            if not passes.all():
                comes = (
                    "does not increase" if least == 0.0 else f"increases by less than {100.0 * least:g} % of the input"
                )
                when = (
                    ""
                    if not number
                    else " in the steady state"
                    if elapsed == math.inf
                    else f" within {1e3 * period:g} ms"
                )
                said = f"with rising input torque the output torque {comes}{when}"
                raise _refused(where, float(tau[int(np.argmin(passes))]), known, said)
        for torque, sticks in product(np.linspace(-largest, largest, LOADS) if number else (), (True, False)):
            if not _settles(custom, float(torque), known, sticks, period, SMALL * largest):
                raise _refused(where, float(torque), known, "the torque that compensates for it grows without bound")


def _refused(where: str, tau: float, known: Mapping[str, float], said: str) -> UsageError:
    place = ", ".join(f"{name} = {value:.3g}" for name, value in known.items())
    return UsageError(
        f"{where}: [effects.custom] cannot be inverted: at tau = {tau:.3g} N*m ({place or 'anywhere'}) {said}; "
        "give a formula with a smaller effect"
    )


def _places(used: Sequence[str], memories: int) -> Iterator[dict[str, float]]:
    """Return a grid of values of the signals in the formula; it is coarser if there are many signals and memories."""
    many = len(used) + memories
    count = GRID if many < 4 else COARSE if many < 7 else COARSEST
    spans = [np.linspace(-REACH[name], REACH[name], count) for name in used]
    for point in np.array(np.meshgrid(*spans)).reshape(len(used), -1).T if used else np.zeros((1, 0)):
        yield dict(zip(used, point.tolist(), strict=True))


def _levels(number: int) -> Array:
    """Return combinations of states of the memories, (m, number), from -1 to 1 within the range of each memory."""
    return np.array(np.meshgrid(*[(-1.0, 0.0, 1.0)] * number)).reshape(number, -1).T if number else np.zeros((1, 0))


def _passed(custom: Custom, tau: Array, known: Mapping[str, float], parts: Array, elapsed: float) -> Array:
    """Return d(tau - f)/d tau at each tau, after `elapsed` s (inf: in steady state).

    `parts`: initial states of the memories, -1 to 1.
    """
    program, first = custom.program, dict[int, tuple[Array, Array]]()

    def before(index: int, x: Array) -> Array:
        x = np.broadcast_to(x, tau.shape)
        memory = program.memories[index]
        settled = elapsed == math.inf and memory.kind != "dahl"
        level = x if settled else memory.level(x, parts[index])
        first[index] = x, level
        return level

    def after(index: int, x: Array) -> Array:
        at, level = first[index]
        return program.memories[index].passes(level, x - at, elapsed)

    def left(at: Array, remember: Remember[Array]) -> Array:
        values = [at if name == "tau" else np.asarray(known.get(name, 0.0)) for name in NAMES]
        return at - program.array(values, remember)

    below = left(tau, before)
    return np.asarray((left(tau + NEAR, after) - below) / NEAR)


def _settles(
    custom: Custom, torque: float, known: Mapping[str, float], sticks: bool, period: float, small: float
) -> bool:
    """Return True if the inverse about a torque (N*m) at rest is stable, by the eigenvalues of a cycle of the lags.

    For small changes, a hysteresis acts as a spring while it sticks, and has no effect while it slides.
    """
    state, memories = unmoved(0.0), custom.memories()
    state.q_j = state.q_m = state.temperature = 0.0
    for name, value in known.items():
        setattr(state, "omega" if name == "omega_j" else name, value)
    wanted = custom.left(torque, state, memories)
    pairs = list(zip(memories.parts, custom.program.memories, strict=True))
    lags = [part for part, memory in pairs if memory.kind != "dahl"]
    others = [part for part, memory in pairs if memory.kind == "dahl"]
    rest = {id(part): part.resting(part.asked) for part in memories.parts}
    flat = np.concatenate([np.zeros(0), *(rest[id(part)] for part in lags)])

    def cycled(numbers: Array) -> Array:
        at = 0
        for part in lags:
            own = len(rest[id(part)])
            part.set(numbers[at : at + own].tolist())
            at += own
        for part in others:
            part.set(rest[id(part)] if sticks else ())
        for part in memories.parts:
            part.begin(period)
        custom.left(custom.invert(wanted, state, memories), state, memories)
        for part in lags:
            part.keep(part.asked)
        return np.concatenate([part.get() for part in lags])

    if not lags:
        return True
    moved = small * np.eye(len(flat))
    matrix = np.column_stack([(cycled(flat + each) - cycled(flat - each)) / (2.0 * small) for each in moved])
    if not np.isfinite(matrix).all():
        return False
    return bool(np.max(np.abs(np.linalg.eigvals(matrix))) < 1.0 + SETTLES)
