"""Check a node before and after the writes, name remedies for rejected objects, and report limits of its torque."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

from tsa_ctrl.bus.canopen import cia301, cia402, objects
from tsa_ctrl.bus.canopen.cia301 import Profile
from tsa_ctrl.bus.canopen.cia402 import OFFSETS, TORQUE_PATH, Controlword, Effect, Influence, Mode, PowerState
from tsa_ctrl.bus.canopen.objects import SERIAL_NUMBER, Object, Write
from tsa_ctrl.bus.drive.profile import PER_MILLE, REACTIONS, DriveProfile, drive_scale
from tsa_ctrl.bus.drive.session import ABSENT, ANSWER_TIMEOUT, SdoRefusedError, Session
from tsa_ctrl.bus.settings import AxisNodes, DriveSettings, EncoderSettings, NodeSettings, Role
from tsa_ctrl.errors import BusError, UsageError

# Remedies: the line to write, and its file, for each object that a node rejects.

READ_ONLY = frozenset({0x06010000, 0x06010002})
_STATE = frozenset({0x08000022, 0x08000021, 0x08000020, 0x06060000})
_NOT_MAPPABLE = frozenset({0x06040041, 0x06040042})
COUNTED_RPDOS = 4  # limit of rpdo_count in a profile

_SETTINGS = {  # key of the controller file that determines the value of an object
    objects.HEARTBEAT_PRODUCER.key: "heartbeat_period in [axis.drive]",
    objects.HEARTBEAT_CONSUMER.key: "host_timeout in [axis.drive]",
    objects.LIFE_TIME_FACTOR.key: "host_timeout in [axis.drive]",
    objects.GUARD_TIME.key: "host_heartbeat_period in [bus]",
    objects.RPDO_EVENT_TIMER.key: "rpdo_timeout in [axis.drive]",
    objects.CONNECTION_LOSS.key: "connection_loss in [axis.drive]",
    objects.INTERPOLATION_PERIOD.key: "rate in [controller]",
    objects.INTERPOLATION_EXPONENT.key: "rate in [controller]",
    objects.MAX_TORQUE.key: "torque in [axis.limits]",
    objects.POLARITY.key: "polarity in [axis.drive]",
    objects.MAX_MOTOR_SPEED.key: "motor_over_speed in [axis.limits], or [units] max_speed in {profile}",
}
_SPECIAL = {  # objects for which `absent` alone is not enough
    objects.HEARTBEAT_PRODUCER.key: 'write supervision = "guarding" in {profile} if it supports only node guarding',
    **dict.fromkeys(
        (entry.key for entry in OFFSETS),
        "only 0 is allowed, because the drive adds this object to the command and the motor would turn at command 0; "
        "set it to 0 and store it with the maker's tool, and remove it from the drive's own PDOs and programs",
    ),
    objects.VELOCITY_UNIT.key: 'write absent = ["SI unit velocity"] and the unit of its 0x606C as [units] velocity in '
    '{profile}, or velocity_source = "position" in [axis.drive]',
    objects.MAX_TORQUE.key: 'write absent = ["max torque"] and [torque_clamp] in {profile}: the object that limits the '
    "torque instead, and the object that holds its value at rated torque",
    objects.MODE.key: "set up its motor and sensors for torque with the maker's tool, or use another drive: this one "
    "does not accept cyclic synchronous torque mode (10) as it is",
    objects.INTERPOLATION_PERIOD.key: "choose a rate in [controller] whose period it accepts, or write absent = "
    '["interpolation period", "interpolation period exponent"] in {profile} if it needs none for torque',
    objects.INTERPOLATION_EXPONENT.key: "choose a rate in [controller] whose period is in whole ms (1000, 500, "
    '250, 200, 125, 100 Hz), or write absent = ["interpolation period", "interpolation period exponent"] in {profile}',
}


def profile_of(drive: DriveSettings) -> str:
    """Return the name of the drive's profile file for a remedy."""
    if drive.profile == "generic":
        return "a separate profile (write one with tsa drive probe, and give it as profile in [axis.drive])"
    return drive.profile if drive.profile.endswith(".toml") else f"drives/{drive.profile}.toml"


