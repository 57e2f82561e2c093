"""How small an effect these logs would have shown; the log is one of the blind ones, the drive's noise is known."""

from __future__ import annotations

import tomllib
from typing import Any

import numpy as np
import pytest

from tests.blind import case
from tsa_ctrl.identify.diagnosis import pipeline
from tsa_ctrl.identify.diagnosis.selection.detection_limits import DetectionLimits, detection_limits
from tsa_ctrl.identify.diagnosis.selection.entry import LEAST_ERROR_REDUCTION
from tsa_ctrl.model.parameters import model_from


@pytest.mark.slow
def test_what_is_left_unexplained_hides_what_is_smaller(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cause that explains less than what nothing explains would be a guess: it is not named, and not promised."""
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
