"""`diagnose`: audit, noise, recalibration, selection, groups, what is left, parameters, gain, verdict.

Each stage is a function from data to data in a module of its own; this one strings them together.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.admit import admit
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.diagnosis.data.audit import Audit, audit
from tsa_ctrl.identify.diagnosis.data.prepare import Frame, prepare
from tsa_ctrl.identify.diagnosis.data.split import Split, split
from tsa_ctrl.identify.diagnosis.fitting.fit import Fit, fit, gradients
from tsa_ctrl.identify.diagnosis.fitting.noise_model import pilot_noise
from tsa_ctrl.identify.diagnosis.fitting.problem import Hypothesis, Problem
from tsa_ctrl.identify.diagnosis.fitting.score_test import responses, scores
from tsa_ctrl.identify.diagnosis.hypotheses.base import Base, RigidBase, TendonBase
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import Scales, candidates, scales_of
from tsa_ctrl.identify.diagnosis.noise.autoregressive import white_noise
from tsa_ctrl.identify.diagnosis.noise.nuisance import FASTEST, Nuisance, fast, nuisance
from tsa_ctrl.identify.diagnosis.parameters.held_out import HeldOut, full_residuals, held_out
from tsa_ctrl.identify.diagnosis.parameters.profile_refinement import sharpened
from tsa_ctrl.identify.diagnosis.parameters.refit import (
    Refit,
    base_quantities,
    effect_quantities,
    refit,
    through_reversals,
)
from tsa_ctrl.identify.diagnosis.report.curves import details
from tsa_ctrl.identify.diagnosis.report.experiment import advice, first_motion
from tsa_ctrl.identify.diagnosis.report.result import Cause, Diagnosis, ParameterError, Rms, Verdict
from tsa_ctrl.identify.diagnosis.report.words import insufficient_sentence, listed, sentence
from tsa_ctrl.identify.diagnosis.residual import changes, features
from tsa_ctrl.identify.diagnosis.residual.dependence import Finding, dependence
from tsa_ctrl.identify.diagnosis.rivals.groups import Group, better, compared, groups
from tsa_ctrl.identify.diagnosis.rivals.simulation_error import by_simulation_error, misfit, plain_error
from tsa_ctrl.identify.diagnosis.selection.detection_limits import detection_limits, without_recalibration
from tsa_ctrl.identify.diagnosis.selection.extension import Catalogue, without
from tsa_ctrl.identify.diagnosis.selection.forward import Selection, dropped, one_more, replaced, select
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import Model, RigidDrive

Log = Dataset | Mapping[str, ArrayLike]
Progress = Callable[[str], None]

PILOT_NOISE = 0.02  # of the torque, before anything is known of the noise
BLIND = 0.35  # relative half width of the half loop's interval from which on friction is not seen at all
ABSURD = 5.0  # times the torque's own variation: a simulation so far off is of another log; (3.55) may miss by twice
UNSUITED = (
    "the simulation is further off than the measured torque changes at all: are two columns swapped, is a unit wrong, "
    "or is the model another drive's?"
)
UNRELATED = 0.6  # of the torque itself, RMS: more that is not noise is left by every cause only of strange logs
HELPED = 0.5  # of the recalibrated model's error: causes that leave less are of this drive
STRANGE = (
    "no cause of the catalogue brings the simulation near the measured torque: are two columns swapped, a unit wrong, "
    "or is one column of another log?"
)
BENDING_VARIED = 0.05  # of the bending angle: less is one configuration
PARTED = 0.5  # of [uncertainty]: x and T_p are named apart when their intervals are narrower


def diagnose(
    logs: Sequence[Log] | Mapping[str, Mapping[str, ArrayLike]],
    model: Model,
    *,
    hold_out: str | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Diagnosis:
    """What the simulation with `model` gets wrong on these logs, why, and what it gains to know.

    logs: datasets, or mappings from column name to an array of shape (n,), SI units (several: a list, or
    name: columns).
    hold_out: pattern of the logs that nothing is fitted on; default every third by name, or stretches of one or two
    logs. seed fixes every draw. progress is called with the name of each stage.

    Raises UsageError for logs that cannot be right, one line that names log and column. Logs that say nothing give the
    verdict `insufficient`, not an error.
    """
    say = progress or (lambda _: None)
    datasets = _datasets(logs)
    target = "tau_m" if isinstance(model, RigidDrive) else "tau_j"
    for log in datasets:
        _admit(log, model, target)
    say("audit")
    parts = split(prepare(datasets, target), hold_out)
    found = audit(parts.frame)
    if found.insufficient:
        return _insufficient(model, found, found.insufficient)
    rng = np.random.default_rng(seed)
    plain = isinstance(model, RigidDrive)
    offset = isinstance(model, RigidDrive) and model.torque_offset is not None
    scales = dataclasses.replace(scales_of(parts.frame), plain=plain, offset=offset)
    catalogue, not_testable = candidates(parts.frame, model, scales)
    say("noise and recalibration")
    try:
        problem, base = _begun(parts.frame, _base(model, parts.frame, scales), scales, catalogue)
        blind = _absurd(problem, base) or ("" if plain else _blind(problem, base))
    except OverflowError:  # a friction angle beyond anything
        return _insufficient(model, found, UNSUITED, not_testable)
    if blind:
        return _insufficient(model, found, blind, not_testable)
    say("causes")
    chosen = select(problem, base, catalogue, rng, lambda problem, fitted: _noise_rms(parts, problem, fitted))
    blind = _blind(problem, base) if plain and not chosen.fitted.names else ""  # what is hidden may hide its friction
    if blind:
        return _insufficient(model, found, blind, not_testable)
    say("what is left")
    findings = _left(chosen, parts.frame, rng)
    share = _share(findings)
    structure = misfit(chosen.problem, chosen.fitted, share)
    while structure is not None and (more := one_more(chosen, catalogue)) is not None:
        chosen, findings = more, _left(more, parts.frame, rng)
        share = _share(findings)
        structure = misfit(chosen.problem, chosen.fitted, share)
    base = fit(chosen.problem, base.hypothesis, base.point)
    say("what cannot be told apart")
    if structure is not None:
        best = by_simulation_error(chosen.problem, chosen.fitted, catalogue)
        chosen = dataclasses.replace(chosen, fitted=best)
        structure = misfit(chosen.problem, best, share)
    grouped = groups(chosen.problem, chosen.fitted, catalogue, structure)
    while structure is not None and (found_better := better(chosen.problem, chosen.fitted, grouped)) is not None:
        chosen = replaced(chosen, found_better)
        structure = misfit(chosen.problem, chosen.fitted, share)
        grouped = groups(chosen.problem, chosen.fitted, catalogue, structure)
    unsure = _unsure(chosen, grouped, findings)
    if unsure:
        chosen = dropped(chosen, unsure)
        grouped = groups(chosen.problem, chosen.fitted, catalogue, structure)
    say("parameters and gain")
    shipped = sharpened(chosen.problem, refit(chosen.problem, chosen.fitted))
    errors = held_out(chosen.problem, base, chosen.fitted, parts, min(share, 0.95))
    if not plain and share > 0.0 and _strange(errors, parts):
        return _insufficient(model, found, STRANGE, not_testable)
    limits, invisible = _limits(chosen, parts)
    not_testable = {
        **not_testable,
        **dict.fromkeys(invisible, "it would change nothing in the motion and load of these logs"),
    }
    return _assembled(
        model, parts, found, scales, base, chosen, grouped, findings, shipped, errors, limits, not_testable, seed
    )


def _datasets(logs: Sequence[Log] | Mapping[str, Mapping[str, ArrayLike]]) -> list[Dataset]:
    if isinstance(logs, Mapping):
        return [Dataset.from_arrays(columns, name) for name, columns in logs.items()]
    out = []
    for number, log in enumerate(logs):
        out.append(log if isinstance(log, Dataset) else Dataset.from_arrays(log, f"log_{number + 1}"))
    if not out:
        raise UsageError("diagnose: no log given; name at least one")
    names = [log.name for log in out]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise UsageError(f"diagnose: two logs are named {doubled[0]}; give each a name of its own")
    return out


def _admit(log: Dataset, model: Model, target: str) -> None:
    if target not in log:
        raise UsageError(
            f"{log.label or log.name}: column {target} is missing; the diagnosis of a tendon-sheath needs the measured "
            'joint torque (N*m): add it, or describe a drive without torque sensor as [actuator] kind = "rigid_drive"'
        )
    admit(log, model, target)


def _base(model: Model, frame: Frame, scales: Scales) -> Base:
    if isinstance(model, RigidDrive):
        sizes = {
            "inertia": scales.torque / scales.acceleration,
            "coulomb_friction": scales.torque,
            "viscous_friction": scales.torque / scales.speed,
            "torque_offset": scales.torque,
        }
        return RigidBase(model, sizes)
    return TendonBase(model)


def _begun(frame: Frame, base: Base, scales: Scales, catalogue: Catalogue) -> tuple[Problem, Fit]:
    """The noise model from what the catalogue cannot explain, and the recalibrated base under it."""
    start = Hypothesis(base)
    nothing = Nuisance(np.zeros((len(frame), 0)))
    problem = Problem(frame, base, white_noise(PILOT_NOISE * scales.torque), nothing, frame.train)
    fitted = fit(problem, start, base.start())
    problem = dataclasses.replace(problem, nuisance=nuisance(frame, base, start.model(fitted.point)))
    fitted = fit(problem, start, fitted.point)
    variants = [variant for options in catalogue.values() for variant in options]
    return pilot_noise(problem, fitted, responses(problem, fitted, variants))


def _absurd(problem: Problem, base: Fit) -> str:
    """Why the logs and the model cannot belong together; empty when they can."""
    mask = problem.mask
    error = (problem.frame.target - problem.predicted(base.hypothesis.model(base.point)))[mask]
    if not float(np.std(error)) <= ABSURD * float(np.std(problem.frame.target[mask])):
        return UNSUITED
    return ""


def _strange(errors: HeldOut, parts: Split) -> bool:
    """Whether the causes found, if any, hardly help a simulation that has hardly anything of the measured torque."""
    torque = float(np.sqrt(np.mean(np.square(parts.frame.target[parts.held]))))
    return errors.extended > UNRELATED * torque and errors.extended > HELPED * errors.recalibrated


def _blind(problem: Problem, base: Fit) -> str:
    """Why not even the base model's friction can be seen; empty when it can."""
    found = base_quantities(refit(problem, base))
    name = "half_loop_torque" if "half_loop_torque" in found else "coulomb_friction"
    quantity = found[name][1]
    if not base.free.any() or quantity.value <= 0.0:
        return ""
    width = 0.5 * (quantity.high - quantity.low) / quantity.value
    if width > BLIND and np.all(base.free):
        return "friction does not show: the motion or the load is too small beside the noise, or goes one way only"
    return ""


