"""The record of one cycle of one axis, and the shared-memory ring that carries it out of the real-time process.

Beside the records the ring carries notes: texts of what happened, rare and short.

One writer, any number of readers, no locks and no system calls: the writer stores a record and then advances the axis'
count; a reader copies records and afterwards drops those that the writer may have reached meanwhile. The memory has no
name (a descriptor is handed to child processes instead), so that nothing is left behind however a process ends.
"""

from __future__ import annotations

import mmap
import os
import struct
import tempfile
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.log.columns import CYCLE, SIGNALS, Column

FIELDS: tuple[Column, ...] = SIGNALS + CYCLE
"""One record, in this order, all float64; nan is a value that is not there."""

FIELD_NAMES: tuple[str, ...] = tuple(field.name for field in FIELDS)
SLOTS = 8192  # records per axis: 8 s at 1 kHz, for a disk that hangs

_MAGIC = 0x74736172696E6731  # "tsaring1"
_HEADER = 4096  # bytes; keeps the records of axis 0 on a page of their own
_RECORD = 8 * len(FIELDS)
_NOTES = 64  # notes that may wait; the oldest is overwritten
_NOTE = 1024  # bytes of one, its length in the first two
NOTE_BYTES = _NOTE - 2


class _Word(IntEnum):
    """What stands where in the header, 8 bytes each."""

    MAGIC = 0
    AXES = 1
    SLOTS = 2
    FIELDS = 3
    CLOSED = 4  # by the owner: no more records
    NOTES = 5  # by the owner: notes written
    WRITER_STATE = 8  # by the log writer, as the words that follow
    WRITTEN = 9
    LOST = 10
    TROUBLE = 11  # errno of what kept the writer from writing, 0: none
    BYTES = 12
    COUNT = 64  # of axis 0; one word per axis from here


MAX_AXES = _HEADER // 8 - _Word.COUNT


class WriterState(IntEnum):
    """What the log writer says of itself through the ring."""

    STARTING = 0
    WRITING = 1
    TROUBLED = 2  # cannot write; drains the ring, counts what is lost and tries again
    ENDED = 3


class Ring:
    """The mapping itself; use `RingWriter` and `RingReader`."""

    def __init__(self, fd: int, axes: int, slots: int) -> None:
        self.fd = fd
        self.axes = axes
        self.slots = slots
        self._map = mmap.mmap(fd, size_of(axes, slots))
        self._notes_at = size_of(axes, slots) - _NOTES * _NOTE
        self._words = memoryview(self._map).cast("Q")

    def close(self) -> None:
        """Give the mapping back; the memory goes when the last process has."""
        self._words.release()
        try:
            self._map.close()
        except BufferError:  # an array over it is still held somewhere; it goes with that
            return

    def word(self, word: _Word) -> int:
        return self._words[word]


def size_of(axes: int, slots: int) -> int:
    """Bytes of a ring."""
    return _HEADER + axes * slots * _RECORD + _NOTES * _NOTE


class RingWriter(Ring):
    """The real-time side. `fd` goes to the readers (`subprocess.Popen(pass_fds=[ring.fd])`)."""

    def __init__(self, axes: int, slots: int = SLOTS) -> None:
        """Memory for `axes` axes, touched once so that no page fault comes later; `slots` is a power of two."""
        if not 0 < axes <= MAX_AXES or slots < 2 or slots & (slots - 1):
            raise ValueError(f"{axes} axes of {slots} slots: need 1 to {MAX_AXES} axes and a power of two of slots")
        fd = _anonymous_file()
        os.ftruncate(fd, size_of(axes, slots))
        super().__init__(fd, axes, slots)
        self._map[:] = bytes(len(self._map))
        self._mask = slots - 1
        self._base = [_HEADER + axis * slots * _RECORD for axis in range(axes)]
        self._counts = [0] * axes
        self._pack = struct.Struct(f"={len(FIELDS)}d").pack_into
        for word, value in ((_Word.AXES, axes), (_Word.SLOTS, slots), (_Word.FIELDS, len(FIELDS))):
            self._words[word] = value
        self._words[_Word.MAGIC] = _MAGIC

    def push(self, axis: int, values: tuple[float, ...]) -> None:
        """Store one record: the values of FIELDS in order. Never blocks; the oldest record is overwritten."""
        count = self._counts[axis]
        self._pack(self._map, self._base[axis] + (count & self._mask) * _RECORD, *values)
        self._counts[axis] = count = count + 1
        self._words[_Word.COUNT + axis] = count

    def note(self, text: bytes) -> None:
        """Store one note, cut to NOTE_BYTES. Never blocks; the oldest note is overwritten."""
        count = self._words[_Word.NOTES]
        at = self._notes_at + count % _NOTES * _NOTE
        text = text[:NOTE_BYTES]
        self._map[at : at + 2 + len(text)] = len(text).to_bytes(2, "little") + text
        self._words[_Word.NOTES] = count + 1

    def finish(self) -> None:
        """Say that no more records come: the log writer drains the ring, completes the file and ends."""
        self._words[_Word.CLOSED] = 1

    def close(self) -> None:
        super().close()
        os.close(self.fd)


