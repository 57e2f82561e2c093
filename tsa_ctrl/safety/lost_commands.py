"""Count the commands that a drive misses. With many of them within a second, its torque is several cycles old."""

from __future__ import annotations

from tsa_ctrl.bus.live.read_back import CommandReadback
from tsa_ctrl.safety.causes import Cause, Finding
from tsa_ctrl.safety.debounce import Often


class LostCommands:
    """Check the drive of one axis. Call `update` while torque is permitted, and `reset` while it is not."""

    def __init__(self, readback: CommandReadback, name: str) -> None:
        """Prepare the check.

        Args:
            readback: commands that the drive was read back to hold.
            name: the drive's name in messages.
        """
        self._readback = readback
        self._name = name
        self.reset()

    def reset(self) -> None:
        """Start a new count, because torque is not permitted."""
        self._seen = self._readback.outdated
        self._begin()

    def _begin(self) -> None:
        self._most = self._readback.too_many
        self._often = Often(self._most)

    def update(self, now: float) -> Finding | None:
        """Return a finding once the drive has missed too many commands within a second; `now` is in s."""
        readback = self._readback
        if readback.outdated == self._seen:
            return None
        self._seen = readback.outdated
        if readback.too_many != self._most:  # the drive was configured in the meantime
            self._begin()
        if not self._often.happened(now):
            return None
        return Finding(
            Cause.COMMANDS_MISSED,
            f"{self._name} held an older command {readback.outdated} of {readback.asked} times that 0x6071 was "
            f"read back, {readback.too_many} within a second",
        )