def _noise_rms(parts: Split, problem: Problem, fitted: Fit) -> float:
    """RMS of the noise at the logs' own rate, N*m: of the noise model, and of what is faster than the score rate.

    At most the whole residual's, which holds whatever is not found yet. Medians, not means, for the sake of what wrong
    directions add.
    """
    residuals = full_residuals(parts.frame, fitted.hypothesis.model(fitted.point))
    fast = []
    for run, residual in zip(parts.frame.runs, residuals, strict=True):
        bins = residual[: run.count * run.full_bin].reshape(run.count, run.full_bin)
        fast.append((bins - bins.mean(axis=1, keepdims=True)).ravel())
    return min(
        _deviation(np.concatenate(residuals)), float(np.hypot(problem.noise.rms, _deviation(np.concatenate(fast))))
    )


def _deviation(y: Array) -> float:
    return float(np.median(np.abs(y))) / 0.6745


def _left(chosen: Selection, frame: Frame, rng: np.random.Generator) -> list[Finding]:
    """All tests of what the causes found leave."""
    problem, fitted = chosen.problem, chosen.fitted
    predicted = problem.predicted(fitted.hypothesis.model(fitted.point))
    sigma, load = features.direction_and_load(frame, predicted)
    families = features.families(frame, predicted, rng)
    families["time"] = features.time_family(frame, sigma, load)
    sizes = [family.shape[1] for family in families.values()]
    white = problem.whiten(np.concatenate(list(families.values()), axis=1))
    pieces = np.split(white, np.cumsum(sizes)[:-1], axis=1)
    columns = dict(zip(families, pieces, strict=True))
    known = _accounted(problem, fitted)
    findings = dependence(fitted.residual, known, columns, problem.blocks, rng)
    mask = problem.mask
    factors = {"the torque": np.ones(len(frame)), "the friction": sigma, "the gain": load}
    times = [run.count * run.period for run in frame.runs]
    findings.append(changes.steps(fitted.residual, known, factors, frame.slices, times, problem.whiten, rng))
    masked = {name: factor[mask] for name, factor in factors.items()}
    findings.append(changes.lines(fitted.residual, masked, frame.period))
    findings.append(changes.bursts(fitted.residual, frame.period))
    rest = frame.target - predicted
    findings.append(changes.drift(_known(problem, rest), mask, frame.slices, frame.period, problem.noise.rms))
    return findings


