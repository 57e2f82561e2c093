"""Collect the results of all stages of a diagnosis, and the curves and tables for the pictures and the page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tsa_ctrl.identify.diagnosis.data.audit import Audit
from tsa_ctrl.identify.diagnosis.data.frame import Run
from tsa_ctrl.identify.diagnosis.data.split import Split
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import Candidates
from tsa_ctrl.identify.diagnosis.parameters.formula import Formula
from tsa_ctrl.identify.diagnosis.parameters.held_out import HeldOut
from tsa_ctrl.identify.diagnosis.parameters.refit import Refit
from tsa_ctrl.identify.diagnosis.residual.dependence import Finding
from tsa_ctrl.identify.diagnosis.rivals.by_stretch import ByStretch
from tsa_ctrl.identify.diagnosis.rivals.groups import Group
from tsa_ctrl.identify.diagnosis.selection.detection_limits import DetectionLimits
from tsa_ctrl.identify.diagnosis.selection.forward import Selection
from tsa_ctrl.model.effects.search import Scales
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.signals import hold_direction

LAGS = 60  # lags of the autocorrelation: as many as the picture shows clearly


@dataclass(frozen=True)
class Outcome:
    """Hold the results of the stages of a diagnosis, one field for each stage."""

    data: Split
    audit: Audit
    scales: Scales
    testable: Candidates
    base: Fit  # recalibrated, without effects
    selection: Selection
    findings: tuple[Finding, ...]  # in the residual
    groups: tuple[Group, ...]  # one for each cause
    beside: ByStretch  # effects that only the tendon elongation shows
    reported: Refit
    errors: HeldOut
    formula: Formula | None  # of the residual
    limits: DetectionLimits


@dataclass(frozen=True)
class Ranked:
    """One bar of the ranking.

    The gain of an identified cause is the share of the total gain that is lost without it. The gain of a competing
    hypothesis is the part of this share that the hypothesis achieves in place of the cause. If no cause is identified,
    the gain of an effect is the decrease of the mean square of the white residual by this effect alone.
    """

    effect: str
    gain: float
    group: int  # number of the cause, or of the cause that the hypothesis would replace; -1 for none
    excluded: bool = False  # True for a competing hypothesis that the logs exclude


@dataclass(frozen=True)
class Curves:
    """Signals of one log at the score rate for the pictures, (n,) each, in SI units."""

    name: str
    t: Array
    measured: Array
    as_given: Array
    recalibrated: Array
    extended: Array
    described: Array | None  # prediction of the model with the formula; None without a formula
    omega: Array
    sigma: Array
    angle: Array
    tau_m: Array
    temperature: Array | None
    elapsed: Array  # s since the last reversal
    distance: Array  # rad since the last reversal


@dataclass(frozen=True)
class Details:
    """Hold the data of the pictures."""

    target: str
    curves: tuple[Curves, ...]
    noise: float  # N*m, sensor noise as stated in the report
    period: float  # s, of the score samples
    ranking: tuple[Ranked, ...]
    autocorrelation: Array  # (LAGS,), of the white residual
    band: float  # bound for 95 % of the autocorrelations of white noise
    audit: Audit
    findings: tuple[Finding, ...]
    excluded: tuple[str, ...]  # competing hypotheses that the logs exclude
    held_out: str  # description of the held-out data
    logs: tuple[tuple[str, str], ...]  # name and hash
    notes: tuple[str, ...]


def details(outcome: Outcome, grouped: Sequence[Group], lost: Sequence[float]) -> Details:
    """Return the curves and tables of an outcome.

    Args:
        outcome: results of all stages.
        grouped: groups in the order of the report.
        lost: share of the gain that is lost without the cause of each group.
    """
    data, found, reported = outcome.data, outcome.audit, outcome.reported
    base, selection, findings = outcome.base, outcome.selection, outcome.findings
    models = (
        base.hypothesis.base.given,
        base.hypothesis.model(base.point),
        reported.fitted.hypothesis.model(reported.fitted.point),
    )
    residual = selection.fitted.residual
    variance = float(residual @ residual)
    correlation = np.array([float(residual[lag:] @ residual[: len(residual) - lag]) / variance for lag in range(LAGS)])
    logs = [(run.name, run.raw.sha256) for run in data.frame.runs]
    held = (
        f"logs {', '.join(data.held_logs)}"
        if data.held_logs
        else "every third of twelve stretches of each log, with gaps"
    )
    return Details(
        target=base.hypothesis.base.target,
        curves=tuple(_curves(run, models, outcome.formula) for run in data.frame.runs),
        noise=outcome.errors.noise_floor,
        period=data.frame.period,
        ranking=_causes(grouped, lost) if grouped else _ranking(selection),
        autocorrelation=correlation,
        band=1.96 / float(np.sqrt(len(residual))),
        audit=found,
        findings=tuple(findings),
        excluded=_excluded(grouped),
        held_out=held,
        logs=tuple(logs),
        notes=(*found.notes, *found.suspicions),
    )


def _excluded(grouped: Sequence[Group]) -> tuple[str, ...]:
    """Return the names of the excluded hypotheses, best first in each group.

    A name that is a cause or an alternative in any group is omitted.
    """
    possible = {name for group in grouped for name in (group.name, *(r.name for r in group.alternatives))}
    names = dict.fromkeys(rival.name for group in grouped for rival in group.rivals if rival.excluded)
    return tuple(name for name in names if name not in possible)


def _curves(run: Run, models: tuple[Model, Model, Model], formula: Formula | None) -> Curves:
    s = run.signals
    as_given, recalibrated, extended = (run.average(predict(model, s)) for model in models)
    elapsed, distance = run.since_reversal()
    return Curves(
        name=run.name,
        t=run.average(s.t),
        measured=run.average(run.target),
        as_given=as_given,
        recalibrated=recalibrated,
        extended=extended,
        described=None if formula is None else run.average(predict(formula.model, s)),
        omega=run.average(s.omega_j),
        sigma=np.sign(run.average(hold_direction(s.omega_j))),
        angle=run.average(run.angle),
        tau_m=run.average(s.tau_m),
        temperature=None if s.temperature is None else run.average(s.temperature),
        elapsed=run.average(elapsed),
        distance=run.average(distance),
    )


def _causes(grouped: Sequence[Group], lost: Sequence[float]) -> tuple[Ranked, ...]:
    """Return the bars of the causes in the order of the report.

    Each cause is followed by the competing hypotheses that were compared with it on data outside the fit.
    """
    out = []
    for number, (group, share) in enumerate(zip(grouped, lost, strict=True)):
        out.append(Ranked(group.name, share, number))
        compared = [rival for rival in group.rivals if rival.share is not None]
        for rival in sorted(compared, key=lambda rival: (rival.excluded, -(rival.share or 0.0))):
            brought = share * min(max(rival.share or 0.0, 0.0), 1.0)
            out.append(Ranked(rival.name, brought, number, rival.excluded))
    return tuple(out)


def _ranking(chosen: Selection) -> tuple[Ranked, ...]:
    """Return the bars of the effects that were tried in addition to the recalibrated base model, best first."""
    first = chosen.rounds[0]
    count = chosen.problem.count
    best: dict[str, float] = {score.variant.effect: score.gain for score in first.scores}
    best |= {found.names[-1]: first.fitted.rss - found.rss for found in first.steps}
    ordered = sorted(best.items(), key=lambda pair: -pair[1])
    return tuple(Ranked(name, max(gain, 0.0) / count, -1) for name, gain in ordered)
