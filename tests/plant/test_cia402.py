"""Test the power state machine in every state with every controlword, against literal tables of CiA 402."""

from __future__ import annotations

import pytest

from tsa_ctrl.plant.cia402 import PowerState, PowerStateMachine

NOT_READY, DISABLED, READY, ON, ENABLED, STOP, REACTION, FAULT = PowerState


def machine_in(state: PowerState) -> PowerStateMachine:
    machine = PowerStateMachine()
    machine.state = state
    return machine


def expected(state: PowerState, controlword: int) -> PowerState:
    """Return the next state by an independent bitwise implementation of the standard's figure."""
    if state is FAULT:
        return DISABLED if controlword & 0x80 else FAULT
    if state in (NOT_READY, REACTION) or controlword & 0x80:
        return state
    voltage, quick_stop, switch_on, enable = (bool(controlword & bit) for bit in (2, 4, 1, 8))
    if not voltage:
        return state if state is DISABLED else DISABLED
    if not quick_stop:
        return {READY: DISABLED, ON: DISABLED, ENABLED: STOP}.get(state, state)
    if not switch_on:
        return {DISABLED: READY, ON: READY, ENABLED: READY}.get(state, state)
    if not enable:
        return {READY: ON, ENABLED: ON}.get(state, state)
    return {READY: ENABLED, ON: ENABLED, STOP: ENABLED}.get(state, state)


@pytest.mark.parametrize("state", list(PowerState))
def test_every_controlword_in_every_state(state: PowerState) -> None:
    for controlword in range(0x100):
        machine = machine_in(state)
        machine.control(controlword, quick_stop_stays=True, fault_gone=True)
        assert machine.state is expected(state, controlword), hex(controlword)


def test_fault_reset_is_an_edge() -> None:
    machine = machine_in(FAULT)
    machine.control(0x80, True, fault_gone=False)
    machine.control(0x80, True, fault_gone=True)
    assert machine.state is FAULT
    machine.control(0x00, True, fault_gone=True)
    machine.control(0x80, True, fault_gone=True)
    assert machine.state is DISABLED


def test_quick_stop_ends_only_by_disable_voltage_unless_it_stays() -> None:
    machine = machine_in(STOP)
    machine.control(0x0F, quick_stop_stays=False, fault_gone=True)
    assert machine.state is STOP
    machine.control(0x00, quick_stop_stays=False, fault_gone=True)
    assert machine.state is DISABLED


@pytest.mark.parametrize("state", list(PowerState))
def test_an_error_leads_through_the_fault_reaction(state: PowerState) -> None:
    machine = machine_in(state)
    machine.fault()
    assert machine.state is (FAULT if state is FAULT else REACTION)
    machine.reaction_done()
    assert machine.state is FAULT


def test_power_on_ends_in_switch_on_disabled() -> None:
    machine = PowerStateMachine()
    assert machine.state is NOT_READY
    machine.power_on()
    assert machine.state is DISABLED


@pytest.mark.parametrize(
    ("state", "bits"),
    [(NOT_READY, 0x00), (DISABLED, 0x40), (READY, 0x21), (ON, 0x23), (ENABLED, 0x27), (STOP, 0x07), (REACTION, 0x0F),
     (FAULT, 0x08)],
)  # fmt: skip
def test_the_statusword_bits_of_a_state(state: PowerState, bits: int) -> None:
    assert state.value == bits
