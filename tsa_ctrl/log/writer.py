"""Write records from the ring to the file: `python -m tsa_ctrl.log.writer FD PATH`, with the header on stdin.

The process drains the ring, and ends when its owner closes stdin or dies. If the disk is full or missing, the process
reports this through the ring, counts lost records and tries again. The real-time process never waits for it. A writer
that hangs or dies is replaced by another one, which writes the remaining records of the ring to a new file
(`system.process_supervisor`).
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import signal
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.log.mcap_file import McapFile, Note
from tsa_ctrl.log.process import LOG_KIND, LOG_SUFFIX, LogHeader, LogLimits
from tsa_ctrl.log.ring import RingReader, WriterState
from tsa_ctrl.signals import FIELDS
from tsa_ctrl.system.process_supervisor import ignore, supervise

POLL = 0.05  # s between two reads of the ring
CHUNK = 0.5  # s of records in one chunk, which a killed writer loses
SYNCED = 1.0  # s between two fsync calls: a power failure loses the records since the last call
RETRY = 1.0  # s between attempts after a failed write
HANGS = 4.0  # s without a sign of life until another writer takes over: half of the ring's content at 1 kHz
DEAD = "the loop's process ended without reporting a cause (killed?); only the drives' own watchdogs are active"
IN_USE = 10.0  # s after its last change during which a log may belong to another daemon and is not deleted
MOST_NOTES = 1000  # notes kept while writing fails
MOST_PENDING = 120_000  # records kept while writing fails, about 25 MB; older records are lost

Blocks = list[NDArray[np.float64]]


class LogWriter:
    """Write one ring to one or several consecutive files. `step` reads the ring once and does not sleep.

    The files are `first`, then NAME-2.mcap, NAME-3.mcap and so on. An existing file is never continued.
    """

    def __init__(self, ring: RingReader, first: Path, header: LogHeader, limits: LogLimits | None = None) -> None:
        self._ring = ring
        self._first = first
        self._path = next_file(first) if first.exists() else first
        self._header = header
        self._limits = limits or LogLimits()
        self._begun = 0.0  # s, start of the file
        self._file: McapFile | None = None
        self._pending: list[Blocks] = [[] for _ in header.axes]
        self._notes: list[Note] = []
        self._waiting = 0
        self._newest = 0.0  # s, log time of the newest record
        self._written = ring.written  # records in earlier files
        self._dropped = 0
        self._trouble = 0
        self._due = 0.0
        self._syncing: Future[None] = Future()  # in a thread: a memory card may take seconds, but the ring holds 8 s
        self._syncing.set_result(None)
        self._sync_due = 0.0
        self._disk = ThreadPoolExecutor(1)

    def step(self, now: float, last: bool = False) -> None:
        """Read the ring, and write a chunk if it is due or `last` is True. `now` is in s on any clock."""
        for axis, pending in enumerate(self._pending):
            block = self._ring.read(axis)
            if len(block):
                pending.append(block)
                self._waiting += len(block)
                self._newest = float(block[-1, 0])
        self._notes += [note for data in self._ring.notes() if (note := Note.decoded(data)) is not None]
        del self._notes[:-MOST_NOTES]
        if now >= self._due or last:
            self._write(now)
            if self._file is not None and not (last or self._trouble):
                self._rotate(self._file, now)
            self._due = now + (RETRY if self._trouble else CHUNK)
        while self._waiting > MOST_PENDING:
            self._drop_oldest()
        self._report(WriterState.TROUBLED if self._trouble else WriterState.WRITING)

    def end(self, orphaned: bool = False) -> None:
        """Write the rest and complete the file. Add a fault note if the loop's process died (`orphaned`)."""
        self.step(0.0, last=True)
        if orphaned:
            self._notes.append(Note(self._newest, "", DEAD, fault=True))
            self._write(0.0)
        ending = [self._syncing]
        if self._file is not None:  # after a sync in progress, which needs the open file
            ending.append(self._disk.submit(self._file.finish))
        for each in ending:
            try:
                each.result()
            except OSError as error:
                self._trouble = error.errno or errno.EIO
        self._disk.shutdown(wait=False)
        self._dropped += self._waiting
        self._report(WriterState.ENDED)

    def _write(self, now: float) -> None:
        try:
            if self._file is None:
                self._file = McapFile(self._path, self._header)
                self._begun = now
                self._tidy()
            if self._waiting:
                self._file.write([_joined(blocks) for blocks in self._pending])
                self._forget()
            self._file.write_notes(self._notes)
            self._notes.clear()
            self._sync(self._file, now)
        except OSError as error:
            self._trouble = error.errno or errno.EIO
            return
        self._trouble = 0

    def _rotate(self, file: McapFile, now: float) -> None:
        """End the file once it is too large or too old. The next write starts another file."""
        limits = self._limits
        large = limits.file_size is not None and file.size >= limits.file_size
        if not (large or (limits.file_age is not None and now - self._begun >= limits.file_age)):
            return
        following = next_file(self._first)
        try:
            file.write_notes([Note(self._newest, "", f"the log continues in {following.name}", False)])
        except OSError as error:
            self._trouble = error.errno or errno.EIO
            return
        self._notes.append(Note(self._newest, "", f"this log continues {self._path.name}", False))
        self._written += file.written
        self._file, self._path = None, following
        self._syncing = self._disk.submit(file.finish)  # runs after a sync that is still in progress

    def _tidy(self) -> None:
        """Delete the oldest logs of the daemon in the folder while all of them exceed `folder_size`."""
        if self._limits.folder_size is None:
            return
        logs = []
        for path in self._path.parent.glob(f"{LOG_KIND}-*{LOG_SUFFIX}"):
            with contextlib.suppress(OSError):  # another daemon has just deleted it, for example
                status = path.lstat()
                if not path.is_symlink():  # to delete a link frees nothing
                    logs.append((status.st_mtime, status.st_size, path))
        excess = sum(size for _, size, _ in logs) - self._limits.folder_size
        newest = time.time() - IN_USE
        for changed, size, path in sorted(logs):
            if excess <= 0.0:
                break
            if path == self._path or changed > newest:
                continue
            try:
                path.unlink(missing_ok=True)
                excess -= size
                text = f"deleted the oldest log {path.name}"
            except OSError as error:  # of another user, for example; no reason to stop writing
                text = f"the oldest log {path.name} cannot be deleted ({error.strerror})"
            self._notes.append(Note(self._newest, "", f"{text}: the logs exceed [log] folder_size", False))

    def _sync(self, file: McapFile, now: float) -> None:
        """Start an fsync once a second, and raise the OSError of the previous one."""
        if self._syncing.done() and now >= self._sync_due:
            self._sync_due = now + SYNCED
            before, self._syncing = self._syncing, self._disk.submit(file.sync)
            before.result()

    def _forget(self) -> None:
        self._ring.stored()
        self._waiting = 0
        for blocks in self._pending:
            blocks.clear()

    def _drop_oldest(self) -> None:
        blocks = max(self._pending, key=lambda pending: sum(len(block) for block in pending))
        dropped = len(blocks.pop(0))
        self._waiting -= dropped
        self._dropped += dropped

    def _report(self, state: WriterState) -> None:
        file = self._file
        self._ring.report(
            state,
            written=self._written + (file.written if file else 0),
            lost=self._ring.lost + self._dropped,
            trouble=self._trouble,
        )