def cure(entry: Object, node: NodeSettings, profile: DriveProfile, code: int | None = None) -> str:
    """Return the remedy for an object that a node rejected with this abort code; None: accepted, but not stored."""
    if not isinstance(node, DriveSettings):
        return "check that this is the configured sensor: node_id, vendor_id, product_code"
    plain = entry.of(2 - node.slot) if node.slot > 1 else entry
    text = _advice(plain, node, profile, code).format(profile=profile_of(node))
    if code in _STATE:
        return (
            "close the maker's tool, unlock the drive, power-cycle it (its present state does not permit this "
            f"write); if that does not help, {text}"
        )
    return text


def _advice(entry: Object, node: DriveSettings, profile: DriveProfile, code: int | None) -> str:
    key = entry.key
    if entry.index in range(0x1400, 0x1C00):
        return _of_a_pdo(entry, code)
    reaction = REACTIONS.get(entry)
    if reaction is not None:
        return f'write {reaction} = "keep", or a value that it accepts, under [reactions] in {{profile}}'
    special, setting = _SPECIAL.get(key), _SETTINGS.get(key)
    if setting is not None and code not in ABSENT and code not in READ_ONLY:
        return f"correct {setting}: the drive does not accept this value" + (
            "" if special is None else f"; or {special}"
        )
    return special or _absent(entry)


def _of_a_pdo(entry: Object, code: int | None) -> str:
    received = entry.index in range(0x1400, 0x1800)
    number = entry.index % 0x40 + 1
    if received and number > 1:
        advice = "disable this RPDO and store that with the maker's tool: only this controller may command torque"
        fewer = f"; if the drive lacks this RPDO, write rpdo_count = {number - 1} in {{profile}}"
        return advice + (fewer if number <= COUNTED_RPDOS else "")
    if number > 2:
        return f"write tpdo_count = {number - 1} in {{profile}}: this PDO is unused and only had to be disabled"
    if entry.subindex == 5 and received:
        name = objects.RPDO_EVENT_TIMER.name
        return f'correct rpdo_timeout in [axis.drive], or write absent = ["{name}"] in {{profile}}'
    if "mapped object" in entry.name and code in _NOT_MAPPABLE | ABSENT and not received and number == 2:
        return (
            f'write absent = ["{objects.ERROR_CODE.name}"] in {{profile}} if it has no 0x603F; otherwise use other '
            "firmware: it cannot map the objects that this controller needs into one PDO"
        )
    if code in _NOT_MAPPABLE:
        return "use other firmware: it cannot map the objects that this controller needs into one PDO"
    return (
        "map this PDO as required with the maker's tool, store it, and start again: correct objects are not written, "
        "and this drive rejects changes"
    )


def _absent(entry: Object) -> str:
    known = {known.key: known.name for known in objects.TABLE}
    name = known.get(entry.key)
    if name is None:
        return f"correct or remove the [[extra]] '{entry.name}' in {{profile}}"
    return f'write absent = ["{name}"] in {{profile}}'


@dataclass(frozen=True)
class Row:
    """An object of a plan, with its values before and after. `after` is None if the node lacks the object."""

    entry: Object
    before: int | None
    after: int | None

    @property
    def changed(self) -> bool:
        return self.after is not None and self.before != self.after

    def __str__(self) -> str:
        if self.after is None:
            return f"{self.entry}: absent"
        before = "?" if self.before is None else self.entry.shown(self.before)
        after = self.entry.shown(self.after)
        return f"{self.entry}: {before} -> {after}" if self.changed else f"{self.entry}: {after}"


