"""A door with three locks, for the test of what leads the fuzzing."""

from __future__ import annotations


def depth(data: bytes) -> int:
    """How many of its bytes are right, from the first on."""
    if data[:1] != b"\x5b":
        return 0
    if data[1:2] != b"\xa9":
        return 1
    if data[2:3] != b"\x07":
        return 2
    return 3
