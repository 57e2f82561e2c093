"""Combine the results of all stages into one object with a verdict and a first sentence."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from tsa_ctrl.identify.diagnosis.criteria import LEAST_GAIN
from tsa_ctrl.identify.diagnosis.data.audit import Audit
from tsa_ctrl.identify.diagnosis.data.frame import Frame
from tsa_ctrl.identify.diagnosis.parameters.formula import Formula
from tsa_ctrl.identify.diagnosis.parameters.proportion import SPLIT, at_bounds, parted
from tsa_ctrl.identify.diagnosis.parameters.refit import Refit, base_quantities, effect_quantities
from tsa_ctrl.identify.diagnosis.report.details import Outcome, details
from tsa_ctrl.identify.diagnosis.report.experiment import advice, first_motion
from tsa_ctrl.identify.diagnosis.report.result import Cause, Diagnosis, ParameterError, Rms, StretchRms, Verdict
from tsa_ctrl.identify.diagnosis.report.words import insufficient_sentence, sentence, told_torque, what_is_left
from tsa_ctrl.identify.diagnosis.rivals.by_stretch import StretchCause
from tsa_ctrl.identify.three_errors import three_errors
from tsa_ctrl.model.catalogue import of_the_stretch
from tsa_ctrl.model.parameters import Effects, Model, TendonSheath
from tsa_ctrl.model.predict import predict


def conclude(model: Model, outcome: Outcome) -> Diagnosis:
    """Return the result for logs that excite the system sufficiently.

    model: the nominal model.
    """
    reported, errors = outcome.reported, outcome.errors
    proofs = outcome.selection.evidence
    order = sorted(range(len(proofs)), key=lambda i: (-errors.lost[i], -proofs[i].gain))  # most important first
    grouped = [outcome.groups[i] for i in order]
    parameters = effect_quantities(reported)
    by_torque = tuple(
        Cause(
            effect=group.name,
            alternatives=tuple(rival.name for rival in group.alternatives),
            probability=group.probabilities[group.name],
            others={rival.name: group.probabilities[rival.name] for rival in group.alternatives},
            parameters=parameters[group.name],
            explained_fraction=errors.lost[index],
            rivals={rival.name: rival.fitted.hypothesis.model(rival.fitted.point) for rival in group.alternatives},
        )
        for index, group in zip(order, grouped, strict=True)
    )
    beside = outcome.beside
    causes = (*by_torque, *(_by_stretch(cause) for cause in beside.causes))
    compared = {name for group in grouped for name in (group.name, *(rival.name for rival in group.rivals))}
    unseen = [name for name in outcome.limits.invisible if name not in compared]  # they may act nevertheless
    nothing = dict.fromkeys(unseen, "it would change nothing in the motion and load of these logs")
    hidden = {
        name: f"these logs would show it only from {told_torque(size)} on, which is more than the torque itself"
        for name, size in outcome.limits.hidden.items()
        if name not in compared
    }
    unasked = dict.fromkeys(of_the_stretch(model.effects)[1] if beside.unasked else (), beside.unasked)
    not_testable = {**outcome.testable.not_testable, **unasked, **nothing, **hidden}
    left = sorted((finding for finding in outcome.findings if finding.found), key=lambda finding: -finding.shown)
    held = at_bounds(reported)
    worse = not by_torque and errors.recalibrated > errors.as_given  # keep the better model
    extended = model if worse else reported.fitted.hypothesis.model(reported.fitted.point)
    formula = _formula(outcome, worse)
    runs = outcome.data.frame.runs
    logs = [run.raw for run in runs]
    target = runs[0].target_name
    nominal = [log[target] - predict(model, log.signals()) for log in logs]
    residuals = [log[target] - predict(extended, log.signals()) for log in logs]
    verdict = _verdict(named=bool(causes), left=bool(left), held=bool(held))
    result = Diagnosis(
        verdict=verdict,
        sentence="",
        causes=causes,
        parameter_errors=_parameter_errors(reported, outcome.data.frame, model),
        unexplained=what_is_left(left, () if by_torque else outcome.audit.suspicions),
        not_testable=dict(sorted(not_testable.items())),
        detection_limit=dict(sorted(outcome.limits.sizes.items())),
        experiment=advice(
            model, verdict, causes, outcome.audit, not_testable, outcome.scales.torque, formula is not None
        ),
        rms=Rms(
            errors.as_given,
            errors.recalibrated,
            errors.extended,
            errors.noise_floor,
            errors.refitted,
            float(np.sqrt(np.mean(np.square(np.concatenate(nominal))))),
            errors.sliding,
        ),
        gain=min(errors.sliding_gain, 1.0) if by_torque else 0.0,
        gain_all=min(errors.gain, 1.0) if by_torque else 0.0,
        errors=three_errors(logs, residuals, target),
        nominal_errors=three_errors(logs, nominal, target),
        model=_with_more(extended, beside.effects),
        at_bounds={} if worse else held,
        stretch=None if beside.rms is None else StretchRms(*beside.rms),
        formula=formula,
        details=details(outcome, grouped, [errors.lost[i] for i in order]),
    )
    return dataclasses.replace(result, sentence=sentence(result))


def insufficient(model: Model, found: Audit, reason: str, not_testable: Mapping[str, str]) -> Diagnosis:
    """Return the result for logs that do not excite the system sufficiently, with the reason."""
    return Diagnosis(
        verdict=Verdict.INSUFFICIENT,
        sentence=insufficient_sentence("; ".join([reason, *found.suspicions])),
        causes=(),
        parameter_errors={},
        unexplained="",
        not_testable=dict(sorted(not_testable.items())),
        detection_limit={},
        experiment=first_motion(model),
        rms=Rms(),
        gain=0.0,
        model=model,
    )


def _formula(outcome: Outcome, worse: bool) -> Formula | None:
    """Return the formula of the residual, or None without one.

    If the recalibrated model is `worse` than the nominal model, the gain and the RMS errors of the formula refer to the
    nominal model. None is then also returned if this gain is at most LEAST_GAIN.
    """
    found, given = outcome.formula, outcome.errors.as_given
    if found is None or not worse:
        return found
    gain = 1.0 - (found.rms[1] / given) ** 2
    return dataclasses.replace(found, gain=gain, rms=(given, found.rms[1])) if gain > LEAST_GAIN else None


def _by_stretch(found: StretchCause) -> Cause:
    """Return an effect that only the elongation shows as a cause without a share in the gain of the torque error."""
    where = {"log": found.log} if found.log else {}
    return Cause(found.effect, found.alternatives, found.probability, {**found.parameters, **where}, 0.0)


def _with_more(model: Model, effects: Effects) -> Model:
    if not effects or not isinstance(model, TendonSheath):
        return model
    return model.with_effects({**model.effects, **effects})


def _verdict(named: bool, left: bool, held: bool) -> Verdict:
    """Return the verdict; if a parameter is `held` at its bound, the causes absorb a part of its error."""
    if named:
        return Verdict.PARTLY_EXPLAINED if left or held else Verdict.EXPLAINED
    return Verdict.UNEXPLAINED if left else Verdict.CONSISTENT


def _parameter_errors(reported: Refit, frame: Frame, model: Model) -> dict[str, ParameterError]:
    """Return the parameters of the base model by name.

    For a drive with tendons, the friction angle and the pretension are included only if the logs identify them
    separately. This requires a varied wrap angle.
    """
    quantities = base_quantities(reported)
    out = {name: ParameterError(nominal, quantity) for name, (nominal, quantity) in quantities.items()}
    if not isinstance(model, TendonSheath):
        return out
    told_apart = parted(frame, reported)
    return {name: error for name, error in out.items() if name not in SPLIT or name in told_apart}
