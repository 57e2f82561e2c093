"""Names with a date for what is written again and again: nothing is overwritten."""

from __future__ import annotations

import datetime
from pathlib import Path


def untaken(folder: Path, kind: str, suffix: str = "", now: datetime.datetime | None = None) -> Path:
    """A path that is not taken: FOLDER/KIND-20250131-142501SUFFIX, with a number before SUFFIX if need be."""
    stem = f"{kind}-{now or datetime.datetime.now():%Y%m%d-%H%M%S}"
    path = folder / f"{stem}{suffix}"
    number = 1
    while path.exists():
        number += 1
        path = folder / f"{stem}-{number}{suffix}"
    return path