@dataclass
class NodeReport:
    """The findings at one node, and the objects written to it."""

    name: str  # axis, role and node id
    node_id: int = 0
    identity: dict[str, int] = field(default_factory=dict)
    rows: list[Row] = field(default_factory=list)
    digital_inputs: Object | None = None  # 0x60FD, if the drive has it
    notes: list[str] = field(default_factory=list)  # stored errors of the node, and checks that were not possible

    @property
    def serial_number(self) -> int | None:
        """Return 0x1018:4; None if the node lacks it."""
        return self.identity.get(SERIAL_NUMBER.name)

    def lines(self) -> list[str]:
        """Return the report as text: identity, notes, and each object that was changed."""
        identity = ", ".join(f"{name} {value:#x}" for name, value in self.identity.items())
        changed = [str(row) for row in self.rows if row.changed]
        absent = [row.entry.name for row in self.rows if row.after is None]
        lines = [f"{self.name}: {identity}; {len(self.rows) - len(absent)} objects verified, {len(changed)} changed"]
        lines += [f"  {text}" for text in [*self.notes, *changed]]
        if absent:
            lines.append(f"  absent: {', '.join(absent)}")
        return lines


@dataclass(frozen=True)
class Report:
    """The reports of all nodes."""

    nodes: tuple[NodeReport, ...]

    def lines(self) -> list[str]:
        return [line for node in self.nodes for line in node.lines()]


BOOT_TIMEOUT = 3.0  # s, from reset communication to the boot-up message of a sensor
_SEVERAL = 0xFFFF  # in either word of the device type: the device has several axes
_MODE_TIMEOUT = 1.0  # s, until 0x6061 shows the mode written to 0x6060
_OFF_TIMEOUT = 1.0  # s, until a drive that was found enabled is disabled
_POLL = 0.01  # s, between two reads of an object that is about to change
_RATED_TOLERANCE = 0.005  # relative difference between 0x6076 and the configuration

_ON = (PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE)
_FAULTY = (PowerState.FAULT, PowerState.FAULT_REACTION_ACTIVE)
_IDENTITY = (objects.VENDOR_ID, objects.PRODUCT_CODE, objects.REVISION, objects.SERIAL_NUMBER)
_EXPECTED = {Role.DRIVE: Profile.DRIVE, Role.ENCODER: Profile.ENCODER, Role.TORQUE_SENSOR: Profile.TRANSDUCER}


@dataclass(frozen=True)
class Node:
    """One node of an axis, with its settings."""

    axis: AxisNodes
    profile: DriveProfile
    role: Role
    settings: NodeSettings

    @property
    def node_id(self) -> int:
        return self.settings.node_id

    @property
    def name(self) -> str:
        slot = self.axis.drive.slot
        return f"axis '{self.axis.name}' {self.role.value} node {self.node_id}" + (
            f" slot {slot}" if self.role is Role.DRIVE and slot > 1 else ""
        )

    @property
    def boot_timeout(self) -> float:
        """Return the time from a reset to the boot-up, s."""
        return self._patience(self.settings.boot_timeout, self.profile.boot_timeout, BOOT_TIMEOUT)

    @property
    def answer_timeout(self) -> float:
        """Return the longest time until an SDO answer, s."""
        return self._patience(self.settings.answer_timeout, self.profile.answer_timeout, ANSWER_TIMEOUT)

    def _patience(self, given: float | None, of_profile: float, default: float) -> float:
        if given is not None:
            return given
        return of_profile if self.role is Role.DRIVE else default

    @property
    def is_guarded(self) -> bool:
        """Return True if the drive is supervised by node guarding, because it has no heartbeat."""
        return self.role is Role.DRIVE and self.profile.supervision == "guarding"

    @property
    def profile_file(self) -> str:
        return profile_of(self.axis.drive)

    def cure(self, entry: Object, code: int | None) -> str:
        """Return the remedy for an object that the node rejects."""
        return cure(entry, self.settings, self.profile, code)

    def read(self, session: Session, entry: Object) -> int:
        """Return the value of an object of this axis; raise BusError if the node lacks it."""
        return session.read(self.node_id, entry.of(self.axis.drive.slot))

    def look(self, session: Session, entry: Object) -> int | None:
        """Return the value of an object of this axis; None if the node lacks it."""
        return session.read_if_there(self.node_id, entry.of(self.axis.drive.slot))

    def write(self, session: Session, entry: Object, value: int) -> None:
        """Write an object of this axis; raise BusError if the node rejects it."""
        session.write(self.node_id, entry.of(self.axis.drive.slot), value)

    def state(self, session: Session) -> PowerState:
        """Return the power state of the drive."""
        return cia402.decode(self.read(session, objects.STATUSWORD))


