"""The plant's own record of the truth: one CSV row per axis and period, written while it runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, TextIO

from tsa_ctrl.errors import UsageError

COLUMNS: tuple[tuple[str, str], ...] = (
    ("clock", "s, CLOCK_MONOTONIC"),
    ("t", "s since the plant's start"),
    ("axis", "place of the axis, 0 ..."),
    ("faults", "injected faults that are on"),
    ("state", "CiA 402 state, bits of the statusword"),
    ("enabled", "power stage on"),
    ("command", "N*m at the motor pulley, after the drive's clamp"),
    ("torque_loop", "N*m, what the drive's current says"),
    ("tau_m", "N*m that acts on the motor pulley"),
    ("q_m", "rad"),
    ("omega_m", "rad/s"),
    ("q_j", "rad"),
    ("omega_j", "rad/s"),
    ("t1", "N"),
    ("t2", "N"),
    ("t3", "N"),
    ("t4", "N"),
    ("tau_j", "N*m delivered to the load"),
    ("z", "state of the friction, -1 to 1"),
    ("theta", "rad"),
    ("pretension", "N, T_p0"),
    ("temperature", "deg C"),
    ("tau_outside", "N*m on the joint by a hand or a push"),
)
_FLUSH = 0.25  # s


class Record(Protocol):
    """Where a machine leaves its truth: on disk, or in memory."""

    def due(self, t: float) -> bool: ...
    def row(self, values: Sequence[float]) -> None: ...
    def flush(self, clock: float) -> None: ...


class Recorder:
    """Appends rows; what is older than a quarter of a second is in the file even when the process is killed."""

    def __init__(self, path: str | Path, period: float) -> None:
        self.period = period
        self._due = -1.0
        self._flush_due = 0.0
        try:
            self._file: TextIO = Path(path).open("w", encoding="ascii", buffering=1 << 20)  # noqa: SIM115
        except OSError as error:
            raise UsageError(f"{path}: cannot be written ({error.strerror}); choose another place") from None
        self._file.write(",".join(name for name, _ in COLUMNS) + "\n")
        self._format = ",".join(["%.6f", "%.6f", "%d", "%d", "%d", "%d"] + ["%.9g"] * (len(COLUMNS) - 6)) + "\n"

    def due(self, t: float) -> bool:
        """Whether a period has passed at plant time t; a late one is not made up for."""
        if t < self._due:
            return False
        self._due = max(self._due + self.period, t + 0.5 * self.period)
        return True

    def row(self, values: Sequence[float]) -> None:
        self._file.write(self._format % tuple(values))

    def flush(self, clock: float) -> None:
        if clock >= self._flush_due:
            self._flush_due = clock + _FLUSH
            self._file.flush()

    def close(self) -> None:
        self._file.close()
