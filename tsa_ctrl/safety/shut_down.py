"""Shut a rig down at the end of every run: torque 0, drives confirmed off, nodes pre-operational, then silence.

The loop ramps the torque to zero before. The remaining steps here do not depend on the reason for the shutdown.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from tsa_ctrl.bus.canopen import cia402
from tsa_ctrl.bus.canopen.cia301 import NmtCommand
from tsa_ctrl.bus.canopen.cia402 import Controlword, PowerState
from tsa_ctrl.bus.drive.session import Session, release_heartbeat
from tsa_ctrl.bus.live.axis import Axis
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.bus.settings import BusSettings
from tsa_ctrl.bus.wire.bus import Bus, wires_of
from tsa_ctrl.errors import BusError

_OFF = (PowerState.SWITCH_ON_DISABLED, PowerState.FAULT, PowerState.NOT_READY_TO_SWITCH_ON)
_LAST_COMMANDS = 3  # cycles of "disable voltage" after the confirmation or the time-out


def shut_down(
    rig: Rig, period: float, timeout: float = 1.0, say: Callable[[str], None] = lambda line: None
) -> list[str]:
    """Disable all drives, leave their nodes pre-operational, and return one line for each unconfirmed drive.

    The function runs cycles until every drive reports in a fresh PDO that it is off. A drive that does not confirm is
    stopped by NMT instead. If a drive confirms, its heartbeat consumer is switched off, because our heartbeat ends. A
    rig whose configuration was never confirmed sends nothing here.

    It may be called in any state, repeatedly, and on a failed bus, and does not raise in these cases.

    Args:
        rig: axes and buses.
        period: duration of a cycle, s.
        timeout: longest time to wait for the drives, s.
        say: receives a line if a drive rejects the release of its heartbeat consumer.
    """
    if not rig.commands:
        return [_unknown(axis.name) for axis in rig.axes] if rig.has_commanded else []
    start = begin = rig.wait(0.0)
    off: set[str] = set()
    after = 0
    while after < _LAST_COMMANDS:
        begin = rig.wait(begin + period)  # relative to the last cycle, so that a stall causes no burst of SYNCs
        rig.sync(begin)
        rig.collect(begin + 0.8 * period)
        for axis in rig.axes:
            state = cia402.decode(axis.image.statusword)
            if axis.image.fresh and state in _OFF:
                off.add(axis.name)
            enabled = state is PowerState.OPERATION_ENABLED
            axis.command(Controlword.SHUTDOWN if enabled else Controlword.DISABLE_VOLTAGE, 0.0)
        rig.heartbeat(begin)
        if all(axis.name in off or axis.bus.fault is not None for axis in rig.axes) or begin - start > timeout:
            after += 1
    on = {axis.nodes.drive.node_id for axis in rig.axes if axis.name not in off}
    for node_id in dict.fromkeys(health.node_id for axis in rig.axes for health in axis.image.nodes):
        # The state Stopped triggers a drive's reaction to a lost connection (0x6007). Pre-operational does not.
        rig.nmt(NmtCommand.STOP if node_id in on else NmtCommand.PRE_OPERATIONAL, node_id)
    unconfirmed = [_unconfirmed(axis) for axis in rig.axes if axis.name not in off]
    for bus in [rig.bus] if rig.bus.fault is None else [wire for wire in wires_of(rig.bus) if wire.fault is None]:
        here = {axis.nodes.drive.node_id for axis in rig.axes if bus in (rig.bus, axis.bus)}
        _disarm(bus, rig.settings, sorted(here - on), say)
    return unconfirmed


def _disarm(bus: Bus, settings: BusSettings, node_ids: Sequence[int], say: Callable[[str], None]) -> None:
    """Stop the drives' supervision of our heartbeat, whose end would otherwise be a fault at the next startup."""
    with Session(bus, settings) as session:
        session.begin_heartbeat()
        for node_id in node_ids:
            try:
                release_heartbeat(session, node_id, settings.host_node_id)
            except BusError as error:
                say(f"the drive may report the end of our heartbeat as an error: {error}")


def _unknown(name: str) -> str:
    return f"axis '{name}': the drive was not brought up again, and its state is not known; cut its power"


def _unconfirmed(axis: Axis) -> str:
    state = cia402.decode(axis.image.statusword).value
    reason = axis.bus.fault.value if axis.bus.fault is not None else f"its last state was {state}"
    return f"axis '{axis.name}': the drive did not confirm that it is off ({reason}); cut its power"
