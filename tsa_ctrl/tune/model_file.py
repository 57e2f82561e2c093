"""The model file's way: what would change as a diff, the old one kept beside it, and back again."""

from __future__ import annotations

import difflib
import re
from pathlib import Path

from tsa_ctrl import settings
from tsa_ctrl.errors import UsageError


def diff(path: Path, text: str) -> str:
    """Unified diff from the file to `text`."""
    before = path.read_text(encoding="utf-8").splitlines(keepends=True)
    return "".join(difflib.unified_diff(before, text.splitlines(keepends=True), path.name, f"{path.name} (new)"))


def backups(path: Path) -> list[Path]:
    """Files that were replaced, `NAME.~N~`, oldest first."""
    pattern = re.compile(re.escape(path.name) + r"\.~(\d+)~")
    found = [(int(match[1]), other) for other in path.parent.iterdir() if (match := pattern.fullmatch(other.name))]
    return [other for _, other in sorted(found)]


def replace(path: Path, text: str) -> Path:
    """Write `text` to `path`, by renaming; returns where the file that was there is kept, the next `NAME.~N~`."""
    old = backups(path)
    number = int(old[-1].name.rpartition(".~")[2][:-1]) + 1 if old else 1
    kept = path.with_name(f"{path.name}.~{number}~")
    settings.write_text(kept, path.read_text(encoding="utf-8"))
    try:
        settings.write_text(path, text)
    except BaseException:
        kept.unlink()
        raise
    return kept


def undo(path: Path) -> Path:
    """Put the newest kept file back in place and return where it was kept; raises UsageError when there is none."""
    old = backups(path)
    if not old:
        raise UsageError(f"{path}: nothing to undo, no {path.name}.~N~ is beside it")
    settings.write_text(path, old[-1].read_text(encoding="utf-8"))
    old[-1].unlink()
    return old[-1]
