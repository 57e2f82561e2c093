"""What the loop as a whole does now."""

from __future__ import annotations

from enum import Enum


class LoopPhase(Enum):
    """Values are the codes of the status."""

    STARTING = 0  # children run, the bus is brought up
    SETTLING = 1  # cycles run with torque 0 until all answers come
    RUNNING = 2
    FAULTED = 3  # latched; torque 0 until somebody asks for a recovery or a stop
    STOPPING = 4  # the torque ramps to 0, the drives are disabled
    RESETTING = 5  # a recovery was asked for
    ENDED = 6

    @property
    def up(self) -> bool:
        """The start is over: with torque, or with a fault that is latched."""
        return self in (LoopPhase.RUNNING, LoopPhase.FAULTED)

    @property
    def ending(self) -> bool:
        """A run may end without a ramp."""
        return self in (LoopPhase.STOPPING, LoopPhase.ENDED)
