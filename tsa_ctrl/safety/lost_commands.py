"""Count commands that a drive does not receive: with many of them in a second, its torque is some cycles old."""

from __future__ import annotations

from tsa_ctrl.bus.live.read_back import Hearing
from tsa_ctrl.safety.causes import Cause, Finding
from tsa_ctrl.safety.debounce import Often


class LostCommands:
    """One axis' check; `update` while torque is permitted, `reset` when it is not."""

    def __init__(self, hearing: Hearing, name: str) -> None:
        """`name` of the drive, for people."""
        self._hearing = hearing
        self._name = name
        self.reset()

    def reset(self) -> None:
        """Start a new count for the next enable, because torque is no longer permitted."""
        self._seen = self._hearing.unheard
        self._begin()

    def _begin(self) -> None:
        self._most = self._hearing.too_many
        self._often = Often(self._most)

    def update(self, now: float) -> Finding | None:
        """Return a finding once too many commands were missed within a second; `now` in s."""
        hearing = self._hearing
        if hearing.unheard == self._seen:
            return None
        self._seen = hearing.unheard
        if hearing.too_many != self._most:  # configured since
            self._begin()
        if not self._often.happened(now):
            return None
        return Finding(
            Cause.COMMANDS_MISSED,
            f"{self._name} held an older command {hearing.unheard} of {hearing.asked} times that 0x6071 was read back, "
            f"{hearing.too_many} within a second",
        )
