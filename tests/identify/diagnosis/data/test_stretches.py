"""Opening and closing of Boolean masks, compared with the morphology of scipy."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, binary_opening

from tsa_ctrl.identify.diagnosis.data.direction import joined, long

masks = arrays.arrays(np.bool_, st.integers(1, 60))


@given(masks, st.integers(1, 9))
def test_long_is_an_opening(mask: NDArray[np.bool_], least: int) -> None:
    """`long` equals an opening with a window of `least` samples."""
    np.testing.assert_array_equal(long(mask, least), binary_opening(mask, np.ones(least)))


@given(masks, st.integers(1, 9))
def test_joined_is_a_closing(mask: NDArray[np.bool_], window: int) -> None:
    """Like scipy's closing, `joined` treats samples beyond both ends as False."""
    np.testing.assert_array_equal(joined(mask, window), binary_closing(mask, np.ones(window)))
