"""Effects on the bending angle Theta (rad) and on the pretension T_p (N), in their order of composition.

Source: the catalogue of effects; T_p below 0 is slack and is cut off after each step by the composition.
"""

from __future__ import annotations

from dataclasses import dataclass

from tsa_ctrl.model.effects.state import State
from tsa_ctrl.model.functions import F, Functions


@dataclass(frozen=True)
class ConfigurationDependentBending:
    """Theta += k q; the path length and with it T_p follow by (3.50), (3.56): T_p += k_t (p + d/2) k q."""

    bending_per_joint_angle: float  # k, rad/rad

    def bending(self, theta: F, state: State[F]) -> F:
        return theta + self.bending_per_joint_angle * state.q_j


@dataclass(frozen=True)
class StiffnessNonlinearity:
    """T_p = T_p0 (1 + k T_p0/EA): the tendon stiffens with tension."""

    quadratic: float  # k, 1

    def pretension(self, pretension: F, axial_stiffness: float) -> F:
        return pretension * (1.0 + self.quadratic / axial_stiffness * pretension)


@dataclass(frozen=True)
class PretensionRelaxation:
    """T_p *= 1 - c (1 - exp(-(t - t_0)/T)), or 1 - c log10(1 + (t - t_0)/T); nothing before t_0."""

    relaxed_fraction: float  # c, 1
    time_constant: float  # T, s
    law: str = "exponential"
    start_time: float | None = None  # t_0, s; None: the log's first sample

    def factor(self, functions: Functions[F], state: State[F]) -> F:
        start = state.start if self.start_time is None else self.start_time
        elapsed = functions.at_least((state.t - start) / self.time_constant, 0.0)
        if self.law == "logarithmic":
            return 1.0 - self.relaxed_fraction * functions.log10(1.0 + elapsed)
        return 1.0 + self.relaxed_fraction * functions.expm1(-elapsed)
