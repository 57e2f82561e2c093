"""Detect the torque ripple of the motor as one sinusoid over the motor angle, and add it to an estimate.

    tau_J - predicted = a A sin(N q_M + phi) + offset of the direction        a: slope of the model, by direction

Every integer N of a range is fitted by least squares to the samples with certain sliding. The best N is accepted if the
wave that each half of the time blocks selects reduces the error of the other half. A run on the rig decides whether the
wave is used. Source: `torque_ripple` in the catalogue.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.identify.calibrate.prepared import prepare
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.steady_sliding import sliding
from tsa_ctrl.tune.estimate import Estimate

FloatArray = NDArray[np.float64]

EFFECT = "torque_ripple"
FEWEST = 1.0  # cycles within the motion: less of a wave is a parabola, like other errors of the model
MOST = 120  # cycles per revolution: slots times poles of usual motors
SURE = 2.5  # standard errors over the blocks by which the error of the other half must decrease


def with_torque_ripple(found: Estimate, logs: Sequence[Dataset]) -> Estimate | None:
    """Return the estimate with the torque ripple that the logs show, or None if they show none.

    Args:
        found: estimate whose model has no torque ripple.
        logs: sliding motions with `q_m` (rad), `tau_m` and `tau_j` (N*m).
    """
    if EFFECT in found.model.effects or any("q_m" not in log.columns for log in logs):
        return None
    samples = _samples(logs, found.model)
    if samples is None:
        return None
    fewest = math.ceil(FEWEST * 2.0 * math.pi / max(float(np.ptp(samples.angle)), 1e-9))
    candidates = range(max(1, fewest), MOST + 1)
    if not candidates or not _holds(samples, candidates):
        return None
    cycles = _best(samples, candidates)
    cosine, sine = _fit(samples.design(cycles), samples.error)[2:]
    values = {
        "amplitude": math.hypot(cosine, sine),
        "cycles_per_revolution": cycles,
        "phase": math.atan2(cosine, sine),
    }
    model = found.model.with_effects({**found.model.effects, EFFECT: values})
    note = (
        f"the motor has a torque ripple of {1e3 * values['amplitude']:.1f} mN·m with {cycles} cycles per revolution; "
        "law and estimator take it into account"
    )
    return dataclasses.replace(
        found,
        model=model,
        calibration=dataclasses.replace(found.calibration, model=model),
        effects=(*found.effects, EFFECT),
        notes=(*found.notes, note),
        plain=None,
    )


@dataclasses.dataclass(frozen=True)
class _Samples:
    """The samples during which the tendons certainly slide, (n,) each.

    Attributes:
        error: prediction error, N*m at the motor.
        angle: motor angle, rad.
        direction: -1 or 1.
        block: number of the time block.
    """

    error: FloatArray
    angle: FloatArray
    direction: FloatArray
    block: NDArray[np.int64]

    def design(self, cycles: int) -> FloatArray:
        """Return the regressors (n, 4): an offset, an offset that changes with the direction, and the wave."""
        phase = cycles * self.angle
        return np.column_stack([np.ones_like(phase), self.direction, np.cos(phase), np.sin(phase)])

    def of(self, chosen: NDArray[np.bool_]) -> _Samples:
        """Return the chosen samples."""
        return _Samples(self.error[chosen], self.angle[chosen], self.direction[chosen], self.block[chosen])


def _samples(logs: Sequence[Dataset], model: TendonSheath) -> _Samples | None:
    parts = []
    for log in prepare(logs, model, {}):
        mask, direction, angle = log.mask, log.admission.direction, log.signals.q_m
        if angle is None or not mask.any():
            continue
        slopes = np.where(direction > 0, sliding(model, 1.0).slope, sliding(model, -1.0).slope)
        error = (log.tau_j - predict(model, log.signals)) / slopes
        parts.append((error[mask], angle[mask], np.sign(direction[mask]).astype(float), log.labels[mask]))
    if not parts:
        return None
    error, angle, direction, block = (np.concatenate(each) for each in zip(*parts, strict=True))
    return _Samples(error, angle, direction, block)


def _fit(design: FloatArray, error: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.lstsq(design.T @ design, design.T @ error, rcond=None)[0], dtype=np.float64)


def _best(samples: _Samples, candidates: range) -> int:
    """Return the number of cycles per revolution with the least residual error."""

    def left(cycles: int) -> float:
        design = samples.design(cycles)
        return float(np.sum(np.square(samples.error - design @ _fit(design, samples.error))))

    return min(candidates, key=left)


def _holds(samples: _Samples, candidates: range) -> bool:
    """Return True if the wave that each half of the blocks selects reduces the error of the other half."""
    gains = []
    for half in (0, 1):
        learned, held = samples.of(samples.block % 2 == half), samples.of(samples.block % 2 != half)
        if not learned.error.size or not held.error.size:
            return False
        cycles = _best(learned, candidates)
        design = learned.design(cycles)
        wave, without = _fit(design, learned.error), _fit(design[:, :2], learned.error)
        design = held.design(cycles)
        gain = np.square(held.error - design[:, :2] @ without) - np.square(held.error - design @ wave)
        gains += [float(np.mean(gain[held.block == number])) for number in np.unique(held.block)]
    values = np.array(gains)
    spread = float(np.std(values)) / math.sqrt(values.size)
    return bool(values.size > 2 and float(np.mean(values)) > SURE * spread)
