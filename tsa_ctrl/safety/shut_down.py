"""The end of every run: torque 0, drives disabled and confirmed, nodes pre-operational, then silence.

The ramp of a torque to zero belongs to the loop; this is what follows it, whatever the reason was.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from tsa_ctrl.bus.canopen import cia402
from tsa_ctrl.bus.canopen.cia301 import NmtCommand
from tsa_ctrl.bus.canopen.cia402 import Controlword, PowerState
from tsa_ctrl.bus.drive.release_heartbeat import release_heartbeat
from tsa_ctrl.bus.drive.session import Session
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.errors import BusError

_OFF = (PowerState.SWITCH_ON_DISABLED, PowerState.FAULT, PowerState.NOT_READY_TO_SWITCH_ON)
_LAST_COMMANDS = 3  # cycles of "disable voltage" after the confirmation, or in spite of its absence


def shut_down(
    rig: Rig, period: float, timeout: float = 1.0, say: Callable[[str], None] = lambda line: None
) -> list[str]:
    """Disable all drives and leave their nodes pre-operational; returns what was not confirmed, one line each.

    A drive that does not confirm is stopped by NMT instead. One that does is told, while our heartbeat goes on, that it
    need not watch for it any longer (`say` gets a line for one that does not take that). A rig that commands nothing,
    because its nodes never were found to be as configured, sends nothing.

    Cycles at `period` s until every drive says in a fresh PDO that it is off, at most `timeout` s. May be called in any
    state, twice, and on a bus that has failed: it never raises for that.
    """
    if not rig.commands:
        return [_unknown(axis.name) for axis in rig.axes] if rig.has_commanded else []
    start = begin = rig.wait(0.0)
    off: set[str] = set()
    after = 0
    while after < _LAST_COMMANDS:
        begin = rig.wait(begin + period)  # after a stall no burst of SYNCs
        rig.sync(begin)
        rig.collect(begin + 0.8 * period)
        for axis in rig.axes:
            state = cia402.decode(axis.image.statusword)
            if axis.image.fresh and state in _OFF:
                off.add(axis.name)
            enabled = state is PowerState.OPERATION_ENABLED
            axis.command(Controlword.SHUTDOWN if enabled else Controlword.DISABLE_VOLTAGE, 0.0)
        rig.heartbeat(begin)
        if len(off) == len(rig.axes) or begin - start > timeout or rig.bus.fault is not None:
            after += 1
    on = {axis.nodes.drive.node_id for axis in rig.axes if axis.name not in off}
    for node_id in dict.fromkeys(health.node_id for axis in rig.axes for health in axis.image.nodes):
        # Stopped is what a drive's reaction to a lost connection (0x6007) answers to; pre-operational is not.
        rig.nmt(NmtCommand.STOP if node_id in on else NmtCommand.PRE_OPERATIONAL, node_id)
    unconfirmed = [_unconfirmed(rig, axis.name, axis.image.statusword) for axis in rig.axes if axis.name not in off]
    if rig.bus.fault is None:
        _disarm(rig, sorted({axis.nodes.drive.node_id for axis in rig.axes} - on), say)
    return unconfirmed


def _disarm(rig: Rig, node_ids: Sequence[int], say: Callable[[str], None]) -> None:
    """Nobody watches for us when our heartbeat ends: a drive that did would be in fault at the next start."""
    with Session(rig.bus, rig.settings) as session:
        session.begin_heartbeat()
        for node_id in node_ids:
            try:
                release_heartbeat(session, node_id, rig.settings.host_node_id)
            except BusError as error:
                say(f"the drive may report the end of our heartbeat as an error: {error}")


def _unknown(name: str) -> str:
    return f"axis '{name}': the drive was not brought up again, and what it does now is not known; cut its power"


def _unconfirmed(rig: Rig, name: str, statusword: int) -> str:
    state = cia402.decode(statusword).value
    reason = rig.bus.fault.value if rig.bus.fault is not None else f"its last state was {state}"
    return f"axis '{name}': the drive did not confirm that it is off ({reason}); cut its power"
