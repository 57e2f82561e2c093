"""Keep compiled functions between runs in a folder that this user can write, wherever the package is installed.

numba reads `NUMBA_CACHE_DIR` when it is imported, and raises an error if it finds no writable folder. The package
therefore sets the variable before it imports numba. A value that the user has set is kept.
"""

from __future__ import annotations

import os
import stat
import sys
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"


def choose() -> None:
    """Set `NUMBA_CACHE_DIR`, unless it is set, to ~/.cache/tsa-ctrl/numba or else to a temporary folder.

    A new temporary folder is reported.
    """
    if os.environ.get(VARIABLE):
        return
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111 (a Path without a home raises)
    folder = Path(base, "tsa-ctrl", "numba")
    if not folder.is_absolute() or not _usable(folder):
        folder = _temporary()
    os.environ[VARIABLE] = str(folder)


def _usable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK | os.X_OK)


def _temporary() -> Path:
    """Return this user's own temporary folder, never a folder that another user may have created."""
    import tempfile  # imported here only, because it takes 8 ms in which Ctrl-C would still print a traceback

    folder = Path(tempfile.gettempdir(), f"tsa-ctrl-numba-{os.getuid()}")
    try:
        folder.mkdir(mode=0o700)
    except FileExistsError:
        found = folder.lstat()
        if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o022:
            return folder
        folder = Path(tempfile.mkdtemp(prefix="tsa-ctrl-numba-"))
    print(
        f"tsa: no home folder for compiled functions; they are stored in {folder} (set {VARIABLE} for another place)",
        file=sys.stderr,
    )
    return folder
