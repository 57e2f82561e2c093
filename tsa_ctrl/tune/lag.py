"""How late the measured velocity is: the lag at which the friction of the logs turns, by least error of all samples.

An encoder's velocity is filtered, so a loop that follows it turns its friction term late. Where the friction itself
turns at once (a sheath that bends at the joint) the logs show by how much. Source: `velocity_lag` in the catalogue.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.predict import predict

FloatArray = NDArray[np.float64]

EFFECT = "velocity_lag"
STEP = 0.25e-3  # s between the lags that are tried
MOST = 0.02  # s; an encoder that is later is no encoder for a torque loop
BLOCKS = 8
CLEARLY_BETTER = 0.8  # of the error without a lag; with one it must be below


def with_lag(model: TendonSheath, lag: float) -> TendonSheath:
    """The model, its velocity `lag` s late."""
    return model.with_effects({**model.effects, EFFECT: {"time_constant": lag}})


def velocity_lag(logs: Sequence[Dataset], model: TendonSheath) -> Quantity | None:
    """The lag (s) of least error, each log's mean apart; None when the model has one or none does clearly better.

    The interval comes from leaving out blocks of time; it is never narrower than the steps of the search.
    """
    if EFFECT in model.effects:
        return None
    lags = np.arange(0.0, MOST + STEP / 2.0, STEP)
    squares = np.array(
        [_squares(logs, with_lag(model, float(lag)) if lag else model) for lag in lags]
    )  # (lags, blocks)
    total = squares.sum(axis=1)
    best = int(np.argmin(total))
    if best in (0, lags.size - 1) or total[best] > CLEARLY_BETTER**2 * total[0]:
        return None
    without = lags[np.argmin(total[:, None] - squares, axis=0)]
    count = without.size
    deviation = math.sqrt((count - 1) / count * float(np.sum(np.square(without - without.mean()))))
    half = max(STEP, float(stats.t.ppf(0.975, count - 1)) * deviation)
    value = float(lags[best])
    return Quantity(value, max(0.0, value - half), value + half, "s")


def _squares(logs: Sequence[Dataset], model: TendonSheath) -> FloatArray:
    """Sums of the squared error over blocks of time (m)."""
    sums = []
    for log in logs:
        error = predict(model, log.signals()) - log["tau_j"]
        error -= error.mean()
        sums += [float(np.sum(np.square(part))) for part in np.array_split(error, BLOCKS)]
    return np.array(sums)
