"""Check once before torque that every node answers as it should: SYNC at the period without any command."""

from __future__ import annotations

from tsa_ctrl.bus.live.image import NodeHealth
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.errors import BusError

_LEAST_ANSWERED = 0.8  # share of SYNCs that each node must answer before torque
_MOST_PDOS = 4  # of a node in a cycle, the TPDOs of CiA 301's defaults: as many come late with one cycle
_GONE = 3  # SYNCs at the end that a node did not answer


def check_startup(rig: Rig, period: float, cycles: int = 50) -> None:
    """SYNC at the period without any command: first cycles are slow ones, so none of them shall count in the loop.

    Raises BusError for a node that does not answer 80 % of `cycles` SYNCs or none of the last three, or that answers
    more than once, as two nodes of one id do.
    """
    nodes = [(axis.name, health) for axis in rig.axes for health in axis.image.nodes]
    cycles += rig.longest_turn  # so that what comes seldom has had its turn
    before = [(health.missed, health.repeated) for _, health in nodes]
    begin = rig.wait(0.0)
    for _ in range(cycles):
        begin = rig.wait(begin + period)
        rig.sync(begin)
        rig.collect(begin + 0.8 * period)
        rig.heartbeat(begin)
    for (name, health), (missed, repeated) in zip(nodes, before, strict=True):
        answered = cycles - (health.missed - missed)
        if answered < _LEAST_ANSWERED * cycles or health.misses >= _GONE:
            raise BusError(
                f"axis '{name}' {health}: answered {answered} of {cycles} SYNCs in time "
                f"(late {health.late}, wrong length {health.malformed}){_said(health)}"
            )
        more = health.repeated - repeated - _MOST_PDOS * (health.missed - missed)  # late ones come with the next
        if more > (1.0 - _LEAST_ANSWERED) * cycles:
            raise BusError(
                f"axis '{name}' {health}: sent {more} more PDOs than {cycles} SYNCs asked for; "
                f"another node may have the same id: give each its own (its switches, its maker's tool, or "
                f"tsa drive set-node-id){_said(health, '')}"
            )


def _said(health: NodeHealth, otherwise: str = "; check the bus load, collect in [controller], and the cable") -> str:
    """Return the emergencies that the node sent meanwhile."""
    if health.emcy is None:
        return otherwise
    return f"; it sent {health.emcy}: remove the reported cause, power the node off and on, and start again"