class RingReader(Ring):
    """A reader with a position of its own; reads what is there from now on (or all that is kept, `from_start`)."""

    def __init__(self, fd: int, from_start: bool = True) -> None:
        """Map the ring behind a descriptor; raises ValueError when it is none."""
        with mmap.mmap(fd, _HEADER, access=mmap.ACCESS_READ) as header:
            magic, axes, slots, fields = struct.unpack_from("=4Q", header)
        if magic != _MAGIC or fields != len(FIELDS):
            raise ValueError("not a ring of this version")
        super().__init__(fd, axes, slots)
        self._records: NDArray[np.float64] = np.frombuffer(
            self._map, dtype=np.float64, count=axes * slots * len(FIELDS), offset=_HEADER
        ).reshape(axes, slots, len(FIELDS))
        self._next = [0 if from_start else self._count(axis) for axis in range(axes)]
        self._next_note = 0 if from_start else self.word(_Word.NOTES)
        self.lost = 0

    def _count(self, axis: int) -> int:
        return self._words[_Word.COUNT + axis]

    def read(self, axis: int) -> NDArray[np.float64]:
        """Records of one axis since the last call, oldest first, shape (k, fields); overwritten ones count as lost."""
        count = self._count(axis)
        start = max(self._next[axis], count - self.slots)
        records: NDArray[np.float64] = self._records[axis, np.arange(start, count) % self.slots]
        torn = max(0, self._count(axis) + 1 - self.slots - start)  # the slot being written now is not to be trusted
        torn = min(torn, count - start)
        self.lost += start - self._next[axis] + torn
        self._next[axis] = count
        return records[torn:]

    def notes(self) -> list[bytes]:
        """Notes since the last call, oldest first; overwritten ones are left out."""
        count = self.word(_Word.NOTES)
        found = []
        for number in range(max(self._next_note, count - _NOTES), count):
            at = self._notes_at + number % _NOTES * _NOTE
            length = int.from_bytes(self._map[at : at + 2], "little")
            found.append(self._map[at + 2 : at + 2 + min(length, NOTE_BYTES)])
        written = self.word(_Word.NOTES) - count
        self._next_note = count
        return found[written:] if written and len(found) == _NOTES else found

    def latest(self, axis: int) -> dict[str, float] | None:
        """The newest record of an axis by field name; None before the first."""
        while True:
            count = self._count(axis)
            if count == 0:
                return None
            values = self._records[axis, (count - 1) % self.slots].tolist()
            if self._count(axis) < count + self.slots - 1:
                return dict(zip(FIELD_NAMES, values, strict=True))

    @property
    def finished(self) -> bool:
        """True once the owner has said that no more records come."""
        return bool(self._words[_Word.CLOSED])

    def report(self, state: WriterState, written: int, lost: int, trouble: int, size: int) -> None:
        """Leave word for the owner: records written and lost, errno of a trouble (0: none), bytes of the file."""
        self._words[_Word.WRITTEN] = written
        self._words[_Word.LOST] = lost
        self._words[_Word.TROUBLE] = trouble
        self._words[_Word.BYTES] = size
        self._words[_Word.WRITER_STATE] = state

    def close(self) -> None:
        del self._records
        super().close()


class LogHealth:
    """What the log writer last said through a ring: for status pages and the summary at exit."""

    def __init__(self, ring: Ring) -> None:
        self.state = WriterState(ring.word(_Word.WRITER_STATE))
        self.written = ring.word(_Word.WRITTEN)
        self.lost = ring.word(_Word.LOST)
        self.bytes = ring.word(_Word.BYTES)
        trouble = ring.word(_Word.TROUBLE)
        self.trouble = os.strerror(trouble) if trouble else ""

    def __repr__(self) -> str:
        return f"LogHealth({self.state.name}, written={self.written}, lost={self.lost}, trouble={self.trouble!r})"

    def as_dict(self) -> dict[str, Any]:
        """For a status page, JSON-ready."""
        return {
            "state": self.state.name.lower(),
            "written": self.written,
            "lost": self.lost,
            "bytes": self.bytes,
            "trouble": self.trouble or None,
        }


def _anonymous_file() -> int:
    """A descriptor of memory that has no name."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("tsa-ring", os.MFD_CLOEXEC)
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())