def _share(findings: Sequence[Finding]) -> float:
    """Of the mean square of what is left, that is structure."""
    return max((finding.share for finding in findings if finding.found), default=0.0)


def _unsure(chosen: Selection, grouped: Sequence[Group], findings: Sequence[Finding]) -> list[int]:
    """Causes that stand alone, but explain less than what is left and no cause explains: a name would be a guess.

    Less of the white residual and of the simulation error, for what is left colours the noise that whitens.
    """
    problem, fitted = chosen.problem, chosen.fitted
    shares = [finding.share for finding in findings if finding.found and finding.what != changes.DRIFT]
    left = min(max(shares, default=0.0), 1.0)
    error = plain_error(problem, fitted) if left > 0.0 else 0.0
    out = []
    for i, group in enumerate(grouped):
        if left <= 0.0 or group.alternatives:
            continue
        smaller = without(problem, fitted, i)
        explained = plain_error(problem, smaller, through_reversals(fitted)) - error
        if compared(problem, fitted, smaller, "nothing").worse < left * fitted.rss and explained < left * error:
            out.append(i)
    return out


def _accounted(problem: Problem, fitted: Fit) -> Array:
    """What is no structure, (m, k) white: every coordinate, also where a bound holds it, and noise of tau_m."""
    columns = [gradients(problem, fitted)]
    if problem.base.target != "tau_m":
        frame = problem.frame
        columns.append(problem.whiten(np.column_stack([frame.stack(fast(frame, edge)) for edge in FASTEST])))
    return np.concatenate(columns, axis=1)


