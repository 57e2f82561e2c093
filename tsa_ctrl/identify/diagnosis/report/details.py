"""The curves and tables behind a diagnosis, as the pictures and the report show them; nothing is computed there."""

from __future__ import annotations

from dataclasses import dataclass

from tsa_ctrl.identify.diagnosis.data.audit import Audit
from tsa_ctrl.identify.diagnosis.residual.dependence import Finding
from tsa_ctrl.model.functions import Array


@dataclass(frozen=True)
class Ranked:
    """One bar of the ranking: decrease of the mean square of the white residual that a candidate brings alone."""

    effect: str
    gain: float
    group: int  # number of the cause that it is or stands for, -1 for none


@dataclass(frozen=True)
class Curves:
    """Signals of one log at the score rate, for pictures: shape (n,) each, SI."""

    name: str
    t: Array
    measured: Array
    as_given: Array
    recalibrated: Array
    extended: Array
    omega: Array
    sigma: Array
    angle: Array
    tau_m: Array
    temperature: Array | None
    elapsed: Array  # s since the last reversal
    distance: Array  # rad since the last reversal


@dataclass(frozen=True)
class Details:
    """What the pictures show. `noise`: RMS at the score rate, N*m; `autocorrelation` of the white residual."""

    target: str
    curves: tuple[Curves, ...]
    noise: float
    period: float
    ranking: tuple[Ranked, ...]
    autocorrelation: Array
    band: float  # 95 % of white residuals' autocorrelations lie within
    audit: Audit
    findings: tuple[Finding, ...]
    excluded: tuple[str, ...]  # rivals of the named causes that the logs exclude
    held_out: str  # what was held out, in words
    logs: tuple[tuple[str, str], ...]  # name and hash
    notes: tuple[str, ...]
