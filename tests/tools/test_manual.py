"""The manual's generated parts are what their sources say, its links lead somewhere, and its pages are short."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tools.manual import parts, tables
from tools.manual.write import PAGES, differing, rewritten
from tsa_ctrl.errors import UsageError

PRESENT = [name for name in PAGES if (ROOT / name).is_file()]


def test_every_generated_part_is_what_its_source_says() -> None:
    assert [str(path.relative_to(ROOT)) for path in differing(ROOT)] == []


@pytest.mark.parametrize("name", PRESENT)
def test_every_link_and_picture_of_a_page_is_there(name: str) -> None:
    page = ROOT / name
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8")):
        assert target.startswith("https:") or (page.parent / target).exists(), target


def test_a_part_without_a_source_is_refused() -> None:
    text = "<!-- nothing: written by tools/run manual/write -->\nold\n<!-- end of nothing -->\n"
    with pytest.raises(KeyError, match=r"x\.md: no source for the part 'nothing'"):
        rewritten(text, parts.SOURCES, "x.md")


def test_a_part_is_rewritten_between_its_markers_alone(tmp_path: Path) -> None:
    text = "a\n<!-- verbs: written by tools/run manual/write -->\nold\n<!-- end of verbs -->\nb\n"
    new = rewritten(text, {"verbs": lambda: "| table |\n"}, "x.md")
    assert new == text.replace("old", "| table |")


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


MARKDOWN = """seed 8000
| | found | x |
| --- | --- | --- |
| none | 0/400 | |
| one | 669/690 | a |

slowest: 3 s
"""
DRAWN = """
┏━━━━━━┳━━━━━━━━━┳━━━┓
┃      ┃ found   ┃ x ┃
┡━━━━━━╇━━━━━━━━━╇━━━┩
│ none │ 0/400   │   │
│ one  │ 669/690 │ a │
└──────┴─────────┴───┘
"""
COLUMNS = """which   found    x
none    0/400    -
one     669/690  a

slowest: 3 s
"""


@pytest.mark.parametrize("printed", [MARKDOWN, DRAWN, COLUMNS], ids=["markdown", "drawn", "columns"])
def test_a_table_that_a_benchmark_printed_is_taken(printed: str) -> None:
    row = tables.taken("blind", printed)
    assert (row["head"][1:], row["command"]) == (["found", "x"], tables.COMMANDS["blind"])
    assert [cells[:2] for cells in row["rows"]] == [["none", "0/400"], ["one", "669/690"]]
    assert row["date"]
    assert row["commit"]


def test_a_run_that_printed_no_table_is_refused() -> None:
    with pytest.raises(UsageError, match="no table in what was read for 'circle'; give what tools/vcan tools/run"):
        tables.taken("circle", "interrupted\n")


def test_every_table_of_hours_stands_in_a_page_and_has_its_command() -> None:
    assert {name: row["command"] for name, row in tables.load().items()} == tables.COMMANDS
    pages = "".join((ROOT / name).read_text(encoding="utf-8") for name in PRESENT)
    assert [name for name in tables.COMMANDS if f"<!-- {name}: written by" not in pages] == []
