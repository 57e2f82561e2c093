"""Decide the PDOs of a configured drive, and the permitted node ids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from tsa_ctrl.bus.canopen import objects, pdo
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
from tsa_ctrl.errors import UsageError

_OWN_IDENTIFIERS = 2  # axes of a device for which its own PDO identifiers suffice


def layout_of(drive: DriveSettings, profile: DriveProfile | None = None) -> DriveLayout:
    """Return the PDOs of a drive by its place in its device, without the objects that its profile lists as absent."""
    layout = drive_layout(drive.node_id, drive.slot, drive.pdo_node_id, drive.pdo == "lean")
    if profile is None or profile.has(objects.ERROR_CODE):
        return layout
    return layout.without(objects.ERROR_CODE)


def torque_sensor_pdo(sensor: TorqueSensorSettings) -> Pdo:
    """The TPDO of a torque sensor."""
    return replace(pdo.TORQUE_SENSOR, every=sensor.every or 1)


def check_node_ids(settings: BusSettings, axes: Sequence[AxisNodes]) -> None:
    """Every node has a different id, except axes of one device and an encoder of two axes; else UsageError."""
    owners: dict[int, tuple[str, NodeSettings | None]] = {
        settings.host_node_id: ("[bus] host_node_id", None),
    }
    for axis in axes:
        for role, node in axis.nodes():
            name = f"axis '{axis.name}' {role.key}"
            owner, other = owners.setdefault(node.node_id, (name, node))
            if owner != name and not (other is not None and _may_share(node, other)):
                raise UsageError(
                    f"{name}: node_id {node.node_id} is also that of {owner}; give every node its own"
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
        return " (axes of one device: give each its slot)"
    if isinstance(node, EncoderSettings) and isinstance(other, EncoderSettings):
        return " (one encoder of two axes: counts, heartbeat and identity must be the same in both)"
    return ""


def _check_identifiers(axis: AxisNodes, owners: dict[int, tuple[str, NodeSettings | None]]) -> None:
    drive = axis.drive
    name = f"axis '{axis.name}' drive"
    if drive.slot > _OWN_IDENTIFIERS and drive.pdo_node_id is None:
        raise UsageError(
            f"{name}: slot {drive.slot} without pdo_node_id: a node has PDO identifiers for two axes; give a "
            "pdo_node_id that no node of the bus has"
        )
    taken = owners.get(drive.pdo_node_id or 0)
    if taken is not None and drive.pdo_node_id != drive.node_id:
        raise UsageError(
            f"{name}: pdo_node_id {drive.pdo_node_id} is the id of {taken[0]}; give one that no node of the bus has"
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
                    f"axis '{axis.name}' drive: its PDO identifier 0x{can_id:03X} is also one of axis '{other}'; "
                    "give one of them another pdo_node_id"
                )
