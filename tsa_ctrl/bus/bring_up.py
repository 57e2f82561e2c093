"""The master's duties at start: boot, identity, errors, configuration with read-back, rated torque, start.

Everything written is read back, and what the node had before is kept, so that the report shows what was changed.
Nothing here applies torque or enables a drive.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from tsa_ctrl.bus import budget
from tsa_ctrl.bus.checks import (
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
from tsa_ctrl.bus.eds import check_plan, load_eds
from tsa_ctrl.bus.image import Role
from tsa_ctrl.bus.plan import Write, check_node_ids, drive_plan, encoder_plan, torque_sensor_plan
from tsa_ctrl.bus.profile import DriveProfile
from tsa_ctrl.bus.report import NodeReport, Report
from tsa_ctrl.bus.rig import Rig
from tsa_ctrl.bus.scale import drive_scale
from tsa_ctrl.bus.seam import Bus
from tsa_ctrl.bus.session import Session
from tsa_ctrl.bus.settings import AxisNodes, BusSettings, EncoderSettings
from tsa_ctrl.bus.writing import write_all
from tsa_ctrl.errors import BusError

BOOT_TIMEOUT = 3.0  # s, from reset communication to the boot-up message
START_TIMEOUT = 2.0  # s, until a heartbeat says "operational"
_LEAST_ANSWERED = 0.8  # share of SYNCs that each node must answer before torque
_GONE = 3  # SYNCs at the end that a node did not answer


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


def prove(rig: Rig, period: float, cycles: int = 50) -> None:
    """SYNC at the period without any command: first cycles are slow ones, so none of them shall count in the loop.

    Raises BusError for a node that does not answer 80 % of `cycles` SYNCs or none of the last three, or that answers
    more than once, as two nodes of one id do.
    """
    nodes = [(axis.name, health) for axis in rig.axes for health in axis.image.nodes]
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
                f"(late {health.late}, wrong length {health.malformed}); check the bus load and the node's mapping"
            )
        if health.repeated - repeated > (1.0 - _LEAST_ANSWERED) * cycles:
            raise BusError(
                f"axis '{name}' {health}: sent {health.repeated - repeated} more PDOs than {cycles} SYNCs asked for; "
                "another node may have the same id"
            )


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
