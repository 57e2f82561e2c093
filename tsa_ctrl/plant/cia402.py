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

TRANSITIONS: dict[tuple[PowerState, Command], PowerState] = {  # with the number of each transition
    (_S.SWITCH_ON_DISABLED, _C.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 2
    (_S.READY_TO_SWITCH_ON, _C.SWITCH_ON): _S.SWITCHED_ON,  # 3
    (_S.READY_TO_SWITCH_ON, _C.ENABLE_OPERATION): _S.OPERATION_ENABLED,  # 3 and 4, with the same controlword
    (_S.SWITCHED_ON, _C.ENABLE_OPERATION): _S.OPERATION_ENABLED,  # 4
    (_S.OPERATION_ENABLED, _C.SWITCH_ON): _S.SWITCHED_ON,  # 5
    (_S.SWITCHED_ON, _C.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 6
    (_S.READY_TO_SWITCH_ON, _C.QUICK_STOP): _S.SWITCH_ON_DISABLED,  # 7
    (_S.READY_TO_SWITCH_ON, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 7
    (_S.OPERATION_ENABLED, _C.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 8
    (_S.OPERATION_ENABLED, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 9
    (_S.SWITCHED_ON, _C.QUICK_STOP): _S.SWITCH_ON_DISABLED,  # 10
    (_S.SWITCHED_ON, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 10
    (_S.OPERATION_ENABLED, _C.QUICK_STOP): _S.QUICK_STOP_ACTIVE,  # 11
    (_S.QUICK_STOP_ACTIVE, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 12
    (_S.QUICK_STOP_ACTIVE, _C.ENABLE_OPERATION): _S.OPERATION_ENABLED,  # 16, only if 0x605A >= 5
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
    """Run the state machine on controlwords."""

    def __init__(self) -> None:
        self.state = PowerState.NOT_READY_TO_SWITCH_ON
        self._last_controlword = 0

    def power_on(self) -> None:
        """Take transitions 0 and 1, as after a passed self-test."""
        self.state = PowerState.SWITCH_ON_DISABLED
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
                self.state = PowerState.SWITCH_ON_DISABLED
            return
        command = command_of(controlword)
        if command is None:
            return
        if self.state is not PowerState.QUICK_STOP_ACTIVE or command is Command.DISABLE_VOLTAGE or quick_stop_stays:
            self.state = TRANSITIONS.get((self.state, command), self.state)

    def fault(self) -> None:
        """Take transition 13, because an error occurred."""
        if self.state not in (PowerState.FAULT, PowerState.FAULT_REACTION_ACTIVE):
            self.state = PowerState.FAULT_REACTION_ACTIVE

    def reaction_done(self) -> None:
        """Take transition 14, because the fault reaction is complete."""
        if self.state is PowerState.FAULT_REACTION_ACTIVE:
            self.state = PowerState.FAULT

    def quick_stop(self) -> None:
        """Take transition 11 because of an option code, without a controlword."""
        if self.state is PowerState.OPERATION_ENABLED:
            self.state = PowerState.QUICK_STOP_ACTIVE

    def voltage_off(self) -> None:
        """Take transition 7, 9, 10 or 12 without a controlword: quick stop complete, connection lost, or power off."""
        self.state = TRANSITIONS.get((self.state, Command.DISABLE_VOLTAGE), self.state)
