"""The site of the manual: every page, its pictures and the reference of the public names."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import tsa_ctrl
from tools.manual import site
from tsa_ctrl.cli.help import TOPICS

pytest.importorskip("mkdocs", reason="the extra docs is not installed")


def test_the_site_has_every_page_and_public_name_and_its_search_finds_them(tmp_path: Path) -> None:
    """mkdocs is strict: a link that leads nowhere ends the build."""
    done = site.build(tmp_path / "site")
    assert done.returncode == 0, done.stderr
    for topic in TOPICS:
        if topic != "figures":
            assert (tmp_path / "site" / f"{topic}.html").is_file()
    python = (tmp_path / "site" / "python.html").read_text(encoding="utf-8")
    assert [name for name in tsa_ctrl.__all__ if not name.startswith("_") and f"tsa_ctrl.{name}" not in python] == []
    found = json.loads((tmp_path / "site" / "search" / "search_index.json").read_text(encoding="utf-8"))
    places = {entry["location"].partition("#")[0] for entry in found["docs"]}
    assert {"index.html", "safety.html", "python.html"} <= places
    assert list((tmp_path / "site" / "pictures").glob("*.png"))
