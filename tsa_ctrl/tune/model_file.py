"""The files' way: what would change as a diff, the old ones kept beside them, and back again.

A tuning keeps all files that it replaces under one number, `NAME.~N~`, above those of all files that it may replace.
A signal waits until all of them are written.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path

from tsa_ctrl import settings
from tsa_ctrl.errors import UsageError
from tsa_ctrl.outputs import backups
from tsa_ctrl.system.signals import postponed


def diff(path: Path, text: str) -> str:
    """Unified diff from the file to `text`."""
    before = path.read_text(encoding="utf-8").splitlines(keepends=True)
    return "".join(difflib.unified_diff(before, text.splitlines(keepends=True), path.name, f"{path.name} (new)"))


@postponed()
def replace(texts: Mapping[Path, str], beside: Sequence[Path] = ()) -> dict[Path, Path]:
    """Write each text to its path, by renaming; returns where the files that were there are kept.

    Their number is above all that these paths and those `beside` have. When one cannot be written, none is.
    """
    number = 1 + max((n for path in (*texts, *beside) for n in backups(path)), default=0)
    kept = {path: path.with_name(f"{path.name}.~{number}~") for path in texts}
    before = {path: path.read_text(encoding="utf-8") for path in texts}
    written = []
    try:
        for path, text in texts.items():
            settings.write_text(kept[path], before[path])
            settings.write_text(path, text)
            written.append(path)
    except BaseException:
        for path in written:
            settings.write_text(path, before[path])
        for other in kept.values():
            other.unlink(missing_ok=True)
        raise
    return kept


def last(path: Path, *others: Path) -> dict[Path, Path]:
    """The newest kept file of `path`, and what was kept of the others with it; raises UsageError when there is none."""
    old = backups(path)
    if not old:
        raise UsageError(f"{path}: nothing to undo, no {path.name}.~N~ is beside it")
    number = max(old)
    found = {path: old[number]}
    for other in others:
        kept = backups(other)
        if number in kept and max(kept) > number:
            raise UsageError(f"{other}: was replaced again since, see {kept[max(kept)].name}; undo that first")
        if number in kept:
            found[other] = kept[number]
    return found


@postponed()
def undo(kept: Mapping[Path, Path]) -> None:
    """Put kept files back in place."""
    for path, old in kept.items():
        settings.write_text(path, old.read_text(encoding="utf-8"))
    for old in kept.values():
        old.unlink()
