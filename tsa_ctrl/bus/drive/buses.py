"""Several buses of one daemon: which axis is on which, and all of them behind the seam of one bus."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import TypeVar

from tsa_ctrl.bus.canopen import cia301, pdo
from tsa_ctrl.bus.drive.layout import layout_of
from tsa_ctrl.bus.settings import AxisNodes, BusSettings
from tsa_ctrl.bus.wire.group import BusGroup
from tsa_ctrl.bus.wire.link import open_bus
from tsa_ctrl.bus.wire.seam import REMOTE_FLAG, Bus
from tsa_ctrl.errors import UsageError

OWN = frozenset({"name", "interface", "channel", "bitrate", "options", "max_load", "send_queue"})  # keys of one bus
A = TypeVar("A", bound=AxisNodes)


def axes_of(bus: BusSettings, axes: Sequence[A]) -> tuple[A, ...]:
    """Return the axes on a bus; an axis that names no bus is on the only one."""
    return tuple(axis for axis in axes if axis.bus is None or axis.bus == bus.name)


def check_buses(buses: Sequence[BusSettings], axes: Sequence[AxisNodes]) -> None:
    """Check that each axis is on one bus, and that one cycle can run over all buses; raises UsageError."""
    names = [bus.name for bus in buses]
    if len(buses) == 1 and not names[0]:
        named = [axis for axis in axes if axis.bus is not None]
        if named:
            raise UsageError(
                f"axis '{named[0].name}': bus '{named[0].bus}', but [bus] has no name; give it one, or remove bus"
            )
        return
    for number, name in enumerate(names, 1):
        if not name:
            raise UsageError(f"[[bus]] number {number} has no name; give each bus a name")
        if names.count(name) > 1:
            raise UsageError(f"[[bus]]: {names.count(name)} buses are named '{name}'; give each its own name")
    listed = ", ".join(names)
    for axis in axes:
        if axis.bus is None and len(buses) > 1:
            raise UsageError(f"axis '{axis.name}': names no bus; write bus with one of {listed}")
        if axis.bus is not None and axis.bus not in names:
            raise UsageError(f"axis '{axis.name}': no bus '{axis.bus}'; choose one of {listed}")
    places: dict[tuple[str, str], str] = {}
    for bus in buses:
        if not axes_of(bus, axes):
            raise UsageError(f"[[bus]] '{bus.name}': no axis is on it; write bus = \"{bus.name}\" in one, or remove it")
        other = places.setdefault((bus.interface, bus.channel), bus.name)
        if other != bus.name:
            raise UsageError(
                f"[[bus]] '{bus.name}': channel '{bus.channel}' is also that of '{other}'; give each bus its own"
            )
        for key in bus.__struct_fields__:
            if key not in OWN and getattr(bus, key) != getattr(buses[0], key):
                raise UsageError(
                    f"[[bus]] '{bus.name}': {key} differs from that of '{names[0]}'; one cycle runs over all buses, "
                    "write the same in each"
                )
    _check_nodes(axes)


def _check_nodes(axes: Sequence[AxisNodes]) -> None:
    """Raise UsageError if a node of one bus has the id of a node of another bus."""
    owners: dict[int, AxisNodes] = {}
    for axis in axes:
        for _, node in axis.nodes():
            owner = owners.setdefault(node.node_id, axis)
            if owner.bus != axis.bus:
                raise UsageError(
                    f"axis '{axis.name}' on bus '{axis.bus}': node_id {node.node_id} is also one of axis "
                    f"'{owner.name}' on bus '{owner.bus}'; give every node of all buses its own"
                )


def joined(wires: Sequence[Bus], buses: Sequence[BusSettings], axes: Sequence[AxisNodes]) -> Bus:
    """Return the open buses `wires` of `buses` behind the seam of one; a single one as it is."""
    if len(wires) == 1:
        return wires[0]
    by_id: dict[int, int] = {}
    by_node: dict[int, int] = {}
    for place, bus in enumerate(buses):
        for axis in axes_of(bus, axes):
            layout = layout_of(axis.drive)
            answers = list(layout.tpdo_ids)
            answers += [] if axis.encoder is None else [pdo.ENCODER.cob_id(axis.encoder.node_id)]
            answers += [] if axis.torque_sensor is None else [pdo.TORQUE_SENSOR.cob_id(axis.torque_sensor.node_id)]
            by_id.update(dict.fromkeys((layout.rpdo_id, *answers), place))
            for _, node in axis.nodes():
                by_node[node.node_id] = place
                by_id[cia301.SDO_REQUEST + node.node_id] = place
                by_id[REMOTE_FLAG | cia301.HEARTBEAT + node.node_id] = place
    return BusGroup(wires, by_id, by_node)


def open_buses(buses: Sequence[BusSettings], axes: Sequence[AxisNodes]) -> Bus:
    """Open the configured buses and return them behind the seam of one; raises BusError if one is not ready."""
    with ExitStack() as opened:
        wires = []
        for settings in buses:
            wires.append(open_bus(settings))
            opened.callback(wires[-1].close)
        bus = joined(wires, buses, axes)
        opened.pop_all()
        return bus