def _known(problem: Problem, residual: Array) -> Array:
    """A residual (n,) in N*m with the moments of unknown direction filled by straight lines."""
    inside = np.ones(len(residual), dtype=np.bool_)
    for moment in problem.nuisance.moments:
        inside[moment.start : moment.start + len(moment.values)] = False
    index = np.arange(len(residual))
    return np.where(inside, residual, np.interp(index, index[inside], residual[inside])) if inside.any() else residual


def _limits(chosen: Selection, parts: Split) -> tuple[dict[str, float], tuple[str, ...]]:
    problem, stage = chosen.problem, chosen.stages[0]
    fitted = stage.fitted
    tangents = _tangents(problem, fitted)
    screened = scores(problem, fitted, stage.found)
    raw = {
        position: without_recalibration(response.columns[problem.mask], tangents)
        for position, response in enumerate(stage.found)
    }
    return detection_limits(problem, screened, raw, stage.threshold, _noise_rms(parts, problem, chosen.fitted))


def _tangents(problem: Problem, fitted: Fit) -> Array:
    """d prediction / d base coordinates that no bound holds, (m, p) in N*m, not whitened."""
    present = problem.predicted(fitted.hypothesis.model(fitted.point))
    columns = []
    for i, free in enumerate(fitted.free[: len(fitted.hypothesis.base.coordinates())]):
        if free:
            moved = fitted.point.copy()
            moved[i] += 1e-3
            columns.append((problem.predicted(fitted.hypothesis.model(moved)) - present)[problem.mask])
    return np.column_stack(columns) if columns else np.zeros((problem.count, 0))


