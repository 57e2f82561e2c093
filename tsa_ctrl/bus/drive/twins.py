"""Equal drives: only their serial numbers tell them apart, and exchanged ids would exchange the joints."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from tsa_ctrl.bus.canopen import objects
from tsa_ctrl.bus.drive.checks import Node
from tsa_ctrl.bus.drive.report import NodeReport
from tsa_ctrl.bus.settings import Role
from tsa_ctrl.errors import UsageError


def check_twins(nodes: Sequence[Node], reports: Sequence[NodeReport]) -> None:
    """Two drives of one make and model have their serial numbers in the configuration; raises UsageError.

    Where the drives themselves have no serial numbers that differ, that is noted: nothing tells them apart.
    """
    drives = {node.node_id: (node, report) for node, report in zip(nodes, reports, strict=True) if _is_drive(node)}
    for (one, first), (other, second) in itertools.combinations(drives.values(), 2):
        if _model(first) != _model(second):
            continue
        serials = [report.identity.get(objects.SERIAL_NUMBER.name) for report in (first, second)]
        if None in serials or serials[0] == serials[1]:
            for report in (first, second):
                report.notes.append("an equal drive is on this bus, and no serial number (0x1018:4) tells them apart")
        elif one.settings.serial_number is None or other.settings.serial_number is None:
            raise UsageError(
                f"{one.name} and {other.name} are equal drives: with their ids exchanged the joints would be; write "
                f"serial_number = {serials[0]} into the [axis.drive] of the one and serial_number = {serials[1]} into "
                "that of the other, or let tsa doctor CONTROLLER.toml --serial-numbers do it"
            )


def _is_drive(node: Node) -> bool:
    return node.role is Role.DRIVE


def _model(report: NodeReport) -> tuple[int | None, ...]:
    return tuple(report.identity.get(entry.name) for entry in (objects.VENDOR_ID, objects.PRODUCT_CODE))
