"""CiA 402 power state machine as tables: statusword -> state, and (state, target) -> controlword.

The module has no I/O and no clock. `next_controlword` never returns a fault reset, so a drive leaves a fault only on
request.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum

from tsa_ctrl.bus.canopen import objects
from tsa_ctrl.bus.canopen.objects import Object


class PowerState(Enum):
    """States of the CiA 402 finite state automaton. UNKNOWN means that the statusword encodes no state."""

    NOT_READY_TO_SWITCH_ON = "not_ready_to_switch_on"
    SWITCH_ON_DISABLED = "switch_on_disabled"
    READY_TO_SWITCH_ON = "ready_to_switch_on"
    SWITCHED_ON = "switched_on"
    OPERATION_ENABLED = "operation_enabled"
    QUICK_STOP_ACTIVE = "quick_stop_active"
    FAULT_REACTION_ACTIVE = "fault_reaction_active"
    FAULT = "fault"
    UNKNOWN = "unknown"


class Controlword(IntEnum):
    """Commands in the controlword (object 0x6040)."""

    DISABLE_VOLTAGE = 0x00
    QUICK_STOP = 0x02
    SHUTDOWN = 0x06
    SWITCH_ON = 0x07
    ENABLE_OPERATION = 0x0F
    FAULT_RESET = 0x80  # rising edge of bit 7


class Mode(IntEnum):
    """Modes of operation, objects 0x6060 and 0x6061."""

    CYCLIC_SYNC_TORQUE = 10


CST_SUPPORTED = 1 << 9  # bit of object 0x6502

VOLTAGE_ENABLED = 1 << 4  # bit of the statusword: the motor supply voltage is present
WARNING = 1 << 7  # a warning is active, e.g. of temperature; the state does not change
REMOTE = 1 << 9  # the controlword is processed
INTERNAL_LIMIT = 1 << 11  # an internal limit of the drive is active: the torque may be below the command
FOLLOWS_COMMAND_BIT = 1 << 12  # in cyclic modes only; 0: the drive ignores the command


class Effect(Enum):
    """How an object acts on the torque between the command (0x6071) and the motor."""

    ADDS = "adds to the command"
    LIMITS = "limits the torque"
    RAMPS = "ramps the torque"
    SCALES = "scales the torque or reverses its sign"


@dataclass(frozen=True)
class Influence:
    """An object that acts on the torque of a cyclic mode.

    Attributes:
        unit: unit of one digit, for display.
        restored: value that the bring-up writes and reads back; None keeps the drive's own value.
        watched: True if a change while the loop runs is a fault, because it scales or reverses the torque.
    """

    entry: Object
    effect: Effect
    unit: str = ""
    restored: int | None = None
    watched: bool = False


_PER_MILLE = "per mille of the rated torque"
# Source: CiA 402-2 (IEC 61800-7-201), cyclic synchronous torque mode. The position and velocity offsets act in the
# other cyclic modes. The slope (0x6087) and its profile (0x6088) act in profile torque mode, and on some drives also
# in this mode. The max torque (0x6072) and the max motor speed (0x6080) come from the configuration and are written.
TORQUE_PATH: tuple[Influence, ...] = (
    Influence(objects.POSITION_OFFSET, Effect.ADDS, restored=0),
    Influence(objects.VELOCITY_OFFSET, Effect.ADDS, restored=0),
    Influence(objects.TORQUE_OFFSET, Effect.ADDS, _PER_MILLE, restored=0),
    Influence(objects.POSITIVE_TORQUE_LIMIT, Effect.LIMITS, _PER_MILLE),
    Influence(objects.NEGATIVE_TORQUE_LIMIT, Effect.LIMITS, _PER_MILLE),
    Influence(objects.MAX_CURRENT, Effect.LIMITS, "per mille of the rated current"),
    Influence(objects.TORQUE_SLOPE, Effect.RAMPS, f"{_PER_MILLE} per s"),
    Influence(objects.TORQUE_PROFILE, Effect.RAMPS),
    Influence(objects.POLARITY, Effect.SCALES, watched=True),
    Influence(objects.RATED_TORQUE, Effect.SCALES, watched=True),
    Influence(objects.RATED_CURRENT, Effect.SCALES, "mA", watched=True),
)
OFFSETS = tuple(influence.entry for influence in TORQUE_PATH if influence.effect is Effect.ADDS)

STATUSWORD_PATTERNS: tuple[tuple[int, int, PowerState], ...] = (  # mask, value, state
    (0x4F, 0x00, PowerState.NOT_READY_TO_SWITCH_ON),
    (0x4F, 0x40, PowerState.SWITCH_ON_DISABLED),
    (0x6F, 0x21, PowerState.READY_TO_SWITCH_ON),
    (0x6F, 0x23, PowerState.SWITCHED_ON),
    (0x6F, 0x27, PowerState.OPERATION_ENABLED),
    (0x6F, 0x07, PowerState.QUICK_STOP_ACTIVE),
    (0x4F, 0x0F, PowerState.FAULT_REACTION_ACTIVE),
    (0x4F, 0x08, PowerState.FAULT),
)
STATE_BITS = 0x6F  # union of all masks above


def _match(statusword: int) -> PowerState:
    for mask, value, state in STATUSWORD_PATTERNS:
        if statusword & mask == value:
            return state
    return PowerState.UNKNOWN


_STATES = tuple(_match(bits) for bits in range(STATE_BITS + 1))

_S = PowerState
_C = Controlword
WALK: dict[PowerState, dict[PowerState, Controlword]] = {  # target -> state -> command
    _S.OPERATION_ENABLED: {
        _S.SWITCH_ON_DISABLED: _C.SHUTDOWN,
        _S.READY_TO_SWITCH_ON: _C.SWITCH_ON,
        _S.SWITCHED_ON: _C.ENABLE_OPERATION,
        _S.OPERATION_ENABLED: _C.ENABLE_OPERATION,
        _S.QUICK_STOP_ACTIVE: _C.DISABLE_VOLTAGE,
    },
    _S.READY_TO_SWITCH_ON: {
        _S.SWITCH_ON_DISABLED: _C.SHUTDOWN,
        _S.READY_TO_SWITCH_ON: _C.SHUTDOWN,
        _S.SWITCHED_ON: _C.SHUTDOWN,
        _S.OPERATION_ENABLED: _C.SHUTDOWN,
        _S.QUICK_STOP_ACTIVE: _C.DISABLE_VOLTAGE,
    },
    _S.SWITCH_ON_DISABLED: {},
}


def decode(statusword: int) -> PowerState:
    """Return the state that a statusword (0x6041) encodes."""
    return _STATES[statusword & STATE_BITS]


def next_controlword(state: PowerState, target: PowerState) -> Controlword:
    """Return the command that leads from `state` one step towards `target` (a key of `WALK`).

    The result is DISABLE_VOLTAGE if no step leads there (from fault, fault reaction, not ready or unknown).
    """
    return WALK[target].get(state, Controlword.DISABLE_VOLTAGE)
