"""A reader of shared memory never accepts a value that was not written completely."""

from __future__ import annotations

import os
import signal
import struct
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsa_ctrl.system.shared_memory import Newest, Places, SharedMemory, space

SIZE = 40  # bytes of content
WORDS = space(1, SIZE) // 8
_VALUES = struct.Struct("=5Q")


@pytest.fixture
def memory() -> Iterator[SharedMemory]:
    made = SharedMemory(space(4, SIZE))
    yield made
    made.close()


def content(number: int) -> bytes:
    return _VALUES.pack(*(number for _ in range(5)))


def test_what_was_written_is_read_by_its_number_alone(memory: SharedMemory) -> None:
    places = Places(memory, 0, 4, SIZE)
    assert [places.read(number) for number in (1, 2, 3, 4)] == [None] * 4
    places.write(6, b"six")
    assert places.read(6) == b"six"
    assert [places.read(number) for number in (2, 5, 7, 10)] == [None, None, None, None]
    with pytest.raises(ValueError, match="41 bytes, there is room for 40"):
        places.write(1, bytes(SIZE + 1))


def test_another_mapping_of_the_descriptor_is_the_same_memory(memory: SharedMemory) -> None:
    """A writer that follows another continues with its numbers. A larger mapping than the memory is rejected."""
    assert Newest(memory, 0, SIZE).read() == (0, b"")
    other = SharedMemory(space(4, SIZE), os.dup(memory.descriptor))
    Newest(memory, 0, SIZE).write(b"first")
    Newest(other, 0, SIZE).write(b"second")
    assert Newest(memory, 0, SIZE).read() == (2, b"second")
    other.close()
    with pytest.raises(ValueError, match="mmap length is greater"):
        SharedMemory(1 << 20, memory.descriptor)


@given(st.lists(st.booleans(), min_size=WORDS, max_size=WORDS), st.integers(1, 1000))
def test_a_write_of_which_any_part_has_arrived_is_whole_or_nothing(arrived: list[bool], before: int) -> None:
    """Some processors (ARM) make the writes of another processor visible in any order."""
    memory = SharedMemory(space(1, SIZE))
    places = Places(memory, 0, 1, SIZE)
    places.write(before, content(before))
    old = memory.words.tolist()
    places.write(before + 1, content(before + 1))
    new = memory.words.tolist()
    for n, come in enumerate(arrived):
        memory.words[n] = new[n] if come else old[n]
    assert places.read(before) in (None, content(before))
    assert places.read(before + 1) in (None, content(before + 1))
    assert (places.read(before + 1) is not None) == (memory.words.tolist() == new)
    memory.close()


@given(st.binary(max_size=SIZE), st.integers(0, 8 * space(1, SIZE) - 1))
def test_one_wrong_bit_is_found(data: bytes, bit: int) -> None:
    memory = SharedMemory(space(1, SIZE))
    places = Places(memory, 0, 1, SIZE)
    places.write(1, data)
    memory.bytes[bit // 8] ^= 1 << bit % 8
    assert (places.read(1) == data) == (bit // 8 >= 16 + len(data))
    memory.close()


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_a_writer_stopped_in_the_middle_of_a_write_leaves_what_was_before(memory: SharedMemory, number: int) -> None:
    newest = Newest(memory, 0, SIZE)
    for n in range(1, number + 1):
        newest.write(content(n))
    half = bytes(memory.bytes)
    newest.write(content(number + 1))
    at = (number + 1) % 2 * space(1, SIZE) + 24  # the remaining bytes were not written
    memory.bytes[at:] = half[at:]
    assert Newest(memory, 0, SIZE).read() == (number, content(number))


def test_what_is_taken_is_the_newest_and_taken_once(memory: SharedMemory) -> None:
    writer, reader = Newest(memory, 0, SIZE), Newest(memory, 0, SIZE)
    assert reader.take() is None
    for content in (b"first", b"second", b"third"):
        writer.write(content)
    assert [reader.take(), reader.take()] == [b"third", None]
    writer.write(b"fourth")
    memory.bytes[0] ^= 0xFF  # its slot is not complete yet
    assert reader.take() is None
    memory.bytes[0] ^= 0xFF
    assert [reader.take(), reader.take()] == [b"fourth", None]


def test_a_reader_sees_whole_contents_only_while_another_process_writes() -> None:
    memory = SharedMemory(space(2, SIZE))
    newest = Newest(memory, 0, SIZE)
    newest.write(content(1))
    writer = os.fork()
    if writer == 0:
        for number in range(2, 10**9):
            newest.write(content(number))
    try:
        found = [newest.read() for _ in range(20_000)]
    finally:
        os.kill(writer, signal.SIGKILL)
        os.waitpid(writer, 0)
    read = [(number, _VALUES.unpack(data)) for number, data in found if number]
    assert read[-1][0] > read[0][0]
    assert all(set(values) == {number} for number, values in read)
    memory.close()
