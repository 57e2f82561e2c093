"""Axis ranges and layout of the pictures of a diagnosis."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.blind import case
from tests.identify.diagnosis.nominal import diagnosed
from tsa_ctrl.identify import Diagnosis
from tsa_ctrl.identify.diagnosis.report import pictures
from tsa_ctrl.identify.diagnosis.report.page import drawing, drawn_here
from tsa_ctrl.identify.diagnosis.report.pictures import _span


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


def shown(family: str, name: str) -> Diagnosis:
    return diagnosed(case(family, name, seed=3, short=True))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("family", "name"),
    [("single", "thermal_friction_drift"), ("rigid", "direction_asymmetric_friction"), ("outside", "sensor_clipping")],
)
def test_no_text_is_cut_off_and_none_lies_over_other_axes(
    family: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The margins are fixed, so every text must lie inside the picture and must not overlap other axes."""
    figures: dict[str, Figure] = {}
    save = pictures._save

    def kept(figure: Figure, path: Path) -> None:
        save(figure, path)
        figures[path.name] = figure

    monkeypatch.setattr(pictures, "_save", kept)
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        drawn_here(shown(family, name), tmp_path)
        assert len(figures) == 8
        for file, figure in figures.items():
            width, height = figure.get_size_inches()
            box = figure.get_tightbbox()
            assert min(box.x0, box.y0, width - box.x1, height - box.y1) >= 0.0, file
            inside = [each.get_tightbbox() for each in figure.axes if each.get_visible()]
            for at, one in enumerate(inside):
                assert not any(one.overlaps(other) for other in inside[:at]), file


@pytest.mark.slow
def test_pictures_drawn_by_other_processes_are_those_drawn_here(tmp_path: Path) -> None:
    """The pictures are also drawn after those processes have ended."""
    result = shown("single", "torque_offset")
    folders = [tmp_path / name for name in ("here", "beside", "gone")]
    for folder in folders:
        folder.mkdir()
    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # other tests change the matplotlib settings
        here = drawn_here(result, folders[0])
        with drawing() as plot:
            beside = plot(result, folders[1])
        gone = plot(result, folders[2])
    assert len(here) == 8
    assert list(here) == list(beside) == list(gone)
    for paths in zip(here.values(), beside.values(), gone.values(), strict=True):
        assert len({path.read_bytes() for path in paths}) == 1
