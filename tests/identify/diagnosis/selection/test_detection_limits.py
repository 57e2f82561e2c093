"""Test the smallest effect that the logs would have shown, on a blind case with known noise of the drive."""

from __future__ import annotations

import dataclasses
import tomllib
from typing import Any

import numpy as np
import pytest

from tests.blind import case
from tsa_ctrl.identify.diagnosis import pipeline
from tsa_ctrl.identify.diagnosis.fitting.problem import orthonormal
from tsa_ctrl.identify.diagnosis.fitting.score_test import scores
from tsa_ctrl.identify.diagnosis.selection.detection_limits import DetectionLimits, detection_limits
from tsa_ctrl.identify.diagnosis.selection.entry import LEAST_ERROR_REDUCTION
from tsa_ctrl.model.parameters import model_from


@pytest.mark.slow
def test_what_is_left_unexplained_hides_what_is_smaller(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cause that explains less than the unexplained residual would be a guess.

    It is neither identified nor given a detection limit that small.
    """
    asked: list[tuple[Any, float]] = []

    def noted(chosen: Any, structure: float) -> DetectionLimits:
        asked.append((chosen, structure))
        return detection_limits(chosen, structure)

    monkeypatch.setattr(pipeline, "detection_limits", noted)
    hidden = case("none", "free", seed=4, short=True)
    found = pipeline.diagnose(
        {log.name: log.columns for log in hidden.logs}, model_from(tomllib.loads(hidden.model), "nominal.toml")
    )
    ((chosen, structure),) = asked
    assert structure == 0.0
    noise = chosen.problem.noise.rms
    clean, messy = (detection_limits(chosen, share).sizes for share in (0.0, 0.9))
    assert clean == dict(found.detection_limit)
    assert min(clean.values()) >= 0.99 * LEAST_ERROR_REDUCTION * noise
    assert min(messy.values()) >= 0.8 * np.sqrt(0.9) * noise
    assert all(messy[name] >= size for name, size in clean.items() if name in messy)


@pytest.mark.slow
def test_what_the_logs_hold_of_an_effect_must_first_be_made_up_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """An unidentified spring of 0.2 N*m hides a spring of -0.2 N*m, for either sign."""
    asked: list[Any] = []

    def noted(chosen: Any, structure: float) -> DetectionLimits:
        asked.append(chosen)
        return detection_limits(chosen, structure)

    monkeypatch.setattr(pipeline, "detection_limits", noted)
    hidden = case("none", "free", seed=4, short=True)
    pipeline.diagnose(
        {log.name: log.columns for log in hidden.logs}, model_from(tomllib.loads(hidden.model), "nominal.toml")
    )
    (chosen,) = asked
    effect, first = "joint_stiffness", chosen.rounds[0]
    found = next(response for response in first.responses if response.variant.effect == effect)
    white = orthonormal(
        next(s.columns for s in scores(chosen.problem, first.fitted, [found]) if s.variant.effect == effect)
    )
    clean = detection_limits(chosen, 0.0).sizes
    risen = []
    for strength in (-30.0, 30.0):  # in units of the white noise
        holding = dataclasses.replace(first.fitted, residual=first.fitted.residual + strength * white[:, 0])
        again = dataclasses.replace(chosen, rounds=(dataclasses.replace(first, fitted=holding), *chosen.rounds[1:]))
        risen.append(detection_limits(again, 0.0).sizes[effect] - clean[effect])
    assert risen[0] == pytest.approx(risen[1], rel=0.1)
    assert min(risen) > 2.0 * clean[effect]
