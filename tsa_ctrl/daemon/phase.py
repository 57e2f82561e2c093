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