def check_identity(session: Session, node: Node, report: NodeReport) -> None:
    """Raise BusError if device type (0x1000) or identity (0x1018) differ from the configuration."""
    device_type = session.read(node.node_id, objects.DEVICE_TYPE)
    report.identity[objects.DEVICE_TYPE.name] = device_type
    _check_device_type(session, node, device_type)
    unreadable: list[Object] = []
    for entry in _IDENTITY:
        value = session.read_if_readable(node.node_id, entry, unreadable)
        if value is not None:
            report.identity[entry.name] = value
    report.notes += [f"{entry} exists, but the node rejects a read" for entry in unreadable]
    settings, identity = node.settings, node.profile.identity
    is_drive = node.role is Role.DRIVE
    vendor = settings.vendor_id if settings.vendor_id is not None or not is_drive else identity.vendor_id
    products = [settings.product_code] if settings.product_code is not None else identity.product_codes
    _compare(node, report, objects.VENDOR_ID, [] if vendor is None else [vendor])
    _compare(node, report, objects.PRODUCT_CODE, products if is_drive or settings.product_code is not None else [])
    _compare(node, report, objects.SERIAL_NUMBER, [] if settings.serial_number is None else [settings.serial_number])


def _check_device_type(session: Session, node: Node, found: int) -> None:
    expected = _EXPECTED[node.role]
    if found & 0xFFFF == expected.value and found >> 16 != _SEVERAL:
        return
    if node.role is Role.DRIVE and _SEVERAL in (found & 0xFFFF, found >> 16):
        ours = node.look(session, objects.AXIS_DEVICE_TYPE)
        if ours is None or ours & 0xFFFF == expected.value:
            return
        found = ours
    raise BusError(
        f"{node.name}: device type is 0x{found:08X} but must be CiA {expected.value} "
        f"(low word 0x{expected.value:04X}); this node id belongs to another device: correct node_id"
    )


def _compare(node: Node, report: NodeReport, entry: Object, allowed: Sequence[int]) -> None:
    found = report.identity.get(entry.name)
    if allowed and found not in allowed:
        wanted = " or ".join(f"0x{value:08X}" for value in allowed)
        shown = "absent" if found is None else f"0x{found:08X}"
        key = {objects.VENDOR_ID.name: "vendor_id", objects.PRODUCT_CODE.name: "product_code"}.get(
            entry.name, "serial_number"
        )
        raise BusError(
            f"{node.name}: {entry.name} is {shown} but must be {wanted}; "
            f"this is not the configured device: correct node_id, {key} or profile"
        )


def read_errors(session: Session, node: Node, report: NodeReport) -> None:
    """Note the error register (0x1001) and the newest entry of the error history (0x1003) in the report."""
    node_id = node.settings.node_id
    register = session.read_if_there(node_id, objects.ERROR_REGISTER)
    if register:
        words = "+".join(name for bit, name in cia301.REGISTER_BITS if register & bit)
        report.notes.append(f"error register 0x{register:02X} ({words})")
    if session.read_if_there(node_id, objects.ERROR_HISTORY_COUNT):
        newest = session.read_if_there(node_id, objects.ERROR_HISTORY) or 0
        report.notes.append(f"newest error in its history 0x{newest & 0xFFFF:04X} ({cia301.text(newest & 0xFFFF)})")