def _assembled(
    model: Model,
    parts: Split,
    found: Audit,
    scales: Scales,
    base: Fit,
    chosen: Selection,
    grouped: Sequence[Group],
    findings: Sequence[Finding],
    shipped: Refit,
    errors: HeldOut,
    limits: Mapping[str, float],
    not_testable: Mapping[str, str],
    seed: int,
) -> Diagnosis:
    named = bool(chosen.fitted.names)
    left = sorted((f for f in findings if f.found), key=lambda f: -f.share)
    verdict = (
        (Verdict.PARTLY_EXPLAINED if left else Verdict.EXPLAINED)
        if named
        else (Verdict.UNEXPLAINED if left else Verdict.CONSISTENT)
    )
    parameters = effect_quantities(shipped)
    causes = [
        Cause(
            effect=group.name,
            alternatives=tuple(rival.name for rival in group.alternatives),
            probability=group.probability,
            parameters=parameters[group.name],
            explained_fraction=errors.lost[index],
        )
        for index, group in enumerate(grouped)
    ]
    order = [int(i) for i in np.argsort([-proof.gain for proof in chosen.evidence], kind="stable")]
    causes = [causes[i] for i in order]
    rms = Rms(errors.as_given, errors.recalibrated, errors.extended, errors.noise_floor)
    result = Diagnosis(
        verdict=verdict,
        sentence="",
        causes=tuple(causes),
        parameter_errors=_parameter_errors(shipped, parts.frame, model),
        unexplained=_description(left, () if named else found.suspicions),
        not_testable=dict(sorted(not_testable.items())),
        detection_limit=dict(sorted(limits.items())),
        experiment=advice(model, verdict, causes, found, not_testable, scales, seed),
        rms=rms,
        gain=min(errors.gain, 1.0) if named else 0.0,
        model=shipped.fitted.hypothesis.model(shipped.fitted.point),
        details=details(parts, found, base, chosen, [grouped[i] for i in order], findings, shipped),
    )
    return dataclasses.replace(result, sentence=sentence(result))


def _parameter_errors(shipped: Refit, frame: Frame, model: Model) -> dict[str, ParameterError]:
    """The base model's numbers; x and T_p only where a varied bending angle parts them."""
    quantities = base_quantities(shipped)
    out = {name: ParameterError(nominal, quantity) for name, (nominal, quantity) in quantities.items()}
    if isinstance(model, RigidDrive):
        return out
    angles = [run.signals.theta for run in frame.runs if run.signals.theta is not None]
    varied = bool(angles) and float(np.ptp(np.concatenate(angles))) > BENDING_VARIED * model.bending_angle
    for name, width in (
        ("friction_angle", model.friction_angle_uncertainty),
        ("pretension", model.pretension_uncertainty),
    ):
        quantity = out[name].found
        half = 0.5 * (quantity.high - quantity.low) / max(quantity.value, 1e-12)
        if not varied or half > PARTED * width or half == 0.0:
            del out[name]
    return out


def _description(left: Sequence[Finding], suspicions: Sequence[str]) -> str:
    """`suspicions` of the data, for what nothing else explains."""
    if not left:
        return ""
    first, *others = left[:3]
    share = f"({first.share:.0%} of its mean square)"
    told = [
        f"what is left depends on {first.what} {share}" if _drives(first) else f"what is left is {first.what} {share}"
    ]
    depends = [finding.what for finding in others if _drives(finding)]
    are = [finding.what for finding in others if not _drives(finding)]
    told += [f"it also depends on {listed(depends)}"] if depends else []
    told += [f"there is also {listed(are)}"] if are else []
    return "; ".join([*told, *suspicions])


def _drives(finding: Finding) -> bool:
    """Whether a finding names a signal on which the rest depends; else it names the rest itself."""
    return not finding.what.startswith(("a ", "bursts"))


def _insufficient(model: Model, found: Audit, reason: str, not_testable: Mapping[str, str] | None = None) -> Diagnosis:
    suspicion = "; ".join([reason, *found.suspicions])
    return Diagnosis(
        verdict=Verdict.INSUFFICIENT,
        sentence=insufficient_sentence(suspicion),
        causes=(),
        parameter_errors={},
        unexplained="",
        not_testable=dict(sorted((not_testable or {}).items())),
        detection_limit={},
        experiment=first_motion(model),
        rms=Rms(),
        gain=0.0,
        model=model,
    )
