"""Memory of large arrays given back to the system as soon as they are done with.

glibc takes arrays of up to 32 MB from one heap once it has seen some freed, and a column of an hour at 1 kHz is 29 MB:
what lies between two that are still needed stays with the process. Above a fixed size each is a mapping of its own.
"""

from __future__ import annotations

import ctypes

M_MMAP_THRESHOLD = -3  # as <malloc.h> names it
LARGE = 8 << 20  # bytes: a quarter of the size that glibc's own threshold rises to; a minute at 1 kHz is 0.5 MB


def give_back_large() -> None:
    """From here on, in this process; without glibc nothing happens."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_MMAP_THRESHOLD, LARGE)
