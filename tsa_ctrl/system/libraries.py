"""Keep libraries out of the daemon's process that it does not use, because all of its memory is locked."""

from __future__ import annotations

import os
import sys


def leave_out() -> None:
    """Load neither scipy.linalg nor threads of OpenBLAS in this process; call it before numpy is imported.

    numba imports scipy.linalg for matrix products in compiled functions, and the daemon's have none. The largest matrix
    of the daemon has a dozen rows, for which a single thread suffices.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.modules["scipy.linalg"] = None  # type: ignore[assignment]  # Python's way to have an import fail
