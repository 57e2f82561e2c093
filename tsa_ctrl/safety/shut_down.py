"""The end of every run: torque 0, drives disabled and confirmed, nodes pre-operational, then silence.

The ramp of a torque to zero belongs to the loop; this is what follows it, whatever the reason was.
"""

from __future__ import annotations

from tsa_ctrl.bus.canopen import cia402
from tsa_ctrl.bus.canopen.cia301 import NmtCommand
from tsa_ctrl.bus.canopen.cia402 import Controlword, PowerState
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.bus.settings import Role

_OFF = (PowerState.SWITCH_ON_DISABLED, PowerState.FAULT, PowerState.NOT_READY_TO_SWITCH_ON)
_LAST_COMMANDS = 3  # cycles of "disable voltage" after the confirmation, or in spite of its absence


def shut_down(rig: Rig, period: float, timeout: float = 1.0) -> list[str]:
    """Disable all drives and leave their nodes pre-operational; returns what was not confirmed, one line each.

    A drive that does not confirm is stopped by NMT instead.

    Cycles at `period` s until every drive says in a fresh PDO that it is off, at most `timeout` s. May be called in any
    state, twice, and on a bus that has failed: it never raises for that.
    """
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
    for axis in rig.axes:
        for health in axis.image.nodes:
            # Stopped is what a drive's reaction to a lost connection (0x6007) answers to; pre-operational is not.
            obeyed = health.role is not Role.DRIVE or axis.name in off
            rig.nmt(NmtCommand.PRE_OPERATIONAL if obeyed else NmtCommand.STOP, health.node_id)
    return [_unconfirmed(rig, axis.name, axis.image.statusword) for axis in rig.axes if axis.name not in off]


def _unconfirmed(rig: Rig, name: str, statusword: int) -> str:
    state = cia402.decode(statusword).value
    reason = rig.bus.fault.value if rig.bus.fault is not None else f"its last state was {state}"
    return f"axis '{name}': the drive did not confirm that it is off ({reason}); cut its power"