def is_on(session: Session, node: Node) -> bool:
    """Return True if the motor of a drive is powered."""
    return node.state(session) in _ON


def switch_off(session: Session, node: Node) -> None:
    """Switch off an enabled drive, because its PDOs must not be remapped; raise BusError if it stays enabled."""
    if not is_on(session, node):
        return
    node.write(session, objects.CONTROLWORD, Controlword.DISABLE_VOLTAGE)
    if not _poll(session, lambda: not is_on(session, node), _OFF_TIMEOUT):
        raise BusError(f"{node.name}: enabled and does not switch off; cut its power")


def reset_fault(session: Session, node: Node, report: NodeReport) -> None:
    """Reset a drive in fault by SDO with a rising edge of bit 7; raise BusError if the fault stays."""
    if node.state(session) not in _FAULTY:
        return
    found = _error(session, node)
    node.write(session, objects.CONTROLWORD, Controlword.DISABLE_VOLTAGE)
    node.write(session, objects.CONTROLWORD, Controlword.FAULT_RESET)
    if not _poll(session, lambda: node.state(session) not in _FAULTY, _OFF_TIMEOUT):
        raise BusError(f"{node.name}: {found} cannot be reset; remove its cause and start again")
    node.write(session, objects.CONTROLWORD, Controlword.DISABLE_VOLTAGE)
    report.notes.append(f"was in fault: {found}; reset as requested")


def _error(session: Session, node: Node) -> str:
    code = node.look(session, objects.ERROR_CODE) or 0
    return f"error 0x{code:04X} ({cia301.text(code)})"


def check_drive(session: Session, node: Node, report: NodeReport, resets: bool) -> None:
    """Check the state, the supported modes (0x6502) and the rated torque (0x6076) of a drive.

    Args:
        session: open session.
        node: the drive.
        report: receives notes on a fault and on missing objects.
        resets: True if the loop that follows resets a drive in fault, as in a recovery.

    Raises:
        BusError: the drive lacks cyclic synchronous torque or its rated torque.
        UsageError: the rated torque differs from the configuration.
    """
    if node.state(session) in _FAULTY:
        what = "it will now be reset" if resets else "it must be reset before it can be enabled: --reset-faults"
        report.notes.append(f"in fault: {_error(session, node)}; {what}")
    if node.profile.has(objects.SUPPORTED_MODES):
        modes = node.look(session, objects.SUPPORTED_MODES)
        if modes is None:
            report.notes.append("does not report its supported modes (0x6502)")
        elif not modes & cia402.CST_SUPPORTED:
            raise BusError(f"{node.name}: supported modes 0x{modes:08X}{_instead(modes)}")
    _check_rated_torque(session, node, report)


def find_inputs(session: Session, node: Node, report: NodeReport) -> None:
    """Store the digital inputs (0x60FD) in the report if the drive has them: an emergency stop may be wired to one."""
    if node.profile.has(objects.DIGITAL_INPUTS) and node.look(session, objects.DIGITAL_INPUTS) is not None:
        report.digital_inputs = objects.DIGITAL_INPUTS.of(node.axis.drive.slot)


def _instead(modes: int) -> str:
    """Return the reason for rejecting a drive without cyclic synchronous torque, and the remedy."""
    others = [name for bit, name in ((7, "cyclic position"), (8, "cyclic velocity")) if modes >> bit & 1]
    has = f"; it has {' and '.join(others)}, but this controller commands torque" if others else ""
    return (
        f" lack cyclic synchronous torque (bit 9){has}: through a stiff transmission, a position error causes "
        f"unlimited torque; use another drive or firmware, or, if the drive has the mode but does not report it, "
        f'write absent = ["{objects.SUPPORTED_MODES.name}"] in its profile'
    )


