"""Turn a hypothesis (base model and effects) into comparable residuals: whitened, with the nuisance projected out."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.diagnosis.data.frame import Frame
from tsa_ctrl.identify.diagnosis.hypotheses.base import Base
from tsa_ctrl.identify.diagnosis.noise.autoregressive import Noise
from tsa_ctrl.identify.diagnosis.noise.nuisance import Nuisance, Projection
from tsa_ctrl.model.effects.search import Coordinate, Value, Variant
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model
from tsa_ctrl.model.predict import predict_each


@dataclass(frozen=True)
class Hypothesis:
    """The base model with these effects; with `wide_prior`, recalibration ignores [uncertainty]."""

    base: Base
    variants: tuple[Variant, ...] = ()
    wide_prior: bool = False

    @cached_property
    def coordinates(self) -> tuple[Coordinate, ...]:
        own = [c for variant in self.variants for c in variant.coordinates]
        return (*self.base.coordinates(self.wide_prior), *own)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(variant.effect for variant in self.variants)

    @cached_property
    def low(self) -> Array:
        return np.array([c.low for c in self.coordinates])

    @cached_property
    def high(self) -> Array:
        return np.array([c.high for c in self.coordinates])

    @cached_property
    def steps(self) -> Array:
        return np.array([c.step for c in self.coordinates])

    @cached_property
    def nonsmooth(self) -> NDArray[np.bool_]:
        """Return a mask of the coordinates along which the prediction jumps: those of effects without an amplitude."""
        own = [not variant.amplitude for variant in self.variants for _ in variant.coordinates]
        return np.array([False] * len(self.base.coordinates(self.wide_prior)) + own, dtype=np.bool_)

    @cached_property
    def places(self) -> tuple[slice, ...]:
        """Return the slice of each variant's coordinates."""
        ends = np.cumsum([len(self.base.coordinates()), *(len(variant.coordinates) for variant in self.variants)])
        return tuple(slice(int(start), int(end)) for start, end in pairwise(ends))

    def own(self, point: Array) -> list[Array]:
        """Return the values of each variant's coordinates."""
        return [point[place] for place in self.places]

    def effects(self, point: Array) -> dict[str, dict[str, Value]]:
        return {v.effect: v.parameters(u) for v, u in zip(self.variants, self.own(point), strict=True)}

    def model(self, point: Array) -> Model:
        return self.base.build(point[: len(self.base.coordinates())], self.effects(point))

    def plus(self, variant: Variant) -> Hypothesis:
        return dataclasses.replace(self, variants=(*self.variants, variant))

    def without(self, index: int) -> Hypothesis:
        return dataclasses.replace(self, variants=self.variants[:index] + self.variants[index + 1 :])


@dataclass(frozen=True)
class Problem:
    """Measured torques against hypotheses, under one noise model."""

    frame: Frame
    base: Base
    noise: Noise
    nuisance: Nuisance
    mask: NDArray[np.bool_]  # (n,), samples that count

    @cached_property
    def projection(self) -> Projection:
        """Return the projector that removes the nuisance from white vectors."""
        return self.nuisance.projection(self.noise, self.mask, self.frame.slices)

    @property
    def count(self) -> int:
        return int(self.mask.sum())

    @cached_property
    def blocks(self) -> NDArray[np.int64]:
        """Return the block numbers of the samples that count, 0 .. B - 1."""
        return np.unique(self.frame.blocks[self.mask], return_inverse=True)[1].astype(np.int64)

    def predicted(self, model: Model) -> Array:
        """Return the model's torque at the score rate, N*m, shape (n,)."""
        return self.frame.stack(predict_each(model, [run.signals for run in self.frame.runs]))

    def whiten(self, y: Array) -> Array:
        """Return `y`, (n,) or (n, k) in N*m, in white units at the samples that count, with the nuisance projected out.

        Raises:
            FloatingPointError: a torque is not finite.
        """
        if not np.isfinite(y).all():
            raise FloatingPointError("a torque that is not finite")
        return self.projection.apply(self.noise.whiten(y, self.frame.slices)[self.mask])

    @cached_property
    def measured(self) -> Array:
        return self.whiten(self.frame.target)

    def with_noise(self, noise: Noise) -> Problem:
        return dataclasses.replace(self, noise=noise)


def orthonormal(columns: Array, tolerance: float = 1e-7) -> Array:
    """Return an orthonormal basis of the span of `columns` (n, k), shape (n, rank)."""
    if columns.shape[1] == 0:
        return columns
    norms = np.linalg.norm(columns, axis=0)
    scaled: Array = columns[:, norms > 0.0] / norms[norms > 0.0]
    if scaled.shape[1] == 0:
        return scaled
    gram = scaled.T @ scaled
    values, vectors = np.linalg.eigh(gram)
    keep = values > tolerance**2 * max(values[-1], 1e-300) + 1e-10
    basis = scaled @ (vectors[:, keep] / np.sqrt(values[keep]))
    gram = basis.T @ basis  # a second pass removes the errors that the smallest eigenvalues amplify
    values, vectors = np.linalg.eigh(gram)
    return np.asarray(basis @ (vectors / np.sqrt(values)))
