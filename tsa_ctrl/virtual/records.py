"""The daemon's records of a simulated run: in memory, and as the log file that a real run writes."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.header import LogHeader
from tsa_ctrl.log.record import FIELD_NAMES
from tsa_ctrl.log.ring import LogHealth, RingReader, RingWriter
from tsa_ctrl.log.writer import LogWriter
from tsa_ctrl.outputs import move_into

EVERY = 0.5  # s between two looks at the ring, which holds 2 s at the highest rate
FILE = "tsa.mcap"


class Records:
    """The reading side of the loop's ring; `ring` is the loop's."""

    def __init__(self, axes: int, folder: Path | None, header: LogHeader) -> None:
        """`folder`: where the log file goes, if anywhere. Raises UsageError when it cannot be there."""
        self.ring = RingWriter(axes)
        self.path: Path | None = None
        self._reader = RingReader(self.ring.fd)
        self._blocks: list[list[NDArray[np.float64]]] = [[] for _ in range(axes)]
        self._writer: LogWriter | None = None
        if folder is not None:
            self.path, self._beside = folder / FILE, folder / f".{FILE}.part"
            try:
                folder.mkdir(parents=True, exist_ok=True)
                self._beside.unlink(missing_ok=True)
                self._beside.touch()
                self._beside.unlink()
            except OSError as error:
                raise UsageError(f"{folder}: cannot be written ({error.strerror}); choose another --out") from None
            # Without a date of its own: the same run gives the same bytes.
            self._writer = LogWriter(RingReader(self.ring.fd), self._beside, replace(header, started=0.0))

    def drain(self, now: float) -> None:
        """Take what the loop has written, at `now` s of the simulated time."""
        for axis, blocks in enumerate(self._blocks):
            blocks.append(self._reader.read(axis))
        if self._writer is not None:
            self._writer.step(now)

    def end(self, now: float) -> None:
        """The loop is over: complete the file and give it its name. Raises UsageError when it cannot be written."""
        self.drain(now)
        if self._writer is None or self.path is None:
            return
        self._writer.end()
        health = LogHealth(self.ring)
        try:
            if health.trouble:
                raise OSError(0, health.trouble)
            move_into(self._beside, self.path)
        except OSError as error:
            raise UsageError(f"{self.path}: cannot be written ({error.strerror}); choose another --out") from None

    @property
    def written(self) -> int:
        """Records in the file."""
        return LogHealth(self.ring).written

    def columns(self, axis: int) -> dict[str, NDArray[np.float64]]:
        """The log of one axis by column name, each (n,); nan where there is no value."""
        table = np.concatenate(self._blocks[axis])
        return {name: table[:, i].copy() for i, name in enumerate(FIELD_NAMES)}

    def close(self) -> None:
        """Give the memory back, and leave no file behind that was not ended."""
        if self.path is not None:
            with contextlib.suppress(OSError):
                self._beside.unlink(missing_ok=True)
        self._reader.close()
        self.ring.close()
