"""The ring between the real-time process and its readers."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsa_ctrl.log.ring import RingReader, RingWriter
from tsa_ctrl.signals import FIELD_NAMES, FIELDS

BLANK = [math.nan] * (len(FIELDS) - 1)


def record(number: float) -> list[float]:
    """Return a record with this time."""
    return [number, *BLANK]


@pytest.fixture
def ring() -> Iterator[RingWriter]:
    writer = RingWriter(axes=2, slots=16)
    yield writer
    writer.close()


def test_the_record_begins_with_time_and_has_each_field_once() -> None:
    assert FIELD_NAMES[0] == "t"
    assert len(set(FIELD_NAMES)) == len(FIELDS)


def test_axes_and_readers_have_positions_of_their_own() -> None:
    """The memory outlives the writer for a reader."""
    ring = RingWriter(axes=2, slots=16)
    first, second = RingReader(ring.fd), RingReader(ring.fd)
    ring.push(0, record(1.0))
    ring.push(1, record(2.0))
    ring.push(0, record(3.0))
    ring.close()
    for reader in (first, second):
        assert (reader.read(0)[:, 0].tolist(), reader.read(1)[:, 0].tolist()) == ([1.0, 3.0], [2.0])


@given(st.lists(st.integers(0, 40), max_size=12))
def test_what_was_read_and_what_was_lost_is_what_was_pushed(bursts: list[int]) -> None:
    writer = RingWriter(axes=1, slots=16)
    reader = RingReader(writer.fd)
    seen: list[float] = []
    number = 0
    for burst in bursts:
        for _ in range(burst):
            writer.push(0, record(number))
            number += 1
        block = reader.read(0)[:, 0].tolist()
        assert block == [float(i) for i in range(number - len(block), number)]
        seen += block
    assert len(seen) + reader.lost == number
    assert seen == sorted(set(seen))
    reader.close()
    writer.close()


def test_another_process_reads_through_the_descriptor(ring: RingWriter) -> None:
    ring.push(1, record(42.0))
    code = f"from tsa_ctrl.log.ring import RingReader; print(RingReader({ring.fd}).read(1)[0, 0])"
    done = subprocess.run([sys.executable, "-c", code], pass_fds=[ring.fd], capture_output=True, text=True, check=True)
    assert (done.stdout.strip(), done.stderr) == ("42.0", "")


def test_a_descriptor_of_something_else_is_no_ring() -> None:
    fd = os.memfd_create("other")
    os.ftruncate(fd, 8192)
    with pytest.raises(ValueError, match="not a ring"):
        RingReader(fd)
    os.close(fd)


def test_absurd_sizes_are_refused() -> None:
    for axes, slots in ((0, 16), (1, 1), (1, 0), (10_000, 16)):
        with pytest.raises(ValueError, match="allowed are 1 to"):
            RingWriter(axes, slots)
