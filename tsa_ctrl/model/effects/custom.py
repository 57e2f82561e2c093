"""Define an effect by a formula of the user, because it is not in the catalogue. Source: explanation of a residual.

    stage "joint": tau_J -= f(..., tau = torque of the tendons at the joint, after backlash)
    stage "motor": tau_M -= f(..., tau = motor torque after the effects of the motor's side)

It is the last effect on its side. If f depends on tau, the inverse is computed numerically, and tau - f must increase
with tau. The memory of f (`filters`) is reset for each log and at each enable. It does not change while the inverse is
computed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, Literal, cast

import numpy as np

from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.effects.lever import State
from tsa_ctrl.model.effects.specification import Columns, Parameter, Setting, Specification, Stage
from tsa_ctrl.model.expression import Program, parse
from tsa_ctrl.model.filters import Memories
from tsa_ctrl.model.functions import Array, F

NAMES = ("omega_j", "q_j", "q_m", "tau", "sigma", "t", "temperature")
NEEDS = ("q_j", "q_m", "temperature")  # columns that a log may lack
CLOSE = 1e-11  # N*m; tolerance of the inverse: as exact as the effects with a closed-form inverse
# Limits of the inverse. The doublings extend its bracket from 1 mN*m to more than the torque of any joint. The steps
# then suffice to reach `CLOSE`.
MOST_DOUBLINGS, MOST_STEPS = 24, 40


def _columns(parameters: Mapping[str, Setting]) -> Columns:
    """Return the columns of the formula that a log may lack."""
    program = cast(Custom, Specification.of(Custom).build(parameters)).program
    return tuple((name,) for name in NEEDS if program.uses(name))


@dataclass(frozen=True)
class Custom:
    """Define the formula f by its text and its named constants."""

    expression: Annotated[str, Parameter("N*m", text=True)]
    stage: Annotated[Literal["joint", "motor"], Parameter(choices=("joint", "motor"))] = "joint"

    specification: ClassVar = Specification(
        name="custom",
        stage=Stage.JOINT,
        summary="a formula of the model file",
        search=lambda name, scales: (),  # the user's formula is not a hypothesis
        constants=Parameter(),
        hypothesis=False,
        live_columns=_columns,
        equation="τ_J ← τ_J − f(ω, q, τ, σ, t, T)",
    )

    constants: tuple[tuple[str, float], ...] = ()

    @cached_property
    def program(self) -> Program:
        """Return the parsed formula; raises UsageError if it is invalid."""
        return parse(self.expression, NAMES, dict(self.constants), "[effects.custom] expression")

    def memories(self) -> Memories:
        """Return new memories of the formula for evaluation cycle by cycle."""
        return Memories(self.program.memories)

    def taken(self, tau: Array, state: State[Array]) -> Array:
        """Return f over a whole log, N*m, shape (n); raises UsageError if a value is not finite."""
        taken = np.broadcast_to(self.program.over(self._signals(tau, state), state.t), np.shape(tau))
        if not np.isfinite(taken).all():
            row = int(np.argmin(np.isfinite(taken)))
            raise UsageError(
                f"[effects.custom] expression '{self.expression}' has no finite value at tau = {tau[row]:.4g} N*m and "
                f"{float(np.broadcast_to(state.omega, np.shape(tau))[row]):.4g} rad/s; change it so that its value "
                "is always finite"
            )
        return taken

    def invert(self, wanted: float, state: State[float], memories: Memories) -> float:
        """Return tau with tau - f(tau) = `wanted`, N*m; nan if no solution is found. The memories do not change."""
        if not math.isfinite(wanted):
            return wanted
        if not self.program.uses("tau"):
            return wanted + self._value(0.0, state, memories)
        low, high, span = wanted, wanted, 1e-3 + abs(wanted)
        below, above = self.left(low, state, memories) - wanted, 0.0
        if below == 0.0:
            return low
        for _ in range(MOST_DOUBLINGS):  # in the direction that reduces the error
            step = span if below < 0.0 else -span
            high = low + step
            above = self.left(high, state, memories) - wanted
            if below * above <= 0.0:
                break
            low, below, span = high, above, 2.0 * span
        else:
            return math.nan
        for number in range(MOST_STEPS):  # the Illinois method, with a bisection in every fourth step in case f jumps
            middle = 0.5 * (low + high) if number % 4 == 3 else (low * above - high * below) / (above - below)
            left = self.left(middle, state, memories) - wanted
            if abs(left) < CLOSE:
                return middle
            if left * above < 0.0:
                low, below = high, above
            elif number % 4 != 3:
                below *= 0.5
            high, above = middle, left
        return 0.5 * (low + high)

    def accept(self, tau: float, state: State[float], memories: Memories) -> None:
        """Accept `tau` (N*m) as the torque of this cycle; the memories store it when the next cycle begins."""
        if memories.parts and math.isfinite(tau):
            self._value(tau, state, memories)
            memories.accept()

    def left(self, tau: float, state: State[float], memories: Memories) -> float:
        """Return tau - f(tau), N*m; nan if the formula has no value."""
        return tau - self._value(tau, state, memories)

    def _value(self, tau: float, state: State[float], memories: Memories) -> float:
        return self.program.value(self._signals(tau, state), memories.parts)

    def _signals(self, tau: F, state: State[F]) -> tuple[F, ...]:
        return (state.omega, state.q_j, state.q_m, tau, state.sigma, state.t, state.temperature)
