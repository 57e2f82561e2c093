"""What friction in the joint takes of the torque B (N*m) that the transmission delivers. Source: the catalogue."""

from __future__ import annotations

from dataclasses import dataclass

from tsa_ctrl.model.functions import F, Functions


@dataclass(frozen=True)
class LoadDependentFriction:
    """tau_J -= sigma k abs(tau_J), that is tau_J = B/(1 + sigma k sign(B))."""

    coefficient: float  # k, 1

    def apply(self, functions: Functions[F], torque: F, sigma: F) -> F:
        return torque / (1.0 + self.coefficient * sigma * functions.sign(torque))

    def invert(self, functions: Functions[F], tau_j: F, sigma: F) -> F:
        return tau_j * (1.0 + self.coefficient * sigma * functions.sign(tau_j))

    def required(self, functions: Functions[F], torque: F, sigma: F) -> F:
        """The input torque that a plain drive needs: tau = torque + sigma k abs(tau)."""
        return torque / (1.0 - self.coefficient * sigma * functions.sign(torque))
