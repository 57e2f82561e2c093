"""Run a diagnosis from top to bottom, with one line for each stage; the folders of the stages define them."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable

import numpy as np

from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.diagnosis.data.audit import audit
from tsa_ctrl.identify.diagnosis.data.direction import with_hidden_direction
from tsa_ctrl.identify.diagnosis.data.gross_motion import along_gross_motion
from tsa_ctrl.identify.diagnosis.data.prepare import Logs, left_out, prepare
from tsa_ctrl.identify.diagnosis.data.split import split
from tsa_ctrl.identify.diagnosis.fitting.noise_model import recalibrated
from tsa_ctrl.identify.diagnosis.hypotheses.candidates import Candidates, candidates, scales_of
from tsa_ctrl.identify.diagnosis.parameters.claims import claims
from tsa_ctrl.identify.diagnosis.parameters.profile_refinement import profile_refined
from tsa_ctrl.identify.diagnosis.parameters.proportion import in_proportion
from tsa_ctrl.identify.diagnosis.parameters.refit import refit, with_companions
from tsa_ctrl.identify.diagnosis.refusals import (
    UNSUITED,
    InsufficientError,
    refuse_foreign,
    refuse_tied,
    refuse_unexciting,
    refuse_unrelated,
    refuse_unsuited,
    refuse_useless,
    refuse_without_friction,
)
from tsa_ctrl.identify.diagnosis.report.conclude import conclude, insufficient
from tsa_ctrl.identify.diagnosis.report.details import Outcome
from tsa_ctrl.identify.diagnosis.report.result import Diagnosis
from tsa_ctrl.identify.diagnosis.rivals.by_stretch import by_stretch
from tsa_ctrl.identify.diagnosis.selection.detection_limits import detection_limits
from tsa_ctrl.model.effects.specification import Kind
from tsa_ctrl.model.parameters import Model

Progress = Callable[[str], None]


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # Values that are not finite are dropped or rejected.
def diagnose(
    logs: Logs | Dataset, model: Model, *, hold_out: str | None = None, seed: int = 0, progress: Progress | None = None
) -> Diagnosis:
    """Find and explain the errors of the simulation with `model` on these logs, and quantify the improvement.

    Logs without enough information lead to the verdict `insufficient`, not to an error.

    Args:
        logs: a list of datasets, or of mappings from column name to an array of shape (n,), SI units. A single dataset
            and a mapping from name to columns are also accepted.
        model: the nominal model.
        hold_out: pattern of the names of the held-out logs, which are not used to find or fit causes. By default every
            third log by name is held out. With one or two logs, parts of each log are held out instead. Causes are then
            found with these parts, and only the held-out errors are computed without them.
        seed: seed of the random generator.
        progress: called with the name of each stage.

    Returns:
        The diagnosis.

    Raises:
        UsageError: a log cannot be correct; the message names the log and the column in one line.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # Libraries warn about values that are not finite.
        return _diagnose(
            [logs] if isinstance(logs, Dataset) else logs, model, hold_out, seed, progress or (lambda _: None)
        )


def _diagnose(logs: Logs, model: Model, hold_out: str | None, seed: int, say: Progress) -> Diagnosis:
    rng = np.random.default_rng(seed)
    runs = prepare(logs, model, hold_out)
    say("audit")
    data = with_hidden_direction(along_gross_motion(split(runs, hold_out), model), model)
    audited = audit(data.frame, left_out(len(logs), runs), needs_motion=model.kind is not Kind.GEARED_DRIVE)
    testable = Candidates({}, {})
    try:
        refuse_unexciting(audited)
        refuse_foreign(data.frame, model)
        scales = scales_of(data.frame, model)
        testable = candidates(data.frame, model, scales)
        say("noise and recalibration")
        problem, base = recalibrated(data.frame, model, scales, testable.catalogue)
        refuse_unsuited(problem, base)
        say("causes")
        claimed = claims(problem, base, testable.catalogue, data, rng)
        selection, errors, formula, share = claimed.selection, claimed.errors, claimed.formula, claimed.share
        refuse_without_friction(problem, base, named=bool(selection.fitted.names))
        say("parameters")
        beside = by_stretch(selection, scales)
        shipped = dataclasses.replace(selection.problem, mask=data.shipped)
        refitted = with_companions(shipped, refit(shipped, selection.fitted, share > 0.0), testable.catalogue)
        reported = in_proportion(data.frame, profile_refined(shipped, refitted))
        refuse_tied(scales, reported)
        limits = detection_limits(selection, share)
        refuse_unrelated(problem, data.held, errors, share, formula)
        refuse_useless(problem, bool(selection.fitted.names), errors)
        if formula is not None:  # The part that a formula describes is not noise.
            errors = dataclasses.replace(errors, refitted=min(errors.refitted, formula.rms[1]))
    except InsufficientError as refusal:
        return insufficient(model, audited, str(refusal), testable.not_testable)
    except (OverflowError, FloatingPointError, np.linalg.LinAlgError):  # Numbers overflow, or a matrix is singular.
        return insufficient(model, audited, UNSUITED, testable.not_testable)
    return conclude(
        model,
        Outcome(
            data,
            audited,
            scales,
            testable,
            claimed.base,
            selection,
            claimed.findings,
            claimed.groups,
            beside,
            reported,
            errors,
            formula,
            limits,
        ),
    )
