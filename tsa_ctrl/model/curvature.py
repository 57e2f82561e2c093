"""Elongation integrals alpha and beta, (3.36) and (3.39), for any curvature along the sheath.

    Theta(s) = integral of kappa from the motor end to s,
    alpha = integral over l_us of exp(+sigma mu Theta(s)) ds,     beta the same with exp(-sigma mu Theta(s))

kappa in 1/m, s and l_us in m, Theta in rad. Source: section 3.2, (3.31)-(3.39); figure 3-19.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.functions import Array, F, Functions

_NODES = 16  # per panel: exact for polynomials of degree 31
_PANELS = 32  # between two breaks


class Elongation(NamedTuple):
    """alpha and beta in m, and the total bending angle in rad."""

    alpha: float
    beta: float
    bending_angle: float


@dataclass(frozen=True)
class Curvature:
    """Curvature along a sheath from the motor end, s = 0, to the joint end, s = length.

    `kappa(s)` takes and returns arrays, 1/m; `breaks` are places in m where it jumps (the quadrature is split there);
    `bends` are (place in m, angle in rad) of bends sharp enough to be points.
    """

    length: float
    kappa: Callable[[Array], Array] | None = None
    breaks: tuple[float, ...] = ()
    bends: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        if not self.length > 0.0:
            raise UsageError(f"curvature: length = {self.length!r} m; give a length above 0")
        for place in (*self.breaks, *(place for place, _ in self.bends)):
            if not 0.0 <= place <= self.length:
                raise UsageError(f"curvature: s = {place!r} m is outside the sheath; allowed is 0 to {self.length:g} m")

    def elongation(self, friction: float) -> Elongation:
        """alpha, beta and Theta for `friction` = sigma mu; Gauss-Legendre panels, smooth kappa to machine precision."""
        nodes, weights, antiderivative = _rule()
        cuts = sorted({0.0, self.length, *self.breaks, *(place for place, _ in self.bends)})
        theta = sum(angle for place, angle in self.bends if place == 0.0)
        alpha = beta = 0.0
        for low, high in itertools.pairwise(cuts):
            edges = np.linspace(low, high, _PANELS + 1)
            half = (high - low) / (2 * _PANELS)
            s = edges[:-1, None] + half * (nodes + 1.0)
            kappa = np.zeros_like(s) if self.kappa is None else np.broadcast_to(self.kappa(s), s.shape)
            per_panel = half * (kappa @ weights)
            start = theta + np.concatenate([[0.0], np.cumsum(per_panel)[:-1]])
            along = friction * (start[:, None] + half * (kappa @ antiderivative))
            alpha += half * float((np.exp(along) @ weights).sum())
            beta += half * float((np.exp(-along) @ weights).sum())
            theta += float(per_panel.sum()) + sum(angle for place, angle in self.bends if place == high)
        return Elongation(alpha, beta, theta)


def uniform(length: float, bending_angle: float) -> Curvature:
    """The same curvature everywhere."""
    return Curvature(length, kappa=lambda s: np.full_like(s, bending_angle / length))


def motor_end(length: float, bending_angle: float) -> Curvature:
    """All curvature at s = 0: the extreme of figure 3-19."""
    return Curvature(length, bends=((0.0, bending_angle),))


def joint_end(length: float, bending_angle: float) -> Curvature:
    """All curvature at s = length: (3.55) is exact."""
    return Curvature(length, bends=((length, bending_angle),))


def uniform_elongation(functions: Functions[F], x: F) -> tuple[F, F]:
    """(alpha, beta)/l_us of the uniform profile: (exp(x) - 1)/x and (1 - exp(-x))/x at the signed friction angle x."""
    return functions.expm1_ratio(x), functions.expm1_ratio(-x)


def motor_end_elongation(functions: Functions[F], x: F) -> tuple[F, F]:
    """(alpha, beta)/l_us with all curvature at the motor end: exp(x) and exp(-x)."""
    return functions.exp(x), functions.exp(-x)


@cache
def _rule() -> tuple[Array, Array, Array]:
    """Gauss-Legendre nodes and weights on [-1, 1], and M with (f @ M)[i] = integral of f from -1 to node i."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    vander = np.polynomial.legendre.legvander(nodes, _NODES - 1)
    integrals = np.empty_like(vander)
    for degree in range(_NODES):
        basis = np.zeros(_NODES)
        basis[degree] = 1.0
        integrals[:, degree] = np.polynomial.legendre.legval(nodes, np.polynomial.legendre.legint(basis, lbnd=-1))
    return np.asarray(nodes), np.asarray(weights), np.asarray(np.linalg.solve(vander.T, integrals.T), dtype=np.float64)
