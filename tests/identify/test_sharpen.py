"""Widths and moments are made sharper without spoiling what is shipped beside them."""

from __future__ import annotations

import numpy as np
import pytest

from tests.identify.test_diagnosis import diagnosed
from tsa_ctrl.identify.diagnosis import pipeline, sharpen
from tsa_ctrl.identify.diagnosis.problem import Problem
from tsa_ctrl.identify.diagnosis.refit import Refit, on_plain_error


def test_a_step_that_the_rest_of_the_model_cannot_follow_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[Problem, Refit]] = []

    def keep(problem: Problem, shipped: Refit) -> Refit:
        seen.append((problem, shipped))
        return shipped

    monkeypatch.setattr(pipeline, "sharpened", keep)
    diagnosed("single", "presliding_hysteresis", 9005)
    problem, shipped = seen[0]
    monkeypatch.setattr(sharpen.np.linalg, "lstsq", lambda columns, *_, **__: (np.full(columns.shape[1], 0.2),))
    found = sharpen.sharpened(problem, shipped).fitted
    plain = on_plain_error(problem, reversals=True)
    rest = plain.measured - plain.whiten(plain.predicted(found.hypothesis.model(found.point)))
    assert float(rest @ rest) < 1.11 * shipped.fitted.rss
