"""Share memory between processes without a lock, with one rule by which a reader accepts a content.

A word is 8 bytes, aligned, with one writer. It goes through a memoryview cast to "Q", which copies it by a memcpy of
constant size: one load or store of a 64-bit processor, never half of one. (`struct.pack_into` with "<" or "=" may copy
byte by byte.)

Readers do not rely on the order of two writes. Another processor may see them in the opposite order (ARM does that, x86
does not), and Python has no memory barrier. Content longer than a word is therefore stored in a place, which holds a
number, a checksum over number and content, and the content. A reader copies the place and accepts the copy only if its
number is the requested one and the checksum is correct. A copy made during a write is discarded. This holds on every
machine, because it assumes nothing about it; an incorrect copy is accepted once in 2^32 such cases. The checksum adds
0.6 us to the storing of a record of 25 numbers.

A writer that writes repeatedly alternates between two or more places. If it is stopped during a write, readers still
have the content before it.

The memory has no name (memfd) and is handed to child processes as a descriptor: it ends with its last user, however
that one ends.
"""

from __future__ import annotations

import mmap
import os
import struct
from zlib import crc32

_HEAD = struct.Struct("=QQ")  # check sum, and the length of the content above its 32 bits; number
_WORD = struct.Struct("=Q")
_LINE = 64  # bytes of a cache line: places begin on one
_U32 = 0xFFFFFFFF
_TRIES = 100  # of a reader; one is lost only when whole writes began and ended in the middle of it


class SharedMemory:
    """Hold `size` bytes, created and touched once so that no page fault comes later, or mapped from a `descriptor`.

    They are created in the memory of a `descriptor` that is empty.
    """

    def __init__(self, size: int, descriptor: int | None = None) -> None:
        """Create or map the memory; raises ValueError if the descriptor has fewer bytes."""
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
        """Return `count` words from byte `at` on."""
        return self.words[at // 8 : at // 8 + count]

    def close(self) -> None:
        """Unmap the memory and close the descriptor; raises BufferError while an `array` is in use."""
        self.words.release()
        self._view.release()
        self.bytes.close()
        os.close(self.descriptor)


def space(count: int, size: int) -> int:
    """Return the bytes of `count` places for contents of up to `size` bytes."""
    return count * (-(-(_HEAD.size + size) // _LINE) * _LINE)


class Places:
    """Hold contents that are numbered from 1; number n lies in place n modulo `count`."""

    def __init__(self, memory: SharedMemory, at: int, count: int, size: int) -> None:
        """Use the memory from byte `at` (a multiple of 64) on; `size`: length of the longest content in bytes."""
        self._bytes = memory.bytes
        self._words = memory.words
        self._step = space(1, size)
        self._at = [at + n * self._step for n in range(count)]
        self.count = count
        self.size = size

    def write(self, number: int, content: bytes) -> None:
        """Write a content, in the one process that writes; raises ValueError if it is too long."""
        length = len(content)
        if length > self.size:
            raise ValueError(f"{length} bytes, there is room for {self.size}")
        at = self._at[number % self.count]
        summed = _WORD.pack(number) + content
        self._bytes[at : at + _HEAD.size + length] = _WORD.pack(crc32(summed) | length << 32) + summed

    def read(self, number: int) -> bytes | None:
        """Return the content of this number, or None unless it is complete."""
        at = self._at[number % self.count]
        if self._words[at // 8 + 1] != number:  # spares the copy, in which it is looked at again
            return None
        copy = self._bytes[at : at + self._step]
        check, found = _HEAD.unpack_from(copy)
        summed = copy[_WORD.size : _HEAD.size + (check >> 32)]
        return summed[_WORD.size :] if found == number and crc32(summed) == check & _U32 else None

    def claimed(self, number: int) -> int:
        """Return the number of the content, complete or not, in the place of this number."""
        return self._words[self._at[number % self.count] // 8 + 1]

    def newest(self) -> tuple[int, bytes]:
        """Return number and bytes of the newest complete content; 0 and no bytes before the first."""
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
    """Hold one content that is written repeatedly, in two places in turn; a reader gets the newest complete one."""

    def __init__(self, memory: SharedMemory, at: int, size: int) -> None:
        self._places = Places(memory, at, 2, size)
        self._number, _ = self.read()
        self._taken = 0

    def write(self, content: bytes) -> None:
        """Write the content, in the one process that writes; raises ValueError if it is too long."""
        self._number += 1
        self._places.write(self._number, content)

    def read(self) -> tuple[int, bytes]:
        """Return number and content; 0 and no bytes before the first, or if each attempt was overwritten."""
        one, other = self._places.claimed(0), self._places.claimed(1)
        number = one if one > other else other
        content = self._places.read(number) if number else None
        return self._places.newest() if content is None else (number, content)

    def take(self) -> bytes | None:
        """Return the newest content once; None without a new one."""
        if self._places.claimed(0) <= self._taken and self._places.claimed(1) <= self._taken:
            return None
        number, content = self.read()
        if number <= self._taken:
            return None
        self._taken = number
        return content
