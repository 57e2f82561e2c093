"""Check the nodes and buses of a configuration, determine the PDOs of each drive, and open the buses."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import TypeVar

from tsa_ctrl.bus.canopen import cia301, objects, pdo
from tsa_ctrl.bus.canopen.pdo import DriveLayout, Pdo, drive_layout
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.settings import (
    AxisNodes,
    BusSettings,
    DriveSettings,
    EncoderSettings,
    NodeSettings,
    TorqueSensorSettings,
)
from tsa_ctrl.bus.wire.bus import REMOTE_FLAG, Bus, BusGroup
from tsa_ctrl.bus.wire.link import open_bus
from tsa_ctrl.errors import UsageError

_OWN_IDENTIFIERS = 2  # number of axes of a device for which its own PDO identifiers suffice


def layout_of(drive: DriveSettings, profile: DriveProfile | None = None) -> DriveLayout:
    """Return the PDOs of a drive for its slot in the device, without objects that its profile lists as absent."""
    layout = drive_layout(drive.node_id, drive.slot, drive.pdo_node_id, drive.pdo == "lean")
    if profile is None or profile.has(objects.ERROR_CODE):
        return layout
    return layout.without(objects.ERROR_CODE)


def torque_sensor_pdo(sensor: TorqueSensorSettings) -> Pdo:
    """Return the TPDO of a torque sensor."""
    return replace(pdo.TORQUE_SENSOR, every=sensor.every or 1)


def frames_of_drives(profiles: Sequence[DriveProfile]) -> frozenset[int]:
    """Return the identifiers of a master that the drives may send themselves: SYNC, if a profile permits it."""
    return frozenset({cia301.SYNC} if any(profile.produces_sync for profile in profiles) else ())


def check_node_ids(settings: BusSettings, axes: Sequence[AxisNodes]) -> None:
    """Raise UsageError if two nodes share an id, unless they are axes of one device or one encoder of two axes."""
    owners: dict[int, tuple[str, NodeSettings | None]] = {
        settings.host_node_id: ("[bus] host_node_id", None),
    }
    for axis in axes:
        for role, node in axis.nodes():
            name = f"axis '{axis.name}' {role.key}"
            owner, other = owners.setdefault(node.node_id, (name, node))
            if owner != name and not (other is not None and _may_share(node, other)):
                raise UsageError(
                    f"{name}: node_id {node.node_id} is also used by {owner}; give each node its own"
                    f"{_how_to_share(node, other)}"
                )
    for axis in axes:
        _check_identifiers(axis, owners)
    _check_slots(axes)


def _may_share(node: NodeSettings, other: NodeSettings) -> bool:
    if isinstance(node, DriveSettings) and isinstance(other, DriveSettings):
        return node.slot != other.slot
    if isinstance(node, EncoderSettings) and isinstance(other, EncoderSettings):
        ours, theirs = (
            (e.counts_per_revolution, e.counts_range, e.heartbeat_period, e.vendor_id, e.product_code, e.serial_number)
            for e in (node, other)
        )
        return ours == theirs
    return False


def _how_to_share(node: NodeSettings, other: NodeSettings | None) -> str:
    if isinstance(node, DriveSettings) and isinstance(other, DriveSettings):
        return " (axes of one device: give each its own slot)"
    if isinstance(node, EncoderSettings) and isinstance(other, EncoderSettings):
        return " (one encoder for two axes: counts, heartbeat and identity must be the same in both)"
    return ""


def _check_identifiers(axis: AxisNodes, owners: dict[int, tuple[str, NodeSettings | None]]) -> None:
    drive = axis.drive
    name = f"axis '{axis.name}' drive"
    if drive.slot > _OWN_IDENTIFIERS and drive.pdo_node_id is None:
        raise UsageError(
            f"{name}: slot {drive.slot} without pdo_node_id: a node has PDO identifiers for only two axes; choose a "
            "pdo_node_id that no node on the bus has"
        )
    taken = owners.get(drive.pdo_node_id or 0)
    if taken is not None and drive.pdo_node_id != drive.node_id:
        raise UsageError(
            f"{name}: pdo_node_id {drive.pdo_node_id} is the id of {taken[0]}; choose one that no node on the bus has"
        )


def _check_slots(axes: Sequence[AxisNodes]) -> None:
    slots: dict[tuple[int, int], str] = {}
    identifiers: dict[int, str] = {}
    for axis in axes:
        drive = axis.drive
        other = slots.setdefault((drive.node_id, drive.slot), axis.name)
        if other != axis.name:
            raise UsageError(
                f"axis '{axis.name}' drive: slot {drive.slot} of node {drive.node_id} belongs to axis '{other}'; "
                "give each axis of one device its own slot"
            )
        layout = layout_of(drive)
        for can_id in (layout.rpdo_id, *layout.tpdo_ids):
            other = identifiers.setdefault(can_id, axis.name)
            if other != axis.name:
                raise UsageError(
                    f"axis '{axis.name}' drive: its PDO identifier 0x{can_id:03X} is also used by axis '{other}'; "
                    "give one of the axes another pdo_node_id"
                )


OWN = frozenset({"name", "interface", "channel", "bitrate", "options", "max_load", "send_queue"})  # specific to a bus
A = TypeVar("A", bound=AxisNodes)


def axes_of(bus: BusSettings, axes: Sequence[A]) -> tuple[A, ...]:
    """Return the axes on a bus; an axis without a bus name is on the only bus."""
    return tuple(axis for axis in axes if axis.bus is None or axis.bus == bus.name)


def check_buses(buses: Sequence[BusSettings], axes: Sequence[AxisNodes]) -> None:
    """Check that each axis is on one bus, and that one cycle can serve all buses; raise UsageError if not."""
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
            raise UsageError(f"[[bus]]: {names.count(name)} buses have the name '{name}'; give each its own name")
    listed = ", ".join(names)
    for axis in axes:
        if axis.bus is None and len(buses) > 1:
            raise UsageError(f"axis '{axis.name}': bus is missing; set it to one of {listed}")
        if axis.bus is not None and axis.bus not in names:
            raise UsageError(f"axis '{axis.name}': there is no bus '{axis.bus}'; choose one of {listed}")
    places: dict[tuple[str, str], str] = {}
    for bus in buses:
        if not axes_of(bus, axes):
            raise UsageError(
                f"[[bus]] '{bus.name}': no axis uses it; write bus = \"{bus.name}\" in an axis, or remove it"
            )
        other = places.setdefault((bus.interface, bus.channel), bus.name)
        if other != bus.name:
            raise UsageError(
                f"[[bus]] '{bus.name}': channel '{bus.channel}' is also used by '{other}'; give each bus its own"
            )
        for key in bus.__struct_fields__:
            if key not in OWN and getattr(bus, key) != getattr(buses[0], key):
                raise UsageError(
                    f"[[bus]] '{bus.name}': {key} differs from bus '{names[0]}', but one cycle serves all buses; "
                    "write the same value in each"
                )
    _check_nodes(axes)


def _check_nodes(axes: Sequence[AxisNodes]) -> None:
    """Raise UsageError if two nodes on different buses have the same id."""
    owners: dict[int, AxisNodes] = {}
    for axis in axes:
        for _, node in axis.nodes():
            owner = owners.setdefault(node.node_id, axis)
            if owner.bus != axis.bus:
                raise UsageError(
                    f"axis '{axis.name}' on bus '{axis.bus}': node_id {node.node_id} is also used by axis "
                    f"'{owner.name}' on bus '{owner.bus}'; give each node its own, across all buses"
                )


def joined(wires: Sequence[Bus], buses: Sequence[BusSettings], axes: Sequence[AxisNodes]) -> Bus:
    """Return the open buses `wires` of `buses` as one bus; a single one is returned unchanged."""
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
    """Open the configured buses and return them as one bus; raise BusError if one is not ready."""
    with ExitStack() as opened:
        wires = []
        for settings in buses:
            wires.append(open_bus(settings))
            opened.callback(wires[-1].close)
        bus = joined(wires, buses, axes)
        opened.pop_all()
        return bus
