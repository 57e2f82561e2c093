"""What a node must be before anything is written to it, and what must hold afterwards."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tsa_ctrl.bus.canopen import cia402, emcy, objects
from tsa_ctrl.bus.canopen.cia301 import Profile
from tsa_ctrl.bus.canopen.cia402 import Controlword, Mode, PowerState
from tsa_ctrl.bus.canopen.objects import Object, Write
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.drive.report import NodeReport
from tsa_ctrl.bus.drive.session import Session
from tsa_ctrl.bus.settings import AxisNodes, EncoderSettings, NodeSettings, Role
from tsa_ctrl.errors import BusError, UsageError

_MODE_TIMEOUT = 1.0  # s, until 0x6061 shows the mode written to 0x6060
_OFF_TIMEOUT = 1.0  # s, until a drive found enabled is off
_POLL = 0.01  # s, between two looks at an object that will change
_RATED_TOLERANCE = 0.005  # relative, of 0x6076 against the configuration

_IDENTITY = (objects.VENDOR_ID, objects.PRODUCT_CODE, objects.REVISION, objects.SERIAL_NUMBER)
_EXPECTED = {Role.DRIVE: Profile.DRIVE, Role.ENCODER: Profile.ENCODER, Role.TORQUE_SENSOR: Profile.TRANSDUCER}


@dataclass(frozen=True)
class Node:
    """One node of one axis, as configured."""

    axis: AxisNodes
    profile: DriveProfile
    role: Role
    settings: NodeSettings

    @property
    def name(self) -> str:
        return f"axis '{self.axis.name}' {self.role.value} node {self.settings.node_id}"


def check_identity(session: Session, node: Node, report: NodeReport) -> None:
    """Device type (0x1000) and identity (0x1018) are those of the configuration; raises BusError."""
    node_id = node.settings.node_id
    device_type = session.read(node_id, objects.DEVICE_TYPE)
    report.identity[objects.DEVICE_TYPE.name] = device_type
    expected = _EXPECTED[node.role]
    if device_type & 0xFFFF != expected.value:
        raise BusError(
            f"{node.name}: device type is 0x{device_type:08X}, wanted is CiA {expected.value} "
            f"(low word 0x{expected.value:04X}); another device has this node id: correct node_id"
        )
    for entry in _IDENTITY:
        value = session.read_if_there(node_id, entry)
        if value is not None:
            report.identity[entry.name] = value
    vendors = [node.settings.vendor_id]
    products = [node.settings.product_code]
    if node.role is Role.DRIVE:
        vendors.append(node.profile.identity.vendor_id)
    _compare(node, report, objects.VENDOR_ID, [value for value in vendors if value is not None][:1])
    given = [value for value in products if value is not None]
    _compare(node, report, objects.PRODUCT_CODE, given or _profile_products(node))


def _profile_products(node: Node) -> list[int]:
    return node.profile.identity.product_codes if node.role is Role.DRIVE else []


def _compare(node: Node, report: NodeReport, entry: Object, allowed: Sequence[int]) -> None:
    found = report.identity.get(entry.name)
    if allowed and found not in allowed:
        wanted = " or ".join(f"0x{value:08X}" for value in allowed)
        shown = "not there" if found is None else f"0x{found:08X}"
        raise BusError(
            f"{node.name}: {entry.name} is {shown}, wanted is {wanted}; "
            "this is another device than the configuration says: correct node_id or profile"
        )


def read_errors(session: Session, node: Node, report: NodeReport) -> None:
    """Note the error register (0x1001) and history (0x1003)."""
    node_id = node.settings.node_id
    register = session.read_if_there(node_id, objects.ERROR_REGISTER)
    if register:
        words = "+".join(name for bit, name in emcy.REGISTER_BITS if register & bit)
        report.notes.append(f"error register 0x{register:02X} ({words})")
    if session.read_if_there(node_id, objects.ERROR_HISTORY_COUNT):
        newest = session.read_if_there(node_id, objects.ERROR_HISTORY) or 0
        report.notes.append(f"newest remembered error 0x{newest & 0xFFFF:04X} ({emcy.text(newest & 0xFFFF)})")


def switch_off(session: Session, node: Node) -> None:
    """A drive must not be enabled while its PDOs are remapped."""
    node_id = node.settings.node_id
    on = (PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE)
    if cia402.decode(session.read(node_id, objects.STATUSWORD)) not in on:
        return
    session.write(node_id, objects.CONTROLWORD, Controlword.DISABLE_VOLTAGE)
    if not _poll(session, lambda: cia402.decode(session.read(node_id, objects.STATUSWORD)) not in on, _OFF_TIMEOUT):
        raise BusError(f"{node.name}: is enabled and does not switch off; cut its power")


def reset_fault(session: Session, node: Node, report: NodeReport) -> None:
    """On request: lead a drive found in fault out of it; the rising edge of bit 7, by SDO. Raises BusError."""
    node_id = node.settings.node_id
    faulty = (PowerState.FAULT, PowerState.FAULT_REACTION_ACTIVE)
    if cia402.decode(session.read(node_id, objects.STATUSWORD)) not in faulty:
        return
    code = session.read_if_there(node_id, objects.ERROR_CODE) or 0
    found = f"error 0x{code:04X} ({emcy.text(code)})"
    session.write(node_id, objects.CONTROLWORD, Controlword.DISABLE_VOLTAGE)
    session.write(node_id, objects.CONTROLWORD, Controlword.FAULT_RESET)
    if not _poll(session, lambda: cia402.decode(session.read(node_id, objects.STATUSWORD)) not in faulty, _OFF_TIMEOUT):
        raise BusError(f"{node.name}: {found} is still there and cannot be reset; remove its cause, and start again")
    session.write(node_id, objects.CONTROLWORD, Controlword.DISABLE_VOLTAGE)
    report.notes.append(f"was in fault: {found}; reset as asked")


def check_drive(session: Session, node: Node, report: NodeReport) -> None:
    """State, supported modes (0x6502), rated torque (0x6076) and reactions of a drive; raises BusError."""
    node_id = node.settings.node_id
    state = cia402.decode(session.read(node_id, objects.STATUSWORD))
    if state in (PowerState.FAULT, PowerState.FAULT_REACTION_ACTIVE):
        code = session.read_if_there(node_id, objects.ERROR_CODE) or 0
        report.notes.append(
            f"in fault: error 0x{code:04X} ({emcy.text(code)}); it must be reset before it can enable: --reset-faults"
        )
    if node.profile.has(objects.SUPPORTED_MODES):
        modes = session.read_if_there(node_id, objects.SUPPORTED_MODES)
        if modes is None:
            report.notes.append("does not say which modes it supports (0x6502)")
        elif not modes & cia402.CST_SUPPORTED:
            raise BusError(
                f"{node.name}: supported modes 0x{modes:08X} lack cyclic synchronous torque (bit 9); use another drive"
            )
    _check_rated_torque(session, node, report)


def _check_rated_torque(session: Session, node: Node, report: NodeReport) -> None:
    """0x6076 against the configuration: all torques are per mille of it."""
    if not node.profile.has(objects.RATED_TORQUE):
        report.notes.append("has no rated torque (0x6076) to compare with the configuration")
        return
    drive, unit = node.axis.drive, node.profile.units.rated_torque
    digits = session.read(node.settings.node_id, objects.RATED_TORQUE)
    found, wanted = digits * unit, drive.rated_torque
    if abs(found - wanted) <= max(_RATED_TOLERANCE * wanted, 0.5 * unit):
        return
    raise UsageError(
        f"{node.name}: rated torque is {digits} digits of {unit:g} N*m = {found:g} N*m, the configuration says "
        f"{wanted:g} N*m{rated_torque_hint(found, wanted)}; correct rated_torque, or the unit in the drive's profile"
    )


def rated_torque_hint(found: float, wanted: float) -> str:
    """The classic mistakes, when the ratio shows one."""
    if found <= 0.0:
        return ""
    ratio = found / wanted
    for factor, meaning in (
        (1000.0, "the drive counts in another power of ten: mN*m against uN*m or N*m"),
        (1e6, "the drive counts in another power of ten: uN*m against N*m"),
        (math.sqrt(2.0), "one is the peak value, the other the root mean square"),
    ):
        for candidate, sign in ((factor, ""), (1.0 / factor, "1/")):
            if abs(ratio / candidate - 1.0) < 0.02:
                name = "the root of 2" if factor < 2.0 else f"{factor:g}"
                return f" (a factor of {sign}{name}: {meaning})"
    return ""


def check_encoder(session: Session, encoder: EncoderSettings, name: str) -> None:
    """Resolution and range of an encoder (0x6001, 0x6002) are those of the configuration; raises UsageError."""
    for entry, wanted, key in (
        (objects.MEASURING_UNITS, encoder.counts_per_revolution, "counts_per_revolution"),
        (objects.TOTAL_RANGE, encoder.counts_range, "counts_range"),
    ):
        found = session.read_if_there(encoder.node_id, entry)
        wraps_at_32_bits = entry is objects.TOTAL_RANGE and wanted == 1 << 32 and found in (0, 0xFFFFFFFF)
        if found is not None and found != wanted and not wraps_at_32_bits:
            raise UsageError(f"{name}: {entry} is {found}, the configuration says {wanted}; correct {key}")


def confirm_mode(session: Session, node: Node) -> None:
    """0x6061 displays cyclic synchronous torque; raises BusError."""
    node_id = node.settings.node_id
    wanted = Mode.CYCLIC_SYNC_TORQUE
    if not _poll(session, lambda: session.read(node_id, objects.MODE_DISPLAY) == wanted, _MODE_TIMEOUT):
        found = session.read(node_id, objects.MODE_DISPLAY)
        raise BusError(
            f"{node.name}: mode of operation display is {found}, wanted is 10 (cyclic synchronous torque); "
            "check that the drive's motor and sensors are configured for it"
        )


def check_watchdog(node: Node, plan: Sequence[Write], report: NodeReport) -> None:
    """The drive stops by itself when this computer is gone; raises BusError unless that is waived."""
    there = {row.entry.key for row in report.rows if row.after is not None}
    watched = any(write.watchdog and write.entry.key in there for write in plan)
    reacts = objects.CONNECTION_LOSS.key in there
    if watched and reacts:
        return
    if watched and node.axis.drive.require_watchdog:
        raise BusError(
            f"{node.name}: has a watchdog, but no reaction to a lost connection (0x6007), so nobody knows what it does "
            "when this computer dies; use another drive, or try it (tsa verify-safety) with require_watchdog = false"
        )
    if watched:
        report.notes.append("has a watchdog, but its reaction (0x6007) is not known: try tsa verify-safety")
        return
    if node.axis.drive.require_watchdog:
        raise BusError(
            f"{node.name}: has neither a heartbeat consumer (0x1016) nor an RPDO event timer (0x1400:5), so it would "
            "go on when this computer dies; use another drive, or accept it with require_watchdog = false"
        )
    report.notes.append("has no watchdog: it would go on when this computer dies")


def _poll(session: Session, reached: Callable[[], bool], timeout: float) -> bool:
    end = session.clock() + timeout
    while not reached():
        if session.clock() > end:
            return False
        session.wait(_POLL)
    return True
