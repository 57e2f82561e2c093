"""The one decorator of the inner loop: compiled by numba, kept in a cache, IEEE division.

numba looks at a function's own file only when it decides whether a cached version is still good, not at the files of
the called functions. So the compiled code of these sources is in a separate folder, named by their digest.
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
_KEPT = 14 * 86_400.0  # s; compiled code of other versions is thrown away when it is older: two weeks of going back


def _cache_of(folder: Path) -> str:
    """Return the folder below numba's cache for these sources; "" if numba selects one."""
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
    """Compile on first use; later processes load the result."""
    before, config.CACHE_DIR = config.CACHE_DIR, _CACHE or config.CACHE_DIR
    try:
        return cast(F, njit(cache=True, error_model="numpy")(function))
    finally:
        config.CACHE_DIR = before
