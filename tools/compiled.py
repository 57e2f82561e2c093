"""Use the compiled build of this source in .cache, which `tools/run package/compiled` makes.

This module uses the standard library only, because `tools/__main__.py` imports it first.
"""

from __future__ import annotations

import hashlib
import os
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BUILDS = ROOT / ".cache" / "compiled"
PART = f"{os.sep}.cache{os.sep}compiled{os.sep}"
VARIABLE = "TSA_COMPILE"  # 0: interpret the source even if a compiled build exists
SAFE_PATH = "PYTHONSAFEPATH"  # without it the current folder, with the source, comes before PYTHONPATH


@cache
def build_folder() -> Path:
    """Return the folder of the compiled build of the present source. It need not exist."""
    found = hashlib.sha256(sys.implementation.cache_tag.encode())
    for path in [ROOT / "tools" / "package" / "backend.py", *sorted((ROOT / "tsa_ctrl").rglob("*.py"))]:
        found.update(path.read_bytes())
    return BUILDS / found.hexdigest()[:16]


def use() -> None:
    """Make this process and those that it starts import the compiled build of this source, if there is one."""
    inherited = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]
    paths = [path for path in inherited if PART not in path]  # remove builds of another source
    if paths != inherited:
        os.environ.pop(SAFE_PATH, None)
    sys.path[:] = [path for path in sys.path if PART not in path]
    if os.environ.get(VARIABLE) != "0" and BUILDS.is_dir() and build_folder().is_dir():
        paths.insert(0, str(build_folder()))
        sys.path.insert(0, paths[0])
        os.environ[SAFE_PATH] = "1"
    if paths or inherited:
        os.environ["PYTHONPATH"] = os.pathsep.join(paths)