def _joined(blocks: Blocks) -> NDArray[np.float64]:
    return np.concatenate(blocks) if blocks else np.empty((0, len(FIELDS)))


def main(argv: list[str]) -> int:
    """Run until the owner finishes the ring or dies."""
    ignore(signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # only the owner ends this process
    fd, path = int(argv[0]), Path(argv[1])
    asked = sys.stdin.buffer.readline()
    if not asked:  # the owner has already ended
        return 0
    header, limits = msgspec.json.decode(asked, type=tuple[LogHeader, LogLimits])
    ring = RingReader(fd)

    def work(_before: int) -> int:
        return write(RingReader(fd), path, header, limits)

    return supervise(work, ring.alive, lambda: ring.heard, HANGS, ring.replace)


def write(ring: RingReader, path: Path, header: LogHeader, limits: LogLimits) -> int:
    """Write the log until the owner finishes the ring or ends."""
    writer = LogWriter(ring, path, header, limits)
    orphaned = False
    while not (ring.finished or orphaned):
        writer.step(time.monotonic())
        readable, _, _ = select.select([sys.stdin], [], [], POLL)
        orphaned = bool(readable and not os.read(sys.stdin.fileno(), 4096))
    writer.end(orphaned and not ring.finished)
    return 0


def next_file(path: Path) -> Path:
    """Return the first free path among NAME-2.mcap, NAME-3.mcap, ..., in which the log NAME.mcap continues."""
    number = 2
    while (found := path.with_name(f"{path.stem}-{number}{path.suffix}")).exists():
        number += 1
    return found


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
