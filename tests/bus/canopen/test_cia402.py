"""Test the CiA 402 power state machine."""

from __future__ import annotations

import pytest

from tsa_ctrl.bus.canopen.cia402 import (
    INTERNAL_LIMIT,
    REMOTE,
    VOLTAGE_ENABLED,
    WALK,
    WARNING,
    Controlword,
    PowerState,
    decode,
    next_controlword,
)

S = PowerState


def by_the_standard(statusword: int) -> PowerState:
    """Return the state by the statusword table of CiA 402-2. The rows list bits 6 5 3 2 1 0 (x: any)."""
    rows = {
        "0x0000": S.NOT_READY_TO_SWITCH_ON,
        "1x0000": S.SWITCH_ON_DISABLED,
        "010001": S.READY_TO_SWITCH_ON,
        "010011": S.SWITCHED_ON,
        "010111": S.OPERATION_ENABLED,
        "000111": S.QUICK_STOP_ACTIVE,
        "0x1111": S.FAULT_REACTION_ACTIVE,
        "0x1000": S.FAULT,
    }
    bits = "".join(str(statusword >> bit & 1) for bit in (6, 5, 3, 2, 1, 0))
    found = [state for row, state in rows.items() if all(r in ("x", b) for r, b in zip(row, bits, strict=True))]
    return found[0] if found else S.UNKNOWN


def test_statuswords_decode_as_in_the_standard() -> None:
    """All values of the state bits, and bits 4 and 7 to 15 alone, together and absent."""
    others = (0, 0xFF90, *(1 << bit for bit in (4, *range(7, 16))))
    words = [state | other for state in range(128) for other in others]
    assert [decode(word) for word in words] == [by_the_standard(word) for word in words]


AFTER = {  # state of a drive after a command, CiA 402-2 transitions 2-12
    (S.SWITCH_ON_DISABLED, 0x06): S.READY_TO_SWITCH_ON,
    (S.READY_TO_SWITCH_ON, 0x06): S.READY_TO_SWITCH_ON,
    (S.READY_TO_SWITCH_ON, 0x07): S.SWITCHED_ON,
    (S.SWITCHED_ON, 0x06): S.READY_TO_SWITCH_ON,
    (S.SWITCHED_ON, 0x0F): S.OPERATION_ENABLED,
    (S.OPERATION_ENABLED, 0x0F): S.OPERATION_ENABLED,
    (S.OPERATION_ENABLED, 0x06): S.READY_TO_SWITCH_ON,
    (S.QUICK_STOP_ACTIVE, 0x00): S.SWITCH_ON_DISABLED,
}
START = (S.SWITCH_ON_DISABLED, S.READY_TO_SWITCH_ON, S.SWITCHED_ON, S.OPERATION_ENABLED, S.QUICK_STOP_ACTIVE)


@pytest.mark.parametrize("target", [S.OPERATION_ENABLED, S.READY_TO_SWITCH_ON])
@pytest.mark.parametrize("state", START)
def test_walk_reaches_its_target_from_every_state(state: PowerState, target: PowerState) -> None:
    steps = 0
    while state is not target:
        state = AFTER[state, next_controlword(state, target)]
        steps += 1
        assert steps <= 4


@pytest.mark.parametrize("state", START)
def test_every_command_towards_off_switches_the_power_stage_off(state: PowerState) -> None:
    assert next_controlword(state, S.SWITCH_ON_DISABLED) == 0x00


@pytest.mark.parametrize("target", list(WALK))
@pytest.mark.parametrize("state", [S.FAULT, S.FAULT_REACTION_ACTIVE, S.NOT_READY_TO_SWITCH_ON, S.UNKNOWN])
def test_nothing_leaves_a_fault_or_an_unknown_state_by_itself(state: PowerState, target: PowerState) -> None:
    assert next_controlword(state, target) is Controlword.DISABLE_VOLTAGE


def test_bits_besides_the_state_are_those_of_the_standard() -> None:
    assert [VOLTAGE_ENABLED, WARNING, REMOTE, INTERNAL_LIMIT] == [0x0010, 0x0080, 0x0200, 0x0800]
