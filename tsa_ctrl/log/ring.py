"""Pass records and notes (texts of events) from the real-time process to readers through a ring in shared memory.

The ring has one writer and any number of readers, and uses no locks or system calls. Each record and each note has its
own place (see `system.shared_memory`). A reader takes complete contents in the order of their numbers. Records that
were overwritten before they were read count as lost.
"""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.signals import FIELDS
from tsa_ctrl.system.shared_memory import Places, SharedMemory, space

SLOTS = 8192  # records per axis: 8 s at 1 kHz, to bridge a slow disk
NOTE_BYTES = 1022  # bytes of one note

_MAGIC = 0x74736172696E6732  # "tsaring2"
_HEADER = 4096  # bytes
_FORMAT = struct.Struct(f"={len(FIELDS)}d")
_NOTES = 64  # notes that may wait; a further one overwrites the oldest


class _Word(IntEnum):
    """The words of the header, 8 bytes each."""

    MAGIC = 0
    AXES = 1
    SLOTS = 2
    FIELDS = 3
    CLOSED = 4  # set by the owner after the last record
    NOTES = 5  # set by the owner: number of written notes
    WRITER_STATE = 8  # set by the log writer, like the words up to REPLACED
    WRITTEN = 9
    LOST = 10
    TROUBLE = 11  # errno of a failed write, 0 without one
    HEARD = 12  # ns, monotonic, time of the writer's last sign of life
    REPLACED = 13  # number of replaced writers
    COUNT = 64  # first of one word per axis: number of records in the ring so far
    STORED = 288  # first of one word per axis: number of the last record that the log writer has stored


MAX_AXES = _HEADER // 8 - _Word.STORED


class WriterState(IntEnum):
    """The state that the log writer reports through the ring."""

    STARTING = 0
    WRITING = 1
    TROUBLED = 2  # cannot write, but drains the ring, counts lost records and tries again
    ENDED = 3


class Ring:
    """The mapped memory of a ring, the base of `RingWriter` and `RingReader`."""

    def __init__(self, axes: int, slots: int, fd: int | None = None) -> None:
        records, notes = space(slots, _FORMAT.size), space(_NOTES, NOTE_BYTES)
        self._memory = SharedMemory(_HEADER + axes * records + notes, fd)
        self.fd = self._memory.descriptor
        self.axes = axes
        self.slots = slots
        self._words = self._memory.words
        self._places = [Places(self._memory, _HEADER + n * records, slots, _FORMAT.size) for n in range(axes)]
        self._notes = Places(self._memory, _HEADER + axes * records, _NOTES, NOTE_BYTES)

    def close(self) -> None:
        """Unmap the memory, which is released with its last user."""
        self._memory.close()

    @property
    def heard(self) -> float:
        """Return the time of the log writer's last sign of life, s (monotonic), or 0 before the first one."""
        return self._words[_Word.HEARD] * 1e-9

    @property
    def replaced(self) -> int:
        """Return the number of log writers that were replaced."""
        return self._words[_Word.REPLACED]

    def word(self, word: _Word) -> int:
        return self._words[word]


class RingWriter(Ring):
    """The writer's side of the ring, in the real-time process. `fd` must be passed to the readers."""

    def __init__(self, axes: int, slots: int = SLOTS) -> None:
        """Create the memory for `axes` axes. Raise ValueError for sizes out of range."""
        if not 0 < axes <= MAX_AXES or slots < 2:
            raise ValueError(f"{axes} axes with {slots} slots; allowed are 1 to {MAX_AXES} axes and at least 2 slots")
        super().__init__(axes, slots)
        self._counts = [0] * axes
        for word, value in ((_Word.AXES, axes), (_Word.SLOTS, slots), (_Word.FIELDS, len(FIELDS))):
            self._words[word] = value
        self._words[_Word.MAGIC] = _MAGIC

    def push(self, axis: int, record: Sequence[float]) -> None:
        """Store a record with one value for each of `FIELDS`. The call never blocks and may overwrite the oldest."""
        self._counts[axis] = count = self._counts[axis] + 1
        self._places[axis].write(count, _FORMAT.pack(*record))
        self._words[_Word.COUNT + axis] = count

    def note(self, text: bytes) -> None:
        """Store a note, cut to NOTE_BYTES. The call never blocks and may overwrite the oldest note."""
        count = self._words[_Word.NOTES] + 1
        self._notes.write(count, text[:NOTE_BYTES])
        self._words[_Word.NOTES] = count

    def finish(self) -> None:
        """Report the end of the records, so that the log writer drains the ring, completes the file and ends."""
        self._words[_Word.CLOSED] = 1


