"""The site of the manual has every page, its pictures and the reference of the public names."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import tsa_ctrl
from tools.manual import site
from tsa_ctrl.cli.help import TOPICS
from tsa_ctrl.errors import UsageError

pytest.importorskip("mkdocs", reason="the extra docs is not installed")


def test_the_site_has_every_page_and_public_name_and_its_search_finds_them(tmp_path: Path) -> None:
    """mkdocs runs in strict mode, so a broken link fails the build."""
    done = site.build(tmp_path / "site")
    assert done.returncode == 0, done.stderr
    for topic in TOPICS:
        assert (tmp_path / "site" / f"{topic}.html").is_file()
    python = (tmp_path / "site" / "python.html").read_text(encoding="utf-8")
    assert [name for name in tsa_ctrl.__all__ if not name.startswith("_") and f"tsa_ctrl.{name}" not in python] == []
    found = json.loads((tmp_path / "site" / "search" / "search_index.json").read_text(encoding="utf-8"))
    places = {entry["location"].partition("#")[0] for entry in found["docs"]}
    assert {"index.html", "safety.html", "python.html"} <= places
    assert list((tmp_path / "site" / "pictures").glob("*.png"))
    assert site.build(tmp_path / "site").returncode == 0  # an earlier site is replaced


def test_a_folder_that_is_no_site_is_kept(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("kept")
    for out in (tmp_path, tmp_path / "mine.txt"):
        with pytest.raises(UsageError, match="it is not a site"):
            site.build(out)
    assert (tmp_path / "mine.txt").read_text() == "kept"
