"""The one decorator of the inner loop: compiled by numba, kept in a cache beside the sources, IEEE division.

numba looks at a function's own file only when it decides whether a cached version is still good, not at the files of
what it calls. So the cache of this folder is thrown away whenever any source of it has changed.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

from numba import njit

F = TypeVar("F", bound=Callable[..., object])

_KERNELS = ("compiled.py", "state.py", "interpolation.py", "losses.py", "full.py", "chain.py", "mechanics.py")


def compiled(function: F) -> F:
    """Compile on first use; later processes load the result."""
    return cast(F, njit(cache=True, error_model="numpy")(function))


def _drop_stale_cache(folder: Path) -> None:
    """Remove compiled code of other sources than these; a folder that cannot be written has no cache to be stale."""
    sources = b"".join((folder / name).read_bytes() for name in _KERNELS)
    digest = hashlib.blake2b(sources, digest_size=16).hexdigest()
    cache = folder / "__pycache__"
    stamp = cache / "kernels.digest"
    with contextlib.suppress(OSError):
        if stamp.exists() and stamp.read_text(encoding="ascii") == digest:
            return
        cache.mkdir(exist_ok=True)
        for pattern in ("*.nbi", "*.nbc"):
            for path in cache.glob(pattern):
                path.unlink(missing_ok=True)
        stamp.write_text(digest, encoding="ascii")


_drop_stale_cache(Path(__file__).parent)