class RingReader(Ring):
    """A reader of the ring with its own position."""

    def __init__(self, fd: int) -> None:
        """Map the ring of a descriptor, and start after the last stored record.

        Raises:
            ValueError: The descriptor is not a ring of this version.
        """
        magic, axes, slots, fields = struct.unpack("=4Q", os.pread(fd, 32, 0).ljust(32, b"\0"))
        if magic != _MAGIC or fields != len(FIELDS):
            raise ValueError("not a ring of this version")
        super().__init__(axes, slots, os.dup(fd))
        stored = [self._words[_Word.STORED + axis] for axis in range(self.axes)]
        self._next = [number + 1 for number in stored]
        self._next_note = 1
        self.written = self.word(_Word.WRITTEN)  # records written by earlier writers
        self.lost = sum(stored) - self.written

    def read(self, axis: int) -> NDArray[np.float64]:
        """Return the records of one axis since the last call, oldest first, (k, fields)."""
        first = self._next[axis]
        found, self._next[axis] = _taken(self._places[axis], first, self._words[_Word.COUNT + axis])
        self.lost += self._next[axis] - first - len(found)
        return np.frombuffer(b"".join(found)).reshape(-1, len(FIELDS))

    def notes(self) -> list[bytes]:
        """Return the notes since the last call, oldest first, without overwritten ones."""
        found, self._next_note = _taken(self._notes, self._next_note, self.word(_Word.NOTES))
        return found

    @property
    def finished(self) -> bool:
        """Return True once the owner has reported the end of the records."""
        return bool(self._words[_Word.CLOSED])

    def alive(self) -> None:
        """Record a sign of life."""
        self._words[_Word.HEARD] = time.monotonic_ns()

    def replace(self, number: int) -> None:
        """Record that `number` writers were replaced."""
        self._words[_Word.REPLACED] = number

    def stored(self) -> None:
        """Record that all read records are stored, so that a replacement of this reader starts after them."""
        for axis, following in enumerate(self._next):
            self._words[_Word.STORED + axis] = following - 1

    def report(self, state: WriterState, written: int, lost: int, trouble: int) -> None:
        """Report state, written and lost records, and the errno of a failed write (0 without one) to the owner."""
        self.alive()
        self._words[_Word.WRITTEN] = written
        self._words[_Word.LOST] = lost
        self._words[_Word.TROUBLE] = trouble
        self._words[_Word.WRITER_STATE] = state


def _taken(places: Places, first: int, last: int) -> tuple[list[bytes], int]:
    """Return the complete contents with the numbers `first` to `last`, and the number to continue with."""
    found = []
    for number in range(max(first, last + 1 - places.count), last + 1):
        content = places.read(number)
        if content is not None:
            found.append(content)
        elif places.claimed(number) <= number:  # not yet complete, because no later content has taken its place
            return found, number
    return found, last + 1


class LogHealth:
    """The last report of the log writer, for the status and the summary."""

    def __init__(self, ring: Ring) -> None:
        self.state = WriterState(ring.word(_Word.WRITER_STATE))
        self.written = ring.word(_Word.WRITTEN)
        self.lost = ring.word(_Word.LOST)
        trouble = ring.word(_Word.TROUBLE)
        self.trouble = os.strerror(trouble) if trouble else ""
