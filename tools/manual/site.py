"""Build the manual as a web site with search, from the pages of `tsa help` and a reference of the Python names.

Usage: tools/run manual/site [--out out/site]

The extra `docs` is required. The folder may be new, empty, or an earlier site, which is replaced. Links between pages
and to pictures work in the site. A link to another file of the repository becomes plain text, because the site does not
contain the code.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import tsa_ctrl
from tools import command
from tsa_ctrl.cli.help import PACKAGE, TOPICS
from tsa_ctrl.errors import UsageError

ROOT = PACKAGE.parent
INDEX = ROOT / "README.md"
MARK = "objects.inv"  # file that identifies a folder as a site
LINK = re.compile(r"(?P<picture>!?)\[(?P<text>[^\]]*)\]\((?P<target>[^)#\s]+)(?P<place>#[^)]*)?\)")


def sources() -> dict[Path, str]:
    """Return the file name of each page in the site, by the path of the page in the repository."""
    topics = {(PACKAGE / name).resolve(): f"{topic}.md" for topic, (name, _) in TOPICS.items()}
    return {INDEX.resolve(): "index.md", **topics}


def page(path: Path, names: dict[Path, str], pictures: Path) -> str:
    """Return the text of a page with its links adapted to the site, and copy its pictures."""

    def link(found: re.Match[str]) -> str:
        target = found["target"]
        if re.match(r"[a-z]+:", target):
            return found[0]
        file = (path.parent / target).resolve()
        if file in names:
            return f"[{found['text']}]({names[file]}{found['place'] or ''})"
        if found["picture"]:
            pictures.mkdir(exist_ok=True)
            shutil.copyfile(file, pictures / file.name)
            return f"![{found['text']}]({pictures.name}/{file.name})"
        return found["text"]

    return LINK.sub(link, path.read_text(encoding="utf-8"))


def reference() -> str:
    """Return the page of the public Python names, into which mkdocstrings inserts signatures and docstrings."""
    names = [name for name in tsa_ctrl.__all__ if not name.startswith("_")]
    return "# Python\n\n" + "\n".join(f"::: tsa_ctrl.{name}\n" for name in names)


def settings(out: Path) -> dict[str, Any]:
    """Return the settings of mkdocs."""
    handler = {"paths": [str(ROOT)], "options": {"show_source": False, "show_root_heading": True, "heading_level": 2}}
    return {
        "site_name": "tsa_ctrl",
        "site_dir": str(out.resolve()),
        "docs_dir": "pages",
        "strict": True,
        "use_directory_urls": False,
        "theme": {"name": "material", "font": False, "features": ["search.highlight", "navigation.top"]},
        "plugins": ["search", {"mkdocstrings": {"handlers": {"python": handler}}}],
        "markdown_extensions": ["tables", "fenced_code", {"toc": {"permalink": True}}],
        "nav": [{"Overview": "index.md"}, *(f"{topic}.md" for topic in TOPICS), {"Python": "python.md"}],
    }


def build(out: Path) -> subprocess.CompletedProcess[str]:
    """Write the site to the folder `out`, and return the result of mkdocs.

    Raises:
        UsageError: The extra `docs` is missing, or `out` has other files, which mkdocs would delete.
    """
    if importlib.util.find_spec("mkdocs") is None:
        raise UsageError("mkdocs is not installed; run pip install '.[docs]'")
    if out.exists() and not (out / MARK).is_file() and not (out.is_dir() and not any(out.iterdir())):
        raise UsageError(f"--out {out}: it is not a site, and would be replaced; give a new or an empty folder")
    names = sources()
    with tempfile.TemporaryDirectory(prefix="site-") as name:
        folder = Path(name)
        pages = folder / "pages"
        pages.mkdir()
        for path, target in names.items():
            (pages / target).write_text(page(path, names, pages / "pictures"), encoding="utf-8")
        tables = pages / "figures.md"  # less weight in the search, because its tables match many words
        tables.write_text("---\nsearch:\n  boost: 0.1\n---\n\n" + tables.read_text(encoding="utf-8"), encoding="utf-8")
        (pages / "python.md").write_text(reference(), encoding="utf-8")
        # mkdocs reads YAML, and JSON is YAML.
        (folder / "mkdocs.yml").write_text(json.dumps(settings(out)), encoding="utf-8")
        line = [sys.executable, "-m", "mkdocs", "build", "--quiet"]
        environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
        return subprocess.run(line, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--out", type=Path, default=Path("out/site"), help="folder of the site (default out/site)")
    chosen = parser.parse_args()
    done = build(chosen.out)
    if done.returncode != 0:
        raise UsageError(f"mkdocs: {(done.stderr or done.stdout).strip().splitlines()[-1]}")
    print(chosen.out / "index.html")
    return 0