def _check_rated_torque(session: Session, node: Node, report: NodeReport) -> None:
    """Compare the rated torque (0x6076) with the configuration, because all torques are in per mille of it."""
    if not node.profile.has(objects.RATED_TORQUE):
        report.notes.append("has no rated torque (0x6076) to compare with the configuration")
        return
    drive, unit = node.axis.drive, node.profile.units.rated_torque
    digits = node.look(session, objects.RATED_TORQUE)
    if digits is None:
        raise BusError(
            f"{node.name}: has no rated torque (0x6076) to compare with; write absent = "
            f'["{objects.RATED_TORQUE.name}"] in {node.profile_file}, and verify rated_torque in [axis.drive]: '
            "it is then not checked"
        )
    found, wanted = digits * unit, drive.rated_torque
    if abs(found - wanted) <= max(_RATED_TOLERANCE * wanted, 0.5 * unit):
        return
    raise UsageError(
        f"{node.name}: rated torque is {digits} digits of {unit:g} N*m = {found:g} N*m, but the configuration has "
        f"{wanted:g} N*m{rated_torque_hint(found, wanted)}; correct rated_torque in [axis.drive], or "
        f"[units] rated_torque in {node.profile_file}"
    )


def rated_torque_hint(found: float, wanted: float) -> str:
    """Return the typical mistake that the ratio of two rated torques indicates, or an empty text."""
    if found <= 0.0:
        return ""
    ratio = found / wanted
    for factor, meaning in (
        (1000.0, "the drive's unit is another power of ten: mN*m instead of uN*m or N*m"),
        (1e6, "the drive's unit is another power of ten: uN*m instead of N*m"),
        (math.sqrt(2.0), "one is the peak value, the other the RMS value"),
    ):
        for candidate, sign in ((factor, ""), (1.0 / factor, "1/")):
            if abs(ratio / candidate - 1.0) < 0.02:
                name = "the root of 2" if factor < 2.0 else f"{factor:g}"
                return f" (a factor of {sign}{name}: {meaning})"
    return ""


def check_encoder(session: Session, encoder: EncoderSettings, name: str) -> None:
    """Raise UsageError if the resolution (0x6001) or range (0x6002) of an encoder differs from the configuration."""
    for entry, wanted, key in (
        (objects.MEASURING_UNITS, encoder.counts_per_revolution, "counts_per_revolution"),
        (objects.TOTAL_RANGE, encoder.counts_range, "counts_range"),
    ):
        found = session.read_if_there(encoder.node_id, entry)
        wraps_at_32_bits = entry is objects.TOTAL_RANGE and wanted == 1 << 32 and found in (0, 0xFFFFFFFF)
        if found is not None and found != wanted and not wraps_at_32_bits:
            raise UsageError(f"{name}: {entry} is {found}, but the configuration has {wanted}; correct {key}")


def confirm_mode(session: Session, node: Node, now: str) -> None:
    """Wait until 0x6061 reports cyclic synchronous torque; raise BusError if it does not.

    `now` is the stage reached, "written" or "operational". A drive that reports its mode only at a later stage is not
    checked.
    """
    when = node.profile.mode_shows
    if when == "enabled" or (when == "operational" and now == "written"):
        return  # the supervisor holds the torque at 0 until the mode is displayed
    wanted = Mode.CYCLIC_SYNC_TORQUE
    if not _poll(session, lambda: node.read(session, objects.MODE_DISPLAY) == wanted, _MODE_TIMEOUT):
        found = node.read(session, objects.MODE_DISPLAY)
        later = '"enabled"' if when == "operational" else '"operational" or "enabled"'
        raise BusError(
            f"{node.name}: mode of operation display (0x6061) is {found} but must be 10 (cyclic synchronous torque) "
            f"within {_MODE_TIMEOUT:g} s of being {now}; if this drive shows its mode later, write mode_shows = "
            f"{later} in {node.profile_file}; otherwise set up its motor and sensors for torque with the maker's tool"
        )


