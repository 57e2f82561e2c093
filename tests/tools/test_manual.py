"""The manual's generated parts are what their sources say, its links lead somewhere, and its pages are short."""

from __future__ import annotations

import re

import pytest

from tests.conftest import ROOT
from tools.manual import measure, parts
from tools.manual.write import PAGES, differing

PRESENT = [name for name in PAGES if (ROOT / name).is_file()]


def test_every_generated_part_is_what_its_source_says() -> None:
    assert [str(path.relative_to(ROOT)) for path in differing(ROOT)] == []


@pytest.mark.parametrize("name", PRESENT)
def test_every_link_and_picture_of_a_page_is_there(name: str) -> None:
    page = ROOT / name
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8")):
        assert target.startswith("https:") or (page.parent / target).exists(), target


def test_the_reference_values_of_figure_3_19_stand_in_the_model_page() -> None:
    """2.00617 and 0.15724 l_us, at mu = 0.05 and a quarter turn, all bending at the motor."""
    slope, half = parts.slope_and_half_loop(parts.SHAPES["all at the motor end"], 0.05 * 1.5707963267948966)
    assert slope == pytest.approx(2.0 / 2.00617, rel=1e-5)
    assert half == pytest.approx(0.15724 / 2.00617, rel=1e-4)


@pytest.mark.parametrize(("x", "slope"), [(0.5, 12.8), (0.8, 33.7)])
def test_the_error_of_the_simplified_slope_evenly_bent(x: float, slope: float) -> None:
    """cosh x against 1."""
    found, _ = parts.slope_and_half_loop(parts.SHAPES["evenly"], x)
    assert found == pytest.approx(1.0, abs=1e-12)
    assert f"{slope:+.1f}" in parts.errors()


def test_every_table_of_hours_stands_in_a_page_and_has_its_command() -> None:
    commands = measure.listed()["tables"]
    assert {name: row["command"] for name, row in measure.load(measure.TABLES).items()} == commands
    pages = "".join((ROOT / name).read_text(encoding="utf-8") for name in PRESENT)
    assert [name for name in commands if f"<!-- {name}: written by" not in pages] == []
