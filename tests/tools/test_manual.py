"""The manual's generated parts equal their sources, its links exist, and its pages are short."""

from __future__ import annotations

import re

import pytest

from tests.conftest import ROOT
from tools.manual import measure
from tools.manual.write import PAGES, differing

PRESENT = [name for name in PAGES if (ROOT / name).is_file()]


def test_every_generated_part_is_what_its_source_says() -> None:
    assert [str(path.relative_to(ROOT)) for path in differing(ROOT)] == []


@pytest.mark.parametrize("name", PRESENT)
def test_every_link_and_picture_of_a_page_is_there(name: str) -> None:
    page = ROOT / name
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8")):
        assert target.startswith("https:") or (page.parent / target).exists(), target


def test_every_table_of_hours_stands_in_a_page_and_has_its_command() -> None:
    commands = measure.listed()["tables"]
    assert {name: row["command"] for name, row in measure.load(measure.TABLES).items()} == commands
    pages = "".join((ROOT / name).read_text(encoding="utf-8") for name in PRESENT)
    assert [name for name in commands if f"<!-- {name}: written by" not in pages] == []
