"""Pictures of a diagnosis: what an axis shows."""

from __future__ import annotations

import tomllib
from pathlib import Path

import matplotlib
import numpy as np
import pytest

from tests.blind import case
from tsa_ctrl.identify import diagnose
from tsa_ctrl.identify.diagnosis.report.beside import drawing
from tsa_ctrl.identify.diagnosis.report.page import drawn_here
from tsa_ctrl.identify.diagnosis.report.pictures import _span
from tsa_ctrl.model.parameters import model_from


def test_single_samples_do_not_set_the_axis() -> None:
    values = np.linspace(-10.0, 20.0, 10_000)
    values[::500] = -600.0
    low, high = _span(values)
    assert -16.0 < low < -10.0
    assert 20.0 < high < 26.0


@pytest.mark.parametrize("value", [0.0, 3.0])
def test_a_residual_without_spread_has_an_axis(value: float) -> None:
    low, high = _span(np.full(10, value))
    assert low < value < high


@pytest.mark.slow
def test_pictures_drawn_by_other_processes_are_those_drawn_here(tmp_path: Path) -> None:
    """And once those processes are gone, they are drawn all the same."""
    hidden = case("single", "torque_offset", seed=3, short=True)
    columns = {log.name: log.columns for log in hidden.logs}
    result = diagnose(columns, model_from(tomllib.loads(hidden.model), "nominal.toml"))
    folders = [tmp_path / name for name in ("here", "beside", "gone")]
    for folder in folders:
        folder.mkdir()
    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # other tests have looks of their own
        here = drawn_here(result, folders[0])
        with drawing() as plot:
            beside = plot(result, folders[1])
        gone = plot(result, folders[2])
    assert len(here) == 7
    assert list(here) == list(beside) == list(gone)
    for paths in zip(here.values(), beside.values(), gone.values(), strict=True):
        assert len({path.read_bytes() for path in paths}) == 1
