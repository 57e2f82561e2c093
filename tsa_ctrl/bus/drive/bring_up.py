"""The master's duties at start: boot, identity, errors, configuration with read-back, rated torque, start.

Everything written is read back, and what the node had before is kept, so that the report shows what was changed.
Nothing here applies torque or enables a drive.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from tsa_ctrl.bus.canopen.eds import check_plan, load_eds
from tsa_ctrl.bus.canopen.objects import Write
from tsa_ctrl.bus.drive import budget
from tsa_ctrl.bus.drive.checks import (
    Node,
    check_drive,
    check_encoder,
    check_identity,
    check_watchdog,
    confirm_mode,
    read_errors,
    reset_fault,
    switch_off,
)
from tsa_ctrl.bus.drive.plan import check_node_ids, drive_plan, encoder_plan, torque_sensor_plan
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.drive.report import NodeReport, Report
from tsa_ctrl.bus.drive.scale import drive_scale
from tsa_ctrl.bus.drive.session import Session
from tsa_ctrl.bus.drive.writing import write_all
from tsa_ctrl.bus.settings import AxisNodes, BusSettings, EncoderSettings, Role
from tsa_ctrl.bus.wire.seam import Bus
from tsa_ctrl.errors import BusError

BOOT_TIMEOUT = 3.0  # s, from reset communication to the boot-up message
START_TIMEOUT = 2.0  # s, until a heartbeat says "operational"


def bring_up(
    bus: Bus,
    settings: BusSettings,
    axes: Sequence[AxisNodes],
    profiles: Sequence[DriveProfile],
    period: float,
    reset_faults: bool = False,
) -> Report:
    """Configure and start all nodes of `axes` for a SYNC period in s; on return they are operational, drives disabled.

    `reset_faults`: somebody asked for drives found in fault to be reset; without it they stay as they are.

    Raises UsageError when the configuration is wrong (load, contradictions, rated torque) and BusError when the bus or
    a node is.
    """
    budget.check(settings, axes, 1.0 / period)
    check_node_ids(settings, axes)
    nodes = list(_nodes(axes, profiles))
    plans = [_plan(node, settings, period) for node in nodes]
    with Session(bus, settings) as session:
        _boot(bus, session, nodes)
        reports = [_configure(session, node, plan, reset_faults) for node, plan in zip(nodes, plans, strict=True)]
        missing = session.start((node.settings.node_id for node in nodes), START_TIMEOUT)
        if missing:
            names = ", ".join(node.name for node in nodes if node.settings.node_id in missing)
            raise BusError(
                f"{bus.name}: {names} did not become operational within {START_TIMEOUT:g} s; "
                "read its error history, power it off and on, and start again"
            )
    return Report(tuple(reports))


def _nodes(axes: Sequence[AxisNodes], profiles: Sequence[DriveProfile]) -> Iterable[Node]:
    for axis, profile in zip(axes, profiles, strict=True):
        yield Node(axis, profile, Role.DRIVE, axis.drive)
        if axis.encoder is not None:
            yield Node(axis, profile, Role.ENCODER, axis.encoder)
        if axis.torque_sensor is not None:
            yield Node(axis, profile, Role.TORQUE_SENSOR, axis.torque_sensor)


def _plan(node: Node, settings: BusSettings, period: float) -> list[Write]:
    if node.role is Role.DRIVE:
        scale = drive_scale(node.axis.drive, node.profile, f"axis '{node.axis.name}'")
        return drive_plan(node.axis, node.profile, scale, settings, period)
    if isinstance(node.settings, EncoderSettings):
        return encoder_plan(node.settings)
    return torque_sensor_plan(node.settings)


def _boot(bus: Bus, session: Session, nodes: Sequence[Node]) -> None:
    missing = session.boot((node.settings.node_id for node in nodes), BOOT_TIMEOUT)
    if not missing:
        return
    names = ", ".join(node.name for node in nodes if node.settings.node_id in missing)
    heard = ", ".join(str(node_id) for node_id in sorted(session.heard)) or "nobody"
    raise BusError(
        f"{bus.name}: no answer from {names} within {BOOT_TIMEOUT:g} s (heard: {heard}); "
        "check power, wiring, node id and bit rate"
    )


def _configure(session: Session, node: Node, plan: Sequence[Write], reset_faults: bool) -> NodeReport:
    report = NodeReport(node.name)
    if node.role is Role.DRIVE and node.profile.eds is not None:
        report.notes += check_plan(load_eds(node.profile.eds), node.profile.eds, plan)
    check_identity(session, node, report)
    read_errors(session, node, report)
    if node.role is Role.DRIVE:
        switch_off(session, node)
        if reset_faults:
            reset_fault(session, node, report)
        check_drive(session, node, report)
    if isinstance(node.settings, EncoderSettings):
        check_encoder(session, node.settings, node.name)
    report.rows = write_all(session, node.settings.node_id, node.name, plan)
    if node.role is Role.DRIVE:
        confirm_mode(session, node)
        check_watchdog(node, plan, report)
    return report
