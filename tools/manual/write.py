"""Write the generated parts of the manual's pages, between their markers.

Usage: tools/run manual/write [--check]

A part is the text between `<!-- NAME: written by tools/run manual/write -->` and `<!-- end of NAME -->`. With --check
nothing is written, and the exit status is 1 if a page differs from its sources.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path

from tools import command
from tools.manual import parts

PAGES = (
    "README.md",
    "config/README.md",
    "tools/README.md",
    "tsa_ctrl/README.md",
    "tsa_ctrl/cli/README.md",
    "tsa_ctrl/CHOOSE.md",
    "tsa_ctrl/DESIGN.md",
    "tsa_ctrl/ipc/README.md",
    "tsa_ctrl/CHANGES.md",
    "tsa_ctrl/model/README.md",
    "tsa_ctrl/identify/README.md",
    "tsa_ctrl/safety/README.md",
    "tsa_ctrl/bus/drive/README.md",
)
_PART = re.compile(
    r"(?P<begin><!-- (?P<name>[a-z-]+): written by tools/run manual/write -->\n).*?(?P<end><!-- end of (?P=name) -->)",
    re.DOTALL,
)


def rewritten(text: str, sources: Mapping[str, Callable[[], str]], where: str) -> str:
    """Return the text of a page with all parts generated again.

    Raises:
        KeyError: A part has no source. The message has page and part.
    """

    def fill(found: re.Match[str]) -> str:
        name = found["name"]
        if name not in sources:
            raise KeyError(f"{where}: no source for the part '{name}'; available: {', '.join(sources)}")
        return f"{found['begin']}{sources[name]().strip()}\n{found['end']}"

    return _PART.sub(fill, text)


def differing(root: Path) -> dict[Path, str]:
    """Return the paths of the pages that differ from their sources, with their new texts."""
    found = {}
    for name in PAGES:
        path = root / name
        if path.is_file():
            text = path.read_text(encoding="utf-8")
            wanted = rewritten(text, parts.SOURCES, name)
            if wanted != text:
                found[path] = wanted
    return found


def write_pages(check: bool = False) -> int:
    """Write the pages that differ from their sources. With `check`, only list them and return 1 if there are any."""
    pages = differing(command.ROOT)
    for path, text in pages.items():
        print(f"{path.relative_to(command.ROOT)}: {'differs from its sources' if check else 'written'}")
        if not check:
            path.write_text(text, encoding="utf-8")
    return int(check and bool(pages))


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; exit status 1 if a page differs")
    return write_pages(parser.parse_args().check)
