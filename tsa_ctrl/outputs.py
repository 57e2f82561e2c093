"""Write output files without overwriting inputs, and text to the terminal without changing it.

A command never overwrites a file that it reads. Any other existing file is kept next to the new one as `NAME.~N~`. A
file that is written repeatedly has a name with a date.
"""

from __future__ import annotations

import contextlib
import datetime
import fcntl
import os
import re
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from tsa_ctrl.errors import UsageError

if TYPE_CHECKING:
    from rich.console import Console

LOCK = ".tsa.lock"  # file in a folder while files are written to it


def terminal(stderr: bool = False) -> Console:
    """Return a console that prints text as it is: no names such as [axis.law] as markup, no ":b:" as an emoji.

    It folds a table cell that is too long for the terminal, instead of cutting it. Columns without wrapping are cut.
    """
    from rich.console import Console  # not loaded by a daemon
    from rich.table import Table

    class Whole(Console):
        def print(self, *objects: Any, **options: Any) -> None:
            for column in (column for shown in objects if isinstance(shown, Table) for column in shown.columns):
                column.overflow = "fold"
            super().print(*objects, **options)

    return Whole(stderr=stderr, markup=False, emoji=False, highlight=False)


def refuse_inputs(out: Path, inputs: Iterable[Path], option: str = "--out") -> None:
    """Raise UsageError if `out` is one of the files `inputs` under any name or link."""
    for path in inputs:
        with contextlib.suppress(OSError, ValueError):
            if out.exists() and out.samefile(path):
                raise UsageError(f"{option} {out}: is {path}, which is read; choose another file")


def make_folder(folder: Path, remedy: str = "choose another --out") -> None:
    """Create a folder and its parents if they do not exist; raise UsageError with the remedy if that fails."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{folder}: cannot be created ({error.strerror}); {remedy}") from None


def backups(path: Path) -> dict[int, Path]:
    """Return the backups `NAME.~N~` of a file by N, oldest first."""
    pattern = re.compile(re.escape(path.name) + r"\.~(\d+)~")
    found = {int(match[1]): other for other in path.parent.iterdir() if (match := pattern.fullmatch(other.name))}
    return dict(sorted(found.items()))


def keep(path: Path) -> Path | None:
    """Copy a file that will be replaced to the next free `NAME.~N~`. Return the copy, or None without a file.

    Raises:
        UsageError: The file cannot be copied, and must therefore not be replaced.
    """
    if not path.is_file():
        return None
    try:
        kept = path.with_name(f"{path.name}.~{1 + max(backups(path), default=0)}~")
        shutil.copy2(path, kept)
    except OSError as error:
        raise UsageError(
            f"{path}: cannot be kept under another name ({error.strerror}); choose another place"
        ) from None
    return kept


def move_into(beside: Path, path: Path) -> Path | None:
    """Rename a temporary file to `path`. Return the path of the copy of the old file, or None without an old file.

    Raises:
        OSError: The file cannot be renamed.
    """
    kept = keep(path)
    try:
        beside.replace(path)
    except BaseException:
        if kept is not None:
            kept.unlink(missing_ok=True)
        raise
    return kept


@contextlib.contextmanager
def beside(path: Path, keeping: bool = True) -> Iterator[Path]:
    """Yield a temporary path in the folder of `path`, and rename the file there to `path` when the block ends.

    Args:
        path: file to write.
        keeping: True to keep an old file at `path` as a backup.

    Raises:
        UsageError: The file cannot be written. No part of it remains.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        yield part
        if keeping:
            move_into(part, path)
        else:
            part.replace(path)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written ({error.strerror or error}); choose another place") from None
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def save_picture(figure: Any, path: Path, dpi: int, keeping: bool = True) -> None:
    """Write a matplotlib figure in the format of the suffix; `keeping` has the meaning of `beside`.

    Raises:
        UsageError: The format is not supported, or the file cannot be written. No part of it remains.
    """
    with beside(path, keeping) as part:
        try:
            figure.savefig(part, dpi=dpi, format=path.suffix[1:])
        except (ValueError, RuntimeError):  # no such format, or a format that needs a missing program
            raise UsageError(
                f"{path}: no picture of that kind can be written; choose a name that ends with .png"
            ) from None


def kept_words(path: Path, kept: Path | None) -> str:
    """Return `written: FILE`, with the name of the backup of the old file if there is one."""
    return f"written: {path}" + ("" if kept is None else f" (the file before is {kept.name})")


@contextlib.contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Lock a folder while its files are written, and create it if necessary.

    The kernel releases the lock when the process ends for any reason.

    Raises:
        UsageError: The folder cannot be written, or another process has locked it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise UsageError(f"{folder}: cannot be written ({error.strerror}); choose another --out") from None
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise UsageError(
                f"{folder}: another command is writing there; wait for it, or choose another --out"
            ) from None
        yield
        with contextlib.suppress(OSError):
            (folder / LOCK).unlink()
    finally:
        os.close(handle)


def untaken(folder: Path, kind: str, suffix: str = "", now: datetime.datetime | None = None) -> Path:
    """Return a free path FOLDER/KIND-20250131-142501SUFFIX, with a number before SUFFIX if necessary."""
    stem = f"{kind}-{now or datetime.datetime.now():%Y%m%d-%H%M%S}"
    path = folder / f"{stem}{suffix}"
    number = 1
    while path.exists():
        number += 1
        path = folder / f"{stem}-{number}{suffix}"
    return path


def json_types(value: object) -> Any:
    """Return `value` in JSON types, with None for each number that is not finite.

    `value` may consist of dataclasses, structs, mappings, sequences, enumerations, paths and numbers.
    """
    return msgspec.json.decode(msgspec.json.encode(value, enc_hook=_basic))


def _basic(value: Any) -> object:
    return float(value) if isinstance(value, float) else os.fspath(value)
