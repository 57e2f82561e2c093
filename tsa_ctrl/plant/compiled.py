"""Provide the decorator that compiles the inner loop with numba, with a cache and IEEE division.

numba checks only a function's own file, not those of called functions, to decide if its cached code is still valid. The
compiled code of these sources is therefore in a separate folder, named by their common digest.
"""

from __future__ import annotations

import contextlib
import hashlib
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

from numba import config, njit

from tsa_ctrl.system.compiling import announce

announce()

F = TypeVar("F", bound=Callable[..., object])

_KERNELS = (
    "compiled.py",
    "state.py",
    "effects.py",
    "full.py",
    "chain.py",
    "mechanics.py",
)
_KEPT = 14 * 86_400.0  # s; older code of other versions is deleted; within two weeks, going back needs no compilation


def _cache_of(folder: Path) -> str:
    """Return the folder for these sources in numba's cache folder; "" if no cache folder is configured."""
    if not config.CACHE_DIR:
        return ""
    digest = hashlib.blake2b(b"".join((folder / name).read_bytes() for name in _KERNELS), digest_size=8).hexdigest()
    cache = Path(config.CACHE_DIR) / f"plant-{digest}"
    with contextlib.suppress(OSError):
        if not cache.exists():
            for other in cache.parent.glob("plant-*"):
                if time.time() - other.stat().st_mtime > _KEPT:
                    shutil.rmtree(other, ignore_errors=True)
            cache.mkdir(parents=True)
    return str(cache)


_CACHE = _cache_of(Path(__file__).parent)


def compiled(function: F) -> F:
    """Compile the function at its first call; later processes load the compiled code."""
    before, config.CACHE_DIR = config.CACHE_DIR, _CACHE or config.CACHE_DIR
    try:
        return cast(F, njit(cache=True, error_model="numpy")(function))
    finally:
        config.CACHE_DIR = before
