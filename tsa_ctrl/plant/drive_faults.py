"""Misbehaviour of a simulated drive that can be switched on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from tsa_ctrl.plant.dictionary import Key


@dataclass(slots=True)
class DriveFaults:
    """Misbehaviour of the drive itself that can be switched on."""

    ignore_command: bool = False  # bit 12 low, the target torque is not followed
    wrong_mode: int | None = None  # value of 0x6061
    torque_sign: int = 1  # -1: motor wired the wrong way round
    torque_gain: float = 1.0  # motor torque over the torque that the drive assumes
    clock_drift: float | None = None  # relative; the drive samples by its internal clock, not at the SYNC
    most_torque: float | None = None  # of rated torque, limit of an overheated drive: bit 11
    dead_stage: bool = False  # the power stage has no voltage: no torque, bit 4 low, the state machine goes on
    torque_off: bool = False  # the input of safe torque off is open
    turned: int = 1  # -1: position and velocity count the other way
    inputs: int = 0  # 0x60FD
    distortions: dict[Key, Callable[[int], int]] = field(default_factory=dict)  # of the reported values
