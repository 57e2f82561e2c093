"""How much a compressed log may unpack to: a small file must not fill the memory of who looks into it."""

from __future__ import annotations

from gzip import GzipFile
from pathlib import Path

from tsa_ctrl.errors import UsageError

ALWAYS = 256 << 20  # bytes that any file may unpack to: half an hour of one axis at 1 kHz as CSV
RATIO = 200  # of the file's size, beyond that: logs of a rig that stands still reach 60, of one that moves 2 to 10


class Unpacked:
    """Counts what a file gives."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.left = max(ALWAYS, RATIO * path.stat().st_size)

    def take(self, size: int) -> None:
        """Count `size` bytes; raises UsageError when that is more than a log can hold."""
        self.left -= size
        if self.left < 0:
            limit = max(ALWAYS, RATIO * self._path.stat().st_size)
            raise UsageError(
                f"{self._path}: unpacks to more than {limit >> 20} MiB from {self._path.stat().st_size >> 10} KiB, "
                "which no log does; unpack it yourself if you trust it"
            )


class CountedStream:
    """A stream whose bytes are counted as they are read."""

    def __init__(self, stream: GzipFile, counted: Unpacked) -> None:
        self._stream = stream
        self._counted = counted
        self.closed = False

    def read(self, size: int = -1) -> bytes:
        """As of any stream, but never more than what is left; raises UsageError beyond."""
        most = self._counted.left + 1
        data = self._stream.read(most if size < 0 else min(size, most))
        self._counted.take(len(data))
        return data

    def close(self) -> None:
        """Who opened the stream closes it."""
