"""Stretches of samples that are alike: the long ones, and those that only short gaps part.

As scipy.ndimage's opening and closing by a window, which takes longer to import than all else that reads a log.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]


def long(mask: Mask, least: int) -> Mask:
    """`mask` (n,) without its stretches of fewer than `least` samples."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    out = np.zeros(len(mask), dtype=np.bool_)
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        out[start:stop] = stop - start >= least
    return out


def joined(mask: Mask, window: int) -> Mask:
    """`mask` (n,) with the gaps of fewer than `window` samples filled, but for half a window at both ends."""
    inside = mask.copy()
    edges = np.flatnonzero(np.diff(mask))
    gaps = edges[0 if mask[0] else 1 :]  # from a change downwards on
    for start, stop in zip(gaps[::2], gaps[1::2], strict=False):
        if stop - start < window:
            inside[start + 1 : stop + 1] = True
    inside[: window // 2] = False
    inside[len(mask) - (window - 1) // 2 :] = False
    return inside