def check_watchdog(node: Node, plan: Sequence[Write], report: NodeReport) -> None:
    """Check that the drive stops if this computer fails; raise BusError unless require_watchdog is false."""
    there = {row.entry.key for row in report.rows if row.after is not None}
    watched = any(write.watchdog and write.entry.key in there for write in plan)
    reacts = objects.CONNECTION_LOSS.of(node.axis.drive.slot).key in there
    if watched and reacts:
        return
    if watched and node.axis.drive.require_watchdog:
        raise BusError(
            f"{node.name}: has a watchdog, but no reaction to a lost connection (0x6007), so its reaction is "
            "unknown if this computer fails; use another drive, or test it (tsa verify-safety) with "
            "require_watchdog = false"
        )
    if watched:
        report.notes.append("has a watchdog, but its reaction (0x6007) is unknown: test it with tsa verify-safety")
        return
    if node.axis.drive.require_watchdog:
        raise BusError(
            f"{node.name}: has neither a heartbeat consumer (0x1016) nor an RPDO event timer (0x1400:5), so it would "
            f'keep running if this computer fails; write supervision = "guarding" in {node.profile_file} if it has '
            "life guarding (0x100D); otherwise use another drive, or accept it with require_watchdog = false"
        )
    report.notes.append("has no watchdog: it would keep running if this computer fails")


def _poll(session: Session, reached: Callable[[], bool], timeout: float) -> bool:
    end = session.clock() + timeout
    while not reached():
        if session.clock() > end:
            return False
        session.wait(_POLL)
    return True


_SLOW_RAMP = 0.1  # s from zero to max_torque; a faster ramp ends before the joint has moved


def check_torque_path(
    session: Session, node: Node, written: Collection[tuple[int, int]]
) -> tuple[list[Row], list[str]]:
    """Read the objects of the torque path that the plan does not write.

    Args:
        session: open session; this function only reads.
        node: the drive.
        written: keys of the objects that the plan writes, which are skipped.

    Returns:
        Rows of the objects to watch while the loop runs, and a note for each object that limits or ramps the torque.
    """
    rows, notes = [], []
    for influence in TORQUE_PATH:
        entry = influence.entry.of(node.axis.drive.slot)
        if entry.key in written or not node.profile.has(entry):
            continue
        try:
            found = session.read_if_there(node.node_id, entry)
        except SdoRefusedError:
            notes.append(f"{entry} cannot be read, so its effect on the torque is unknown")
            continue
        if found is None:
            continue
        if influence.watched:
            rows.append(Row(entry, found, found))
        effect = _effect(influence, found, node)
        if effect:
            notes.append(f"{entry.name} (0x{entry.index:04X}) is {found} {influence.unit}: {effect}")
    return rows, notes


def _effect(influence: Influence, found: int, node: Node) -> str:
    """Return the limit or the ramp that a value imposes on the torque, or an empty text."""
    drive = node.axis.drive
    most = drive_scale(drive, node.profile, f"axis '{node.axis.name}'").max_torque_digits
    rated = drive.rated_torque * drive.gear_ratio / PER_MILLE
    if influence.effect is Effect.LIMITS and found < most:
        return (
            f"the drive delivers at most {found * rated:.3g} N*m, but torque in [axis.limits] is "
            f"{most * rated:.3g} N*m; raise the limit with the maker's tool, or lower torque"
        )
    if influence.effect is Effect.RAMPS and influence.unit and 0 < found * _SLOW_RAMP < most:
        return (
            f"{most / found:.3g} s from zero to max_torque; in CiA 402 it applies only in profile torque mode, but "
            "some drives also apply it in cyclic torque mode; raise it with the maker's tool if the torque lags"
        )
    return ""
