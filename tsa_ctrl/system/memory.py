"""Memory of large arrays given back to the system as soon as they are done with.

glibc takes arrays of up to 32 MB from one heap once it has seen some freed, and a column of an hour at 1 kHz is 29 MB:
what lies between two that are still needed stays with the process. Above a fixed size each is a mapping of its own.
"""

from __future__ import annotations

import ctypes

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # as <malloc.h> names them
LARGE = 8 << 20  # bytes: a quarter of the size that glibc's own threshold rises to; a minute at 1 kHz is 0.5 MB
# Bytes that may stay free at the heap's end: with a fixed size above glibc keeps 128 KB, and each array of a minute is
# mapped anew, page by page: 16 % of a diagnosis
KEPT = 8 * LARGE


def give_back_large() -> None:
    """From here on, in this process; without glibc nothing happens."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_MMAP_THRESHOLD, LARGE)
        mallopt(M_TRIM_THRESHOLD, KEPT)
