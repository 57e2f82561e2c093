"""Share memory between processes without a lock, with one rule by which a reader accepts a content.

A word is 8 aligned bytes with one writer. It is accessed through a memoryview cast to "Q", which copies it by a memcpy
of constant size. On a 64-bit processor this is one load or store, never half of one. (`struct.pack_into` with "<" or
"=" may copy byte by byte.)

Readers do not rely on the order of two writes. Another processor may observe them in the opposite order (on ARM, but
not on x86), and Python has no memory barrier. Content longer than a word is therefore stored in a place, which holds a
number, a checksum over number and content, and the content. A reader copies the place, and accepts the copy only if it
has the requested number and a correct checksum. A copy made during a write is discarded. This rule assumes nothing
about the machine. It accepts an incorrect copy once in 2^32 such cases. The checksum adds 0.6 us to storing a record of
25 numbers.

A writer that writes repeatedly alternates between two or more places. If it is stopped during a write, readers still
have the previous content.

The memory has no name (memfd), and child processes receive it as a descriptor. It is freed when its last user ends for
any reason.
"""

from __future__ import annotations

import mmap
import os
import struct
from zlib import crc32

_HEAD = struct.Struct("=QQ")  # 1st word: checksum (low 32 bits) and length of the content (high 32 bits); 2nd: number
_WORD = struct.Struct("=Q")
_LINE = 64  # bytes of a cache line; each place starts on one
_U32 = 0xFFFFFFFF
_TRIES = 100  # attempts of a reader; an attempt fails only if whole writes start and end during it


class SharedMemory:
    """Memory that is shared by a descriptor."""

    def __init__(self, size: int, descriptor: int | None = None) -> None:
        """Create the memory, or map an existing one.

        New memory is written once, so that no page fault occurs later.

        Args:
            size: bytes.
            descriptor: memory to map, or to create if it is empty; None for a new descriptor.

        Raises:
            ValueError: The descriptor has fewer bytes.
        """
        if descriptor is None:
            descriptor = os.memfd_create("tsa", os.MFD_CLOEXEC)
        made = os.fstat(descriptor).st_size == 0
        if made:
            os.ftruncate(descriptor, size)
        self.descriptor = descriptor
        self.bytes = mmap.mmap(descriptor, size)
        if made:
            self.bytes[:] = bytes(size)
        self._view = memoryview(self.bytes)
        self.words = self._view[: size // 8 * 8].cast("Q")

    def array(self, at: int, count: int) -> memoryview:
        """Return `count` words, starting at byte `at`."""
        return self.words[at // 8 : at // 8 + count]

    def close(self) -> None:
        """Unmap the memory and close the descriptor. Raise BufferError while an `array` is in use."""
        self.words.release()
        self._view.release()
        self.bytes.close()
        os.close(self.descriptor)


def space(count: int, size: int) -> int:
    """Return the size in bytes of `count` places for contents of up to `size` bytes."""
    return count * (-(-(_HEAD.size + size) // _LINE) * _LINE)


class Places:
    """Contents that are numbered from 1. Number n is stored in place n modulo `count`."""

    def __init__(self, memory: SharedMemory, at: int, count: int, size: int) -> None:
        """Lay out the places.

        Args:
            memory: shared memory.
            at: first byte of the places, a multiple of 64.
            count: number of places.
            size: length of the longest content, bytes.
        """
        self._bytes = memory.bytes
        self._words = memory.words
        self._step = space(1, size)
        self._at = [at + n * self._step for n in range(count)]
        self.count = count
        self.size = size

    def write(self, number: int, content: bytes) -> None:
        """Write a content. Only one process may write. Raise ValueError if the content is too long."""
        length = len(content)
        if length > self.size:
            raise ValueError(f"{length} bytes, there is room for {self.size}")
        at = self._at[number % self.count]
        summed = _WORD.pack(number) + content
        self._bytes[at : at + _HEAD.size + length] = _WORD.pack(crc32(summed) | length << 32) + summed

    def read(self, number: int) -> bytes | None:
        """Return the content with this number, or None if it is missing or incomplete."""
        at = self._at[number % self.count]
        if self._words[at // 8 + 1] != number:  # saves the copy, whose number is checked again
            return None
        copy = self._bytes[at : at + self._step]
        check, found = _HEAD.unpack_from(copy)
        summed = copy[_WORD.size : _HEAD.size + (check >> 32)]
        return summed[_WORD.size :] if found == number and crc32(summed) == check & _U32 else None

    def claimed(self, number: int) -> int:
        """Return the number of the content, complete or not, in the place of this number."""
        return self._words[self._at[number % self.count] // 8 + 1]

    def newest(self) -> tuple[int, bytes]:
        """Return number and bytes of the newest complete content, or 0 and no bytes before the first one."""
        words = self._words
        for _ in range(_TRIES):
            claimed = sorted((words[at // 8 + 1] for at in self._at), reverse=True)
            for number in claimed:
                if number and (content := self.read(number)) is not None:
                    return number, content
            if not any(claimed):
                break
        return 0, b""


class Newest:
    """A content that is written repeatedly, alternating between two places. Readers obtain the newest complete one."""

    def __init__(self, memory: SharedMemory, at: int, size: int) -> None:
        self._places = Places(memory, at, 2, size)
        self._number, _ = self.read()
        self._taken = 0

    def write(self, content: bytes) -> None:
        """Write the content. Only one process may write. Raise ValueError if the content is too long."""
        self._number += 1
        self._places.write(self._number, content)

    def read(self) -> tuple[int, bytes]:
        """Return number and content, or 0 and no bytes before the first one or if each attempt was overwritten."""
        one, other = self._places.claimed(0), self._places.claimed(1)
        number = one if one > other else other
        content = self._places.read(number) if number else None
        return self._places.newest() if content is None else (number, content)

    def take(self) -> bytes | None:
        """Return the newest content once, or None without new content."""
        if self._places.claimed(0) <= self._taken and self._places.claimed(1) <= self._taken:
            return None
        number, content = self.read()
        if number <= self._taken:
            return None
        self._taken = number
        return content
