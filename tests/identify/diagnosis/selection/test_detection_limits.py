"""Test the smallest effect that the logs would have shown, on a blind case with known noise of the drive."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from tests.blind import case
from tests.identify.diagnosis.nominal import diagnosed
from tsa_ctrl.identify import Diagnosis
from tsa_ctrl.identify.diagnosis import pipeline
from tsa_ctrl.identify.diagnosis.fitting.problem import orthonormal
from tsa_ctrl.identify.diagnosis.fitting.score_test import scores
from tsa_ctrl.identify.diagnosis.selection.detection_limits import DetectionLimits, detection_limits
from tsa_ctrl.identify.diagnosis.selection.entry import LEAST_ERROR_REDUCTION


@pytest.fixture(scope="module")
def asked() -> tuple[Diagnosis, Any, float]:
    """Return a diagnosis without a cause, with the selection and the unexplained share that its limits came from."""
    calls: list[tuple[Any, float]] = []

    def noted(chosen: Any, structure: float) -> DetectionLimits:
        calls.append((chosen, structure))
        return detection_limits(chosen, structure)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pipeline, "detection_limits", noted)
        found = diagnosed(case("none", "free", seed=4, short=True))
    ((chosen, structure),) = calls
    return found, chosen, structure


@pytest.mark.slow
def test_what_is_left_unexplained_hides_what_is_smaller(asked: tuple[Diagnosis, Any, float]) -> None:
    """A cause that explains less than the unexplained residual would be a guess.

    It is neither identified nor given a detection limit that small.
    """
    found, chosen, structure = asked
    assert structure == 0.0
    noise = chosen.problem.noise.rms
    clean, messy = (detection_limits(chosen, share).sizes for share in (0.0, 0.9))
    assert clean == dict(found.detection_limit)
    assert min(clean.values()) >= 0.99 * LEAST_ERROR_REDUCTION * noise
    assert min(messy.values()) >= 0.8 * np.sqrt(0.9) * noise
    assert all(messy[name] >= size for name, size in clean.items() if name in messy)


@pytest.mark.slow
def test_what_the_logs_hold_of_an_effect_must_first_be_made_up_for(asked: tuple[Diagnosis, Any, float]) -> None:
    """An unidentified spring of 0.2 N*m hides a spring of -0.2 N*m, for either sign."""
    chosen = asked[1]
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
