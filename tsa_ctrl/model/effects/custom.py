"""A formula of the user's own in place of an effect that the catalogue lacks. Source: what a residual was found to be.

    stage "joint": tau_J -= f(..., tau = torque of the tendons at the joint, after backlash)
    stage "motor": tau_M -= f(..., tau = motor torque after the effects of the motor's side)

It comes last of its side. Where f depends on tau the inverse is solved for, which needs tau - f to grow with tau.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, Literal, cast

import numpy as np

from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.effects.specification import Columns, Parameter, Setting, Shown, Specification, Stage
from tsa_ctrl.model.effects.state import State
from tsa_ctrl.model.expression import Program, parse
from tsa_ctrl.model.functions import Array

NAMES = ("omega_j", "q_j", "q_m", "tau", "sigma", "t", "temperature")
NEEDS = {"q_j": ("q_j",), "q_m": ("q_m",), "temperature": ("temperature",)}  # columns that a log may lack
CLOSE = 1e-11  # N*m; what the inverse is solved to: as exact as the effects with an inverse of their own
MOST_DOUBLINGS, MOST_STEPS = (
    24,
    40,
)  # of the inverse: from 1 mN*m to more than any joint bears; then halves
GRID, POINTS = 7, 401  # points per signal, and of the torque, at which the inverse is looked at
NEAR = 1e-6  # N*m, over which its slope is taken: local, so that no wave is missed by being met in step


def _columns(parameters: Mapping[str, Setting]) -> Columns:
    """The signals that the formula has in it, of those that may lack."""
    program = cast(Custom, Specification.of(Custom).build(parameters)).program
    return tuple(columns for name, columns in NEEDS.items() if program.uses(name))


@dataclass(frozen=True)
class Custom:
    """f by its text and named constants."""

    expression: Annotated[str, Parameter("N*m", text=True)]
    stage: Annotated[Literal["joint", "motor"], Parameter(choices=("joint", "motor"))] = "joint"

    specification: ClassVar = Specification(
        name="custom",
        stage=Stage.JOINT,
        summary="a formula of the model file",
        search=lambda name, scales: (),  # the user's own formula is no hypothesis
        named=True,
        live_columns=_columns,
        shown=Shown({"expression": "k*sin(3*q_j)", "k": 0.08}, "angle", "τ_J ← τ_J − f(ω, q, τ, σ, t, T)", short=True),
    )

    constants: tuple[tuple[str, float], ...] = ()

    @cached_property
    def program(self) -> Program:
        """The formula read; raises UsageError."""
        return parse(self.expression, NAMES, dict(self.constants), "[effects.custom] expression")

    def taken(self, tau: Array, state: State[Array]) -> Array:
        """f over a log, N*m, shape (n); UsageError where the formula has no value."""
        values = (state.omega, state.q_j, state.q_m, tau, state.sigma, state.t, state.temperature)
        taken = np.broadcast_to(self.program.array(values), np.shape(tau))
        if not np.isfinite(taken).all():
            row = int(np.argmin(np.isfinite(taken)))
            raise UsageError(
                f"[effects.custom] expression '{self.expression}' has no finite value at tau = {tau[row]:.4g} N*m and "
                f"{float(np.broadcast_to(state.omega, np.shape(tau))[row]):.4g} rad/s; change it so that it has one"
            )
        return taken

    def invert(self, wanted: float, state: State[float]) -> float:
        """tau with tau - f(tau) = wanted, N*m; nan where the formula has no value."""
        if not math.isfinite(wanted):
            return wanted
        if not self.program.uses("tau"):
            return wanted + self._value(0.0, state)
        low, high, span = wanted, wanted, 1e-3 + abs(wanted)
        below, above = self._left(low, state) - wanted, 0.0
        if below == 0.0:
            return low
        for _ in range(MOST_DOUBLINGS):  # towards the side that lacks
            step = span if below < 0.0 else -span
            high = low + step
            above = self._left(high, state) - wanted
            if below * above <= 0.0:
                break
            low, below, span = high, above, 2.0 * span
        else:
            return math.nan
        for number in range(MOST_STEPS):
            middle = 0.5 * (low + high) if number % 2 else (low * above - high * below) / (above - below)
            left = self._left(middle, state) - wanted
            if abs(left) < CLOSE:
                return middle
            if left * below > 0.0:
                low, below = middle, left
            else:
                high, above = middle, left
        return 0.5 * (low + high)

    def check_invertible(self, largest: float, where: str) -> None:
        """Raise UsageError unless tau - f grows with tau everywhere up to `largest` N*m, on a grid of the signals."""
        if not self.program.uses("tau"):
            return
        tau = np.linspace(-largest, largest, POINTS)
        axes = {"omega_j": 10.0, "q_j": math.pi, "q_m": math.pi, "sigma": 1.0, "t": 1.0, "temperature": 60.0}
        used = [name for name in axes if self.program.uses(name)]
        spans = [np.linspace(-axes[name], axes[name], GRID if len(used) < 4 else 3) for name in used]
        for point in np.array(np.meshgrid(*spans)).reshape(len(used), -1).T if used else np.zeros((1, 0)):
            known = dict(zip(used, point, strict=True))
            below, above = (
                at - self.program.array([at if name == "tau" else np.asarray(known.get(name, 0.0)) for name in NAMES])
                for at in (tau, tau + NEAR)
            )
            grows = above > below
            if not grows.all():
                worst = tau[int(np.argmin(grows))]
                place = ", ".join(f"{name} = {value:.3g}" for name, value in known.items())
                raise UsageError(
                    f"{where}: [effects.custom] cannot be inverted: at tau = {worst:.3g} N*m ({place or 'anywhere'}) "
                    "more torque going in gives no more coming out; a controller needs a formula that takes less"
                )

    def _left(self, tau: float, state: State[float]) -> float:
        return tau - self._value(tau, state)

    def _value(self, tau: float, state: State[float]) -> float:
        return self.program.value((state.omega, state.q_j, state.q_m, tau, state.sigma, state.t, state.temperature))
