"""The plant's own record of the truth, kept in memory: the columns of `tsa plant --record`."""

from __future__ import annotations

import contextlib
from array import array
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.outputs import move_into
from tsa_ctrl.plant.record import COLUMNS, Recorder

NAMES = tuple(name for name, _ in COLUMNS)
_PLACE = NAMES.index("axis")


class Truth:
    """Takes the rows of a machine, one per axis and period, and writes them to a file besides when there is one."""

    def __init__(self, axes: int, period: float, path: Path | None = None) -> None:
        """`period`: s between two rows. Raises UsageError when `path` cannot be written."""
        self.period = period
        self._path = path
        self._beside = None if path is None else path.with_name(f".{path.name}.part")
        self._due = -1.0
        self._rows = [array("d") for _ in range(axes)]
        self._file = None if self._beside is None else Recorder(self._beside, period)

    def due(self, t: float) -> bool:
        """Whether a period has passed at plant time t; a late one is not made up for."""
        if t < self._due:
            return False
        self._due = max(self._due + self.period, t + 0.5 * self.period)
        return True

    def row(self, values: Sequence[float]) -> None:
        self._rows[int(values[_PLACE])].extend(values)
        if self._file is not None:
            self._file.row(values)

    def flush(self, clock: float) -> None:
        """Nothing is lost in memory."""

    def finish(self) -> None:
        """Give the file its name; raises UsageError."""
        if self._file is None or self._beside is None or self._path is None:
            return
        try:
            self._file.close()
            move_into(self._beside, self._path)
        except OSError as error:
            raise UsageError(f"{self._path}: cannot be written ({error.strerror}); choose another --record") from None

    def close(self) -> None:
        """Leave nothing behind that was not finished; may be called twice."""
        if self._file is not None and self._beside is not None:
            with contextlib.suppress(OSError):
                self._file.close()
                self._beside.unlink(missing_ok=True)

    def columns(self, place: int) -> dict[str, NDArray[np.float64]]:
        """The truth of one axis by column name, each (n,)."""
        table = np.frombuffer(self._rows[place], dtype=np.float64).reshape(-1, len(NAMES))
        return {name: table[:, i].copy() for i, name in enumerate(NAMES)}
