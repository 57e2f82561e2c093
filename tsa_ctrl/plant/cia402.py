"""Define the CiA 402 power state machine by a table: states, commands of the controlword, transitions 2 to 16."""

from __future__ import annotations

from enum import Enum, IntEnum
from functools import lru_cache

FAULT_RESET = 0x80  # controlword bit 7, on its rising edge


class PowerState(IntEnum):
    """List the drive states with bits 0-3, 5 and 6 of the statusword."""

    NOT_READY_TO_SWITCH_ON = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08


class Command(Enum):
    """List the commands of the controlword by bit mask and value; fault reset is an edge and is not among them."""

    SHUTDOWN = (0x87, 0x06)
    SWITCH_ON = (0x8F, 0x07)  # in operation enabled, this command is disable operation
    ENABLE_OPERATION = (0x8F, 0x0F)
    DISABLE_VOLTAGE = (0x82, 0x00)
    QUICK_STOP = (0x86, 0x02)


_S = PowerState
_C = Command

TRANSITIONS: dict[tuple[PowerState, Command], tuple[int, PowerState]] = {
    (_S.SWITCH_ON_DISABLED, _C.SHUTDOWN): (2, _S.READY_TO_SWITCH_ON),
    (_S.READY_TO_SWITCH_ON, _C.SWITCH_ON): (3, _S.SWITCHED_ON),
    (_S.READY_TO_SWITCH_ON, _C.ENABLE_OPERATION): (3, _S.SWITCHED_ON),  # then 4, with the same controlword
    (_S.SWITCHED_ON, _C.ENABLE_OPERATION): (4, _S.OPERATION_ENABLED),
    (_S.OPERATION_ENABLED, _C.SWITCH_ON): (5, _S.SWITCHED_ON),
    (_S.SWITCHED_ON, _C.SHUTDOWN): (6, _S.READY_TO_SWITCH_ON),
    (_S.READY_TO_SWITCH_ON, _C.QUICK_STOP): (7, _S.SWITCH_ON_DISABLED),
    (_S.READY_TO_SWITCH_ON, _C.DISABLE_VOLTAGE): (7, _S.SWITCH_ON_DISABLED),
    (_S.OPERATION_ENABLED, _C.SHUTDOWN): (8, _S.READY_TO_SWITCH_ON),
    (_S.OPERATION_ENABLED, _C.DISABLE_VOLTAGE): (9, _S.SWITCH_ON_DISABLED),
    (_S.SWITCHED_ON, _C.QUICK_STOP): (10, _S.SWITCH_ON_DISABLED),
    (_S.SWITCHED_ON, _C.DISABLE_VOLTAGE): (10, _S.SWITCH_ON_DISABLED),
    (_S.OPERATION_ENABLED, _C.QUICK_STOP): (11, _S.QUICK_STOP_ACTIVE),
    (_S.QUICK_STOP_ACTIVE, _C.DISABLE_VOLTAGE): (12, _S.SWITCH_ON_DISABLED),
    (_S.QUICK_STOP_ACTIVE, _C.ENABLE_OPERATION): (16, _S.OPERATION_ENABLED),  # only if 0x605A >= 5
}


@lru_cache(maxsize=256)  # each cycle repeats the same controlword
def command_of(controlword: int) -> Command | None:
    """Return the command in a controlword; None if the bits encode none (a fault reset, for example)."""
    for command in Command:
        mask, value = command.value
        if controlword & mask == value:
            return command
    return None


class PowerStateMachine:
    """Run the state machine on controlwords; `transition` is the number of the last transition."""

    def __init__(self) -> None:
        self.state = PowerState.NOT_READY_TO_SWITCH_ON
        self.transition = 0
        self._last_controlword = 0

    def power_on(self) -> None:
        """Take transitions 0 and 1, as after a passed self-test."""
        self.state = PowerState.SWITCH_ON_DISABLED
        self.transition = 1
        self._last_controlword = 0

    def control(self, controlword: int, quick_stop_stays: bool, fault_gone: bool) -> None:
        """Apply one controlword.

        Args:
            controlword: value of 0x6040.
            quick_stop_stays: True if the quick stop option code (0x605A) is 5 or more, which permits transition 16.
            fault_gone: True if the cause of a fault is gone, so that a reset (transition 15) succeeds.
        """
        edge = controlword & ~self._last_controlword & FAULT_RESET
        self._last_controlword = controlword
        if self.state is PowerState.FAULT:
            if edge and fault_gone:
                self._take(15, PowerState.SWITCH_ON_DISABLED)
            return
        command = command_of(controlword)
        if command is None:
            return
        found = TRANSITIONS.get((self.state, command))
        if found is None or (found[0] == 16 and not quick_stop_stays):
            return
        self._take(*found)
        if found[0] == 3 and command is Command.ENABLE_OPERATION:
            self._take(4, PowerState.OPERATION_ENABLED)

    def fault(self) -> None:
        """Take transition 13, because an error occurred."""
        if self.state not in (PowerState.FAULT, PowerState.FAULT_REACTION_ACTIVE):
            self._take(13, PowerState.FAULT_REACTION_ACTIVE)

    def reaction_done(self) -> None:
        """Take transition 14, because the fault reaction is complete."""
        if self.state is PowerState.FAULT_REACTION_ACTIVE:
            self._take(14, PowerState.FAULT)

    def quick_stop(self) -> None:
        """Take transition 11 because of an option code, without a controlword."""
        if self.state is PowerState.OPERATION_ENABLED:
            self._take(11, PowerState.QUICK_STOP_ACTIVE)

    def voltage_off(self) -> None:
        """Take transition 7, 9, 10 or 12 without a controlword: quick stop complete, connection lost, or power off."""
        numbers = {
            PowerState.OPERATION_ENABLED: 9,
            PowerState.SWITCHED_ON: 10,
            PowerState.READY_TO_SWITCH_ON: 7,
            PowerState.QUICK_STOP_ACTIVE: 12,
        }
        if self.state in numbers:
            self._take(numbers[self.state], PowerState.SWITCH_ON_DISABLED)

    def _take(self, number: int, state: PowerState) -> None:
        self.transition = number
        self.state = state
