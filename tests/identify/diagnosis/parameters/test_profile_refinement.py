"""Refining widths and moments does not increase the residual of the reported model."""

from __future__ import annotations

import numpy as np
import pytest

from tests.blind import case
from tests.identify.diagnosis.nominal import diagnosed
from tsa_ctrl.identify.diagnosis import pipeline
from tsa_ctrl.identify.diagnosis.fitting.problem import Problem
from tsa_ctrl.identify.diagnosis.fitting.simulation_error import on_simulation_error
from tsa_ctrl.identify.diagnosis.parameters import profile_refinement
from tsa_ctrl.identify.diagnosis.parameters.refit import Refit


@pytest.mark.slow
def test_a_step_that_the_rest_of_the_model_cannot_follow_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[Problem, Refit]] = []

    def keep(problem: Problem, reported: Refit) -> Refit:
        seen.append((problem, reported))
        return reported

    monkeypatch.setattr(pipeline, "profile_refined", keep)
    diagnosed(case("single", "presliding_hysteresis", 9005, short=True))
    problem, reported = seen[0]
    monkeypatch.setattr(
        profile_refinement.np.linalg, "lstsq", lambda columns, *_, **__: (np.full(columns.shape[1], 0.2),)
    )
    found = profile_refinement.profile_refined(problem, reported).fitted
    plain = on_simulation_error(problem, reversals=True)
    rest = plain.measured - plain.whiten(plain.predicted(found.hypothesis.model(found.point)))
    assert float(rest @ rest) < 1.11 * reported.fitted.rss
