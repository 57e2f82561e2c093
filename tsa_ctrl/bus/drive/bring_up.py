"""Bring the nodes up as the CANopen master: boot, identity, errors, configuration, rated torque, start.

Each object of a plan is read first, written if it differs, and read back. Its previous value is kept, so that the
report shows each change. Nothing here applies torque or enables a drive. If a check fails before the first write, only
SDO reads have been sent. A later failure sends NMT commands to the nodes that were addressed.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from fractions import Fraction

from tsa_ctrl.bus.canopen import cia301, objects
from tsa_ctrl.bus.canopen.cia301 import COB_ID_INVALID, NmtCommand
from tsa_ctrl.bus.canopen.eds import check_plan
from tsa_ctrl.bus.canopen.objects import Object, Type, Write
from tsa_ctrl.bus.canopen.pdo import MAPPING_OFFSET, PDO_OFFSET, Pdo, communication_of
from tsa_ctrl.bus.drive import budget
from tsa_ctrl.bus.drive.checks import (
    COUNTED_RPDOS,
    READ_ONLY,
    Node,
    NodeReport,
    Report,
    Row,
    check_drive,
    check_encoder,
    check_identity,
    check_torque_path,
    check_watchdog,
    confirm_mode,
    find_inputs,
    is_on,
    read_errors,
    reset_fault,
    switch_off,
)
from tsa_ctrl.bus.drive.network import axes_of, check_node_ids, layout_of
from tsa_ctrl.bus.drive.plan import drive_plan, sensor_plan
from tsa_ctrl.bus.drive.profile import PER_MILLE, DriveProfile, drive_scale
from tsa_ctrl.bus.drive.session import ABSENT, SdoRefusedError, Session, another_master, release_heartbeat
from tsa_ctrl.bus.settings import AxisNodes, BusSettings, EncoderSettings, Role, TorqueSensorSettings
from tsa_ctrl.bus.wire.bus import Bus, wire_of
from tsa_ctrl.errors import BusError, StoppedError, TsaError, UsageError

_HIGHEST_NODE = 127  # largest node id

Cure = Callable[[Object, int | None], str]


def write_all(
    session: Session, node_id: int, name: str, plan: Sequence[Write], cure: Cure, notes: list[str] | None = None
) -> list[Row]:
    """Write a plan in order, read each object before and after, and return one row per object.

    PDOs and the identifier of emergencies can be changed only while disabled. If all their objects have the required
    values already, they are not written, because many nodes reject a change.

    Args:
        session: open session.
        node_id: node that is written to.
        name: name of the node in messages.
        plan: writes in order.
        cure: returns the remedy for an object that the node rejects with an abort code, or (None) does not store.
        notes: receives the tolerated deviations.

    Raises:
        BusError: the node rejects an object or does not store its value.
    """
    rows: dict[tuple[int, int], Row] = {}
    settled = _settled(session, node_id, plan, rows)
    for write in plan:
        if write.entry.index in settled:
            continue
        entry = write.entry
        before: int | None = None
        try:
            before = session.read(node_id, entry)
            wanted = write.value | before & write.kept
            if write.rated is not None:
                wanted = write.value * session.read(node_id, write.rated) // PER_MILLE
            if before != wanted or write.entry.name == objects.MODE.name:
                session.write(node_id, entry, wanted)
            after = session.read(node_id, entry)
        except SdoRefusedError as error:
            if error.code in ABSENT and write.optional:
                rows[entry.key] = Row(entry, None, None)
                continue
            if error.code in READ_ONLY and before is not None and before in write.fine:
                rows[entry.key] = Row(entry, before, before)
                if notes is not None:
                    notes.append(f"{entry} cannot be written; its value {entry.shown(before)} is also sufficient")
                continue
            holds = "" if before is None else f"; it holds {entry.shown(before)}"
            raise BusError(f"{name}: {error}{holds}; {cure(entry, error.code)}") from None
        if after != wanted:
            shown, kept = entry.shown(wanted), entry.shown(after)
            raise BusError(f"{name}: {entry}: wrote {shown}, read back {kept}; {cure(entry, None)}")
        first = rows.get(entry.key)
        rows[entry.key] = Row(entry, before if first is None else first.before, after)
    return list(rows.values())


def _settled(session: Session, node_id: int, plan: Sequence[Write], rows: dict[tuple[int, int], Row]) -> set[int]:
    """Return the indices (PDOs and EMCY) whose objects all have the planned values, and add a row for each object.

    The communication parameters of a PDO are included only if its mapping needs no change.
    """
    last: dict[tuple[int, int], Write] = {write.entry.key: write for write in plan}
    settled: set[int] = set()
    for index in sorted({key[0] for key in last}):
        if index == objects.EMCY_COB_ID.index or communication_of(index) is not None:
            found = _as_wanted(session, node_id, [write for key, write in last.items() if key[0] == index])
            if found is not None:
                settled.add(index)
                rows.update({row.entry.key: row for row in found})
    for index in [index for index in settled if communication_of(index) == index]:
        mapping = index + MAPPING_OFFSET
        if mapping in {key[0] for key in last} and mapping not in settled:
            settled.discard(index)  # the PDO must be disabled before its mapping can be changed
    return settled


def _as_wanted(session: Session, node_id: int, writes: Sequence[Write]) -> list[Row] | None:
    """Return rows if each object has its planned or an equivalent value, or may be absent; otherwise None."""
    rows = []
    for write in writes:
        try:
            found = session.read_if_there(node_id, write.entry)
        except SdoRefusedError:
            return None
        if found is None and not write.optional:
            return None
        if found is not None and found != write.value | found & write.kept and found not in write.fine:
            return None
        rows.append(Row(write.entry, found, found))
    return rows


def with_consumer(session: Session, node_id: int, plan: Sequence[Write], host: int) -> list[Write]:
    """Return the plan with a suitable entry of 0x1016: one that already holds our node id, otherwise an unused one."""
    if not any(write.entry.key == objects.HEARTBEAT_CONSUMER.key for write in plan):
        return list(plan)
    count = session.read_if_readable(node_id, objects.HEARTBEAT_CONSUMERS) or 1
    entries = [replace(objects.HEARTBEAT_CONSUMER, subindex=number) for number in range(1, count + 1)]
    found = {entry: session.read_if_readable(node_id, entry) for entry in entries}
    held = {entry: value for entry, value in found.items() if value is not None}
    ours = [entry for entry, value in held.items() if value >> 16 & 0x7F == host]
    free = [entry for entry, value in held.items() if not _supervised(value)]
    chosen = [*ours, *free, objects.HEARTBEAT_CONSUMER][0]
    return [
        replace(write, entry=chosen) if write.entry.key == objects.HEARTBEAT_CONSUMER.key else write for write in plan
    ]


def _supervised(value: int) -> int:
    """Return the node id that an entry of 0x1016 supervises; 0 if it is unused."""
    node_id = value >> 16 & 0xFF
    return node_id if value & 0xFFFF and node_id <= _HIGHEST_NODE else 0


def check_consumer(session: Session, node: Node, plan: Sequence[Write], host: int) -> None:
    """Raise BusError if the plan would overwrite an entry of 0x1016 with which the node supervises another node."""
    for write in plan:
        if write.entry.index != objects.HEARTBEAT_CONSUMER.index:
            continue
        other = _supervised(session.read_if_readable(node.node_id, write.entry) or 0)
        if other not in (0, host):
            raise BusError(
                f"{node.name}: no entry of its heartbeat consumer (0x1016) is free: {write.entry} supervises node "
                f"{other}; set an entry to 0 with the maker's tool, or write absent = "
                f'["{objects.HEARTBEAT_CONSUMER.name}"] in {node.profile_file}'
            )


def whole_plan(
    session: Session, node_id: int, plan: Sequence[Write], slot: int, profile: DriveProfile, host: int
) -> list[Write]:
    """Return the plan of a drive with the writes that depend on the objects that it has; this function only reads."""
    return [
        *further_rpdos(session, node_id, slot, profile.rpdo_count + 1),
        *with_consumer(session, node_id, plan, host),
    ]


def further_rpdos(session: Session, node_id: int, slot: int, first: int) -> list[Write]:
    """Return writes that disable each RPDO of a drive that the plan does not cover.

    Another tool may have mapped a target torque or a torque offset into one of them.

    Args:
        session: open session; this function only reads.
        node_id: node id of the drive.
        slot: place of the axis in its device.
        first: number of the first RPDO that the plan does not cover.
    """
    writes = []
    for number in range(first, PDO_OFFSET + 1):
        entry = Pdo(number, True, ()).of(slot).communication(1, Type.U32, "COB-ID")
        found = session.upload_if_there(node_id, entry)
        if found is None and number > COUNTED_RPDOS:
            break  # the drive has no further ones
        if found is not None and not entry.decode(found) & COB_ID_INVALID:
            writes.append(Write(entry, entry.decode(found) | COB_ID_INVALID))
    return writes


_TURNED = ((0x80, "position"), (0x40, "velocity"), (0x20, "torque"))  # bits of 0x607E that reverse a sign


def check_signs(session: Session, node: Node) -> None:
    """Raise UsageError if a drive's polarity or its counts per revolution differ from the configuration.

    Another tool may have changed 0x607E, 0x608F, 0x6091 or 0x6092 since the signs were measured. A wrong sign makes the
    joint push where it should yield. Only objects that the drive has are compared, and none is written here.
    """
    _check_polarity(session, node)
    _check_counts(session, node)


def _check_polarity(session: Session, node: Node) -> None:
    written = any(extra.index == objects.POLARITY.index for extra in node.profile.extra)
    if written or node.axis.drive.polarity is not None:
        return
    found = _look(session, node, objects.POLARITY)
    turned = [name for bit, name in _TURNED if found is not None and found & bit]
    if turned:
        raise UsageError(
            f"{node.name}: polarity (0x607E) is 0x{found:02X}, the drive reverses the sign of {' and '.join(turned)}; "
            f"write polarity = 0x{found:02X} in [axis.drive] if torque_sign and position_sign were determined with it, "
            "or write polarity = 0 and determine the signs again"
        )


def _check_counts(session: Session, node: Node) -> None:
    """Raise UsageError if the counts per revolution of the motor differ from the configuration.

    A position is in encoder increments (0x608F), or in units of the feed constant (0x6092) after the gear (0x6091).
    """
    increments = _share(session, node, objects.ENCODER_INCREMENTS, objects.ENCODER_REVOLUTIONS)
    gear = _share(session, node, objects.GEAR_MOTOR, objects.GEAR_SHAFT) or Fraction(1)
    feed = _share(session, node, objects.FEED, objects.FEED_SHAFT)
    wanted = node.axis.drive.counts_per_revolution
    if gear != 1 and (feed is None or feed / gear != wanted):
        raise UsageError(
            f"{node.name}: its gear ratio (0x6091) is {gear}, so the scale of its positions is unknown; set it "
            f'to 1 with the maker\'s tool, or write absent = ["{objects.GEAR_MOTOR.name}"] in {node.profile_file} if '
            "0x6064 and 0x6071 still refer to the motor, and verify counts_per_revolution in [axis.drive]"
        )
    known = [float(value) for value in (increments, None if feed is None else feed / gear) if value is not None]
    if known and wanted not in known:
        shown = " or ".join(f"{value:g}" for value in dict.fromkeys(known))
        raise UsageError(
            f"{node.name}: it has {shown} counts per motor revolution (0x608F, 0x6092), but the configuration has "
            f'{wanted}; correct counts_per_revolution in [axis.drive], or write absent = ["'
            f'{objects.ENCODER_INCREMENTS.name}", "{objects.FEED.name}"] in {node.profile_file} if its 0x6064 has '
            "another unit"
        )


def _share(session: Session, node: Node, first: Object, second: Object) -> Fraction | None:
    """Return the ratio of two objects, or None if the drive lacks one of them or one of them is 0."""
    above, below = _look(session, node, first), _look(session, node, second)
    return Fraction(above, below) if above and below else None


def _look(session: Session, node: Node, entry: Object) -> int | None:
    return node.look(session, entry) if node.profile.has(entry) else None


def check_twins(nodes: Sequence[Node], reports: Sequence[NodeReport]) -> None:
    """Raise UsageError unless the configuration holds the serial numbers of all drives of the same model.

    Drives of one model differ only in their serial numbers, and exchanged node ids would exchange the joints. If their
    serial numbers are missing or equal, the drives cannot be distinguished, and a note is added to their reports.
    """
    drives = {node.node_id: (node, report) for node, report in zip(nodes, reports, strict=True) if _is_drive(node)}
    for (one, first), (other, second) in itertools.combinations(drives.values(), 2):
        if _model(first) != _model(second):
            continue
        serials = [report.identity.get(objects.SERIAL_NUMBER.name) for report in (first, second)]
        if None in serials or serials[0] == serials[1]:
            for report in (first, second):
                report.notes.append(
                    "another drive of this model is on the bus, and no serial number (0x1018:4) distinguishes them"
                )
        elif one.settings.serial_number is None or other.settings.serial_number is None:
            raise UsageError(
                f"{one.name} and {other.name} are drives of one model: swapped node ids would swap the joints; write "
                f"serial_number = {serials[0]} and serial_number = {serials[1]} into their [axis.drive] tables, or run "
                "tsa doctor CONTROLLER.toml --serial-numbers"
            )


def _is_drive(node: Node) -> bool:
    return node.role is Role.DRIVE


def _model(report: NodeReport) -> tuple[int | None, ...]:
    return tuple(report.identity.get(entry.name) for entry in (objects.VENDOR_ID, objects.PRODUCT_CODE))


START_TIMEOUT = 2.0  # s until a heartbeat reports "operational"

Tell = Callable[[str], None]
Identify = Callable[[AxisNodes, Role, int | None], None]  # axis, node, 0x1018:4 (None: absent); raises to reject it


def bring_up(
    bus: Bus,
    settings: BusSettings,
    axes: Sequence[AxisNodes],
    profiles: Sequence[DriveProfile],
    period: float,
    reset_faults: bool = False,
    resets_later: bool = False,
    tell: Tell = lambda stage: None,
    stopped: Callable[[], str | None] = lambda: None,
    identify: Identify = lambda axis, role, serial_number: None,
) -> Report:
    """Configure and start all nodes of `axes`; on return they are operational and the drives are disabled.

    Args:
        period: SYNC period, s.
        reset_faults: True resets drives found in fault. Otherwise they stay in fault, unless the loop `resets_later`.
        tell: receives a text for each stage of the bring-up.
        stopped: returns a reason if the bring-up must end, otherwise None.
        identify: called for each node before anything is written to it; it may reject the node.

    Raises:
        StoppedError: `stopped` returned a reason.
        UsageError: the configuration is wrong (load, contradictions, rated torque).
        BusError: the bus or a node failed; the message ends with the emergencies of the nodes.
    """
    budget.check(settings, axes_of(settings, axes), 1.0 / period)  # checks the first bus if there are several
    check_node_ids(settings, axes)
    nodes = list(_nodes(axes, profiles))
    plans = [_plan(node, settings, period) for node in nodes]
    notes = [
        check_plan(node.profile.eds, plan) if node.role is Role.DRIVE else []
        for node, plan in zip(nodes, plans, strict=True)
    ]
    with Session(bus, settings, stopped) as session:
        for node in nodes:
            session.be_patient(node.node_id, node.answer_timeout)
        session.guard([node.node_id for node in nodes if node.is_guarded])
        try:
            tell("listening for another master on the bus")
            _be_alone(bus, session, nodes)
            there = _look_at(session, nodes, tell, identify)
            session.begin_heartbeat()
            _boot(bus, session, nodes, there, tell)
            reports = [
                NodeReport(node.name, node.node_id, notes=noted) for node, noted in zip(nodes, notes, strict=True)
            ]
            for node, report in zip(nodes, reports, strict=True):
                check_identity(session, node, report)
                identify(node.axis, node.role, report.serial_number)
            check_twins(nodes, reports)
            for node, plan, report in zip(nodes, plans, reports, strict=True):
                tell(f"configuring {node.name}")
                _configure(session, node, plan, settings, report, reset_faults, resets_later)
            _start(bus, session, nodes, tell)
            for node, report in zip(nodes, reports, strict=True):
                report.notes += [f"reported during the bring-up: {found}" for found in session.emcys(node.node_id)]
        except BaseException as error:
            if isinstance(error, TsaError) and not isinstance(error, StoppedError):
                error.args = (f"{error}{_what_they_said(session, nodes)}",)
            with contextlib.suppress(TsaError):  # only the first error is reported
                _leave(session, nodes, settings)
            raise
    return Report(tuple(reports))


def _nodes(axes: Sequence[AxisNodes], profiles: Sequence[DriveProfile]) -> Iterable[Node]:
    for axis, profile in zip(axes, profiles, strict=True):
        for role, node in axis.nodes():
            yield Node(axis, profile, role, node)


def _plan(node: Node, settings: BusSettings, period: float) -> list[Write]:
    if node.role is Role.DRIVE:
        scale = drive_scale(node.axis.drive, node.profile, f"axis '{node.axis.name}'")
        return drive_plan(node.axis, node.profile, scale, settings, period)
    assert isinstance(node.settings, EncoderSettings | TorqueSensorSettings)
    return sensor_plan(node.settings, period)


def _be_alone(bus: Bus, session: Session, nodes: Sequence[Node]) -> None:
    """Raise BusError if another master is active; stop the SYNC of a drive if its profile permits that."""
    rpdos = [layout_of(node.axis.drive).rpdo_id for node in nodes if node.role is Role.DRIVE]
    heard = session.listen(rpdos)
    if heard != {cia301.SYNC}:
        if heard:
            raise BusError(another_master(bus.name, heard))
        return
    for node in nodes:
        if node.role is Role.DRIVE and node.profile.produces_sync:
            found = session.ask(node.node_id, objects.SYNC_COB_ID)
            if found is not None and found & cia301.PRODUCES_SYNC:
                session.write(node.node_id, objects.SYNC_COB_ID, found & ~cia301.PRODUCES_SYNC)
    session.alone(rpdos)


def _look_at(session: Session, nodes: Sequence[Node], tell: Tell, identify: Identify) -> set[int]:
    """Return the ids of the nodes that already answer; reject a wrong device before anything is written.

    An enabled drive is switched off first, because a reset would disarm its watchdogs and leave it enabled.
    """
    there: set[int] = set()
    silent: set[int] = set()
    seen: list[tuple[Node, NodeReport]] = []
    for node in nodes:
        if node.node_id in silent:
            continue
        tell(f"reading the identity of {node.name}")
        if session.ask(node.node_id, objects.DEVICE_TYPE) is None:
            silent.add(node.node_id)  # off, booting or stopped: checked after its reset
            continue
        there.add(node.node_id)
        report = NodeReport(node.name)
        check_identity(session, node, report)
        identify(node.axis, node.role, report.serial_number)
        seen.append((node, report))
    check_twins([node for node, _ in seen], [report for _, report in seen])
    for node in nodes:
        if node.node_id in there and node.role is Role.DRIVE:
            switch_off(session, node)
    return there


def _boot(bus: Bus, session: Session, nodes: Sequence[Node], there: set[int], tell: Tell) -> None:
    ids = {node.node_id for node in nodes}
    longest = {node_id: max(node.boot_timeout for node in nodes if node.node_id == node_id) for node_id in ids}
    waited = 0.0
    missing = session.boot(ids, 0.0)
    for timeout in sorted(set(longest.values())):
        names = ", ".join(node.name for node in nodes if node.node_id in missing)
        tell(f"waiting for the boot-up of {names}, {timeout:g} s at most")
        missing = session.booted(missing, timeout - waited)
        waited = timeout
        late = {node_id for node_id in missing if longest[node_id] <= timeout}
        if late:
            raise BusError(_not_booted(bus, session, [node for node in nodes if node.node_id in late], there))


def _not_booted(bus: Bus, session: Session, late: Sequence[Node], there: set[int]) -> str:
    """Return the message about nodes that did not boot: slow nodes, missing nodes, or a bus without any node."""
    node = late[0]
    name = wire_of(bus, node.node_id).name
    names = ", ".join(node.name for node in late)
    if any(node.node_id in there for node in late):
        where = "its profile or [axis.drive]" if node.role is Role.DRIVE else "its table in the configuration"
        return (
            f"{name}: {names} answered before the reset but did not boot up within {node.boot_timeout:g} s; "
            f"the boot-up is slow: increase boot_timeout in {where}"
        )
    heard = ", ".join(str(node_id) for node_id in sorted(session.heard)) or "no node"
    return (
        f"{name}: no answer from {names} within {node.boot_timeout:g} s (heard: {heard}); "
        "check power, wiring, bit rate and node_id, or increase boot_timeout if it is only slow"
    )


def _configure(
    session: Session,
    node: Node,
    plan: Sequence[Write],
    settings: BusSettings,
    report: NodeReport,
    reset_faults: bool,
    resets_later: bool,
) -> None:
    read_errors(session, node, report)
    if node.role is Role.DRIVE:
        switch_off(session, node)
        if reset_faults:
            reset_fault(session, node, report)
        check_drive(session, node, report, resets_later)
        check_signs(session, node)
        find_inputs(session, node, report)
        slot, host = node.axis.drive.slot, settings.host_node_id
        plan = whole_plan(session, node.node_id, plan, slot, node.profile, host)
        check_consumer(session, node, plan, host)
    if isinstance(node.settings, EncoderSettings):
        check_encoder(session, node.settings, node.name)
    report.rows = write_all(session, node.node_id, node.name, plan, node.cure, report.notes)
    if node.role is Role.DRIVE:
        rows, noted = check_torque_path(session, node, {row.entry.key for row in report.rows})
        report.rows += rows
        report.notes += noted
        confirm_mode(session, node, "written")
        check_watchdog(node, plan, report)


def _start(bus: Bus, session: Session, nodes: Sequence[Node], tell: Tell) -> None:
    names = ", ".join(node.name for node in nodes)
    tell(f"waiting for {names} to become operational")
    missing = session.start({node.node_id for node in nodes}, START_TIMEOUT)
    if missing:
        late = [node for node in nodes if node.node_id in missing]
        guarded = any(node.role is Role.DRIVE and not node.is_guarded for node in late)
        hint = (
            f', or write supervision = "guarding" in {late[0].profile_file} if it has no heartbeat' if guarded else ""
        )
        name = wire_of(bus, late[0].node_id).name
        raise BusError(
            f"{name}: {', '.join(node.name for node in late)} did not become operational within "
            f"{START_TIMEOUT:g} s; power-cycle it and start again{hint}"
        )
    for node in nodes:
        if node.role is Role.DRIVE and node.profile.mode_shows == "operational":
            confirm_mode(session, node, "operational")


def _what_they_said(session: Session, nodes: Sequence[Node]) -> str:
    """Return the last emergency of each node in this session, as the end of an error message."""
    names = {node.node_id: node.name for node in nodes}
    last = [f"{name} sent {session.emcys(node_id)[-1]}" for node_id, name in names.items() if session.emcys(node_id)]
    return f"; meanwhile {', and '.join(last)}" if last else ""


def _leave(session: Session, nodes: Sequence[Node], settings: BusSettings) -> None:
    """Disarm the addressed nodes and set them pre-operational; a drive that is still on gets NMT stop instead."""
    for node in nodes:
        if node.node_id not in session.touched:
            continue
        command = NmtCommand.PRE_OPERATIONAL
        if node.role is Role.DRIVE:
            try:
                if is_on(session, node):
                    command = NmtCommand.STOP  # triggers its reaction to a lost connection (0x6007)
                else:
                    release_heartbeat(session, node.node_id, settings.host_node_id)
            except TsaError:
                command = NmtCommand.STOP
        session.nmt(command, node.node_id)
