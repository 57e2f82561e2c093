"""Decide whether torque is permitted on one axis, and which controlword to send. Use no bus, no clock and no log.

A fault is latched with its cause until a reset is requested. Until then the torque stays at zero and the drive
disabled. Torque then requires a new request: an ENABLE that was active during the fault does not enable the drive.
"""

from __future__ import annotations

import math
from enum import Enum

from tsa_ctrl.bus.canopen import cia301, cia402
from tsa_ctrl.bus.canopen.cia301 import NmtState
from tsa_ctrl.bus.canopen.cia402 import Controlword, Mode, PowerState
from tsa_ctrl.bus.live.image import Image, NodeHealth
from tsa_ctrl.bus.settings import Role, SupervisionSettings
from tsa_ctrl.safety import fault_details
from tsa_ctrl.safety.causes import HELD_UP_CODES, Cause, Fault, Finding
from tsa_ctrl.safety.debounce import SECOND, LostPeriods, Sender

_RESET_LOW_TIME = 0.02  # s with bit 7 low before its rising edge, so that every drive detects the edge
_RUN = (Controlword.ENABLE_OPERATION, True, None)
_TORQUE_MODE = int(Mode.CYCLIC_SYNC_TORQUE)
_ENABLED_BITS = next(value for _, value, state in cia402.STATUSWORD_PATTERNS if state is PowerState.OPERATION_ENABLED)
_POWER_BITS = cia402.VOLTAGE_ENABLED | cia402.REMOTE  # must stay set on a drive that has set them once
_REPEATED_SHARE = 0.05  # of the cycles of a second; a healthy bus repeats a frame when an error hits its last bit
_LEAST_REPEATED = 3  # cycles in a slow loop
_OBEY_TIME = 0.05  # s in which a drive must leave operation enabled after the command


class Request(Enum):
    """A request of the operator."""

    DISABLE = "disable"
    ENABLE = "enable"
    RESET = "reset"


class Phase(Enum):
    """A phase of the supervisor."""

    STANDBY = "standby"
    ENABLING = "enabling"
    ENABLED = "enabled"
    DISABLING = "disabling"
    FAULT = "fault"
    RESETTING = "resetting"


_LEARNING = (Phase.STANDBY, Phase.ENABLING, Phase.ENABLED)  # record the drive's power bits; it may be off in any phase


class Supervisor:
    """Supervise one axis.

    Attributes:
        phase: present phase.
        faults: latched faults. The first one is the cause.
        needs_bring_up: True if the nodes must be configured again, followed by `configured()`.
        cut_off: True if the drive must be stopped by NMT in this cycle, because it did not leave operation enabled.
    """

    def __init__(
        self,
        settings: SupervisionSettings,
        reports_following: bool,
        shows_late: bool,
        rate: float,
    ) -> None:
        """Prepare the supervisor.

        Args:
            settings: [bus.supervision].
            reports_following: True if the drive has statusword bit 12.
            shows_late: True if the drive shows its mode only once it is enabled (see its profile). It is then enabled
                before it shows the mode, and torque is permitted only afterwards.
            rate: cycles per second, Hz.
        """
        self._settings = settings
        self._shows_late = shows_late
        self._following_mask = cia402.FOLLOWS_COMMAND_BIT if reports_following else 0
        self._running_mask = cia402.STATE_BITS | self._following_mask
        self._running_word = _ENABLED_BITS | self._following_mask
        self._power_bits = 0  # power bits that this drive has ever set
        self._misses = settings.tolerated_misses
        self._drops = settings.tolerated_drops
        self._planned = round(rate * SECOND)
        self._losses = LostPeriods(settings.most_lost(rate))
        self._repeated = 0  # PDOs of all nodes that came twice in a cycle
        self._most_owed = max(_LEAST_REPEATED, math.ceil(_REPEATED_SHARE * rate))
        self._senders: dict[int, Sender] = {}  # by node id
        self._events = 0
        self._emcys: dict[int, int] = {}
        self._since = 0.0
        self._armed = False
        self._reset_edge = False
        self._last_request = Request.DISABLE
        self.phase = Phase.STANDBY
        self.faults: list[Fault] = []
        self.needs_bring_up = False
        self.cut_off = False
        self._cut_off_due = 0.0

    @property
    def fault(self) -> Fault | None:
        """Return the fault that caused the stop, or None."""
        return self.faults[0] if self.faults else None

    def update(self, image: Image, now: float, request: Request) -> tuple[Controlword, bool, Fault | None]:
        """Run one cycle. Return the controlword, True if torque is permitted, and the latched fault or None."""
        if (
            self.phase is Phase.ENABLED
            and request is Request.ENABLE
            and image.statusword & self._running_mask == self._running_word
            and image.statusword & _POWER_BITS == self._power_bits
            and image.mode == _TORQUE_MODE
            and image.misses <= self._misses
            and image.drops <= self._drops
            and image.missed + image.dropped + image.skipped == self._losses.lost
            and image.repeated == self._repeated
            and image.events == self._events
            and image.silent is None
            and image.bus_fault is None
            and image.intruder is None
            and image.altered is None
            and image.pressed is None
        ):  # fast path of a normal cycle
            return _RUN
        state = cia402.decode(image.statusword)
        self._reset_edge = request is Request.RESET and self._last_request is not Request.RESET
        self._last_request = request
        self._watch(image, now)
        if self.phase in _LEARNING and image.fresh:
            self._power_bits |= image.statusword & _POWER_BITS
        self.cut_off = False
        if self.phase is Phase.FAULT or self.phase is Phase.RESETTING:
            return self._in_fault(image, state, now), False, self.fault
        if state is PowerState.FAULT or state is PowerState.FAULT_REACTION_ACTIVE:
            self._latch(Cause.DRIVE_FAULT, f"drive reports {_code(image.error_code)}", now)
        elif self.phase is Phase.STANDBY:
            return self._stand_by(state, now, request), False, None
        elif request is not Request.ENABLE:
            return self._disable(state, now), False, self.fault
        elif self.phase is Phase.ENABLED:
            self._check_running(image, state, now)
            if not self.faults:
                return _RUN
        elif self.phase is Phase.ENABLING:
            controlword = self._enable(image, state, now)
            if not self.faults:
                return controlword, False, None
        else:  # DISABLING: a new ENABLE waits until the drive has confirmed
            return self._disable(state, now), False, self.fault
        return Controlword.DISABLE_VOLTAGE, False, self.fault

    def trip(self, finding: Finding, now: float) -> None:
        """Latch the finding of a check outside the supervisor, for example of a limit or an implausible sensor."""
        self._latch(finding.cause, finding.detail, now)

    def configured(self, image: Image) -> None:
        """Permit a reset. Call this once the nodes have been configured again and the rig has been rearmed."""
        self.needs_bring_up = False
        self._events = image.events
        self._emcys = {health.node_id: health.emcys for health in image.nodes}

    def _watch(self, image: Image, now: float) -> None:
        """Latch the faults that stop an axis in every phase."""
        lossy, late = self._losses.update(image, now)
        if late:  # first, because missing commands cause the faults of the nodes
            self._latch(Cause.SKIPPED, fault_details.skipped(image, now - SECOND, self._planned), now)
        if image.bus_fault is not None:
            self._latch(Cause.BUS_FAULT, image.bus_fault.value, now)
        if image.intruder is not None:
            self._latch(Cause.SECOND_MASTER, f"another node sent a master's frame 0x{image.intruder:03X}", now)
        for cause, detail in ((Cause.ALTERED, image.altered), (Cause.EMERGENCY_STOP, image.pressed)):
            if detail is not None:
                self._latch(cause, detail, now)
        if image.events != self._events:
            self._events = image.events
            for health in image.nodes:
                self._examine(image, health, now)
        if image.silent is not None:
            self._latch(Cause.HEARTBEAT_LOST, fault_details.silent(image.silent, now), now)
        if image.misses > self._misses:
            self._latch(Cause.STALE_PDO, fault_details.stale(image), now)
        if image.drops > self._drops:
            self._latch(Cause.COMMAND_DROPPED, f"{image.drops} in a row; transmit queue full or interface down", now)
        if lossy:
            self._latch(Cause.STALE_PDO, fault_details.lossy(image, self._losses.too_many), now)
        self._repeated = image.repeated
        for node in image.nodes:
            sender = self._senders.get(node.node_id)
            if sender is None:
                sender = self._senders[node.node_id] = Sender(self._most_owed)
            if sender.repeats(node, now):
                detail = f"{node}: {node.repeated}; another node may have the same id, or forges its PDOs"
                self._latch(Cause.REPEATED_PDO, detail, now)

    def _examine(self, image: Image, health: NodeHealth, now: float) -> None:
        if health.boot_ups:
            self._latch(Cause.BOOT_UP, f"{health}: it lost its configuration", now)
        elif health.nmt_state != NmtState.OPERATIONAL:
            self._latch(Cause.NMT_STATE, f"{health}: NMT state 0x{health.nmt_state:02X}", now)
        if health.emcys != self._emcys.get(health.node_id, 0):
            self._emcys[health.node_id] = health.emcys
            cause = Cause.HELD_UP if health.emcy is not None and health.emcy.code in HELD_UP_CODES else Cause.EMERGENCY
            self._latch(cause, f"{health}: {health.emcy}{self._if_a_warning(image, health)}", now)

    def _if_a_warning(self, image: Image, health: NodeHealth) -> str:
        """Return the remedy for an emergency of a drive that continues to operate; otherwise an empty string."""
        faulty = cia402.decode(image.statusword) in (PowerState.FAULT, PowerState.FAULT_REACTION_ACTIVE)
        if health.role is not Role.DRIVE or health.emcy is None or faulty or not image.fresh:
            return ""
        return f"; the drive goes on: if it only warns, warnings = [0x{health.emcy.code:04X}] in its profile"

    def _check_running(self, image: Image, state: PowerState, now: float) -> None:
        if state is not PowerState.OPERATION_ENABLED:
            self._latch(Cause.STATE_LOST, f"drive is in {state.value}", now)
        elif missing := self._power_bits & ~image.statusword:
            which = "4 (voltage)" if missing & cia402.VOLTAGE_ENABLED else "9 (remote)"
            self._latch(
                Cause.STATE_LOST,
                f"drive reports that it is enabled, but bit {which} of statusword 0x{image.statusword:04X} went "
                "low: the power stage is off, or another master controls it",
                now,
            )
        elif image.mode != Mode.CYCLIC_SYNC_TORQUE:
            self._latch(Cause.WRONG_MODE, f"drive is in mode {image.mode} instead of 10 (cyclic torque)", now)
        elif image.statusword & self._following_mask != self._following_mask:
            self._latch(Cause.COMMAND_IGNORED, f"bit 12 of statusword 0x{image.statusword:04X} is low", now)

    def _stand_by(self, state: PowerState, now: float, request: Request) -> Controlword:
        if request is not Request.ENABLE:
            self._armed = True
        elif self._armed:
            self._enter(Phase.ENABLING, now)
        return cia402.next_controlword(state, PowerState.READY_TO_SWITCH_ON)

    def _enable(self, image: Image, state: PowerState, now: float) -> Controlword:
        """Step the drive to operation enabled with torque 0, until a fresh PDO confirms state, mode and bit 12."""
        in_mode = image.mode == Mode.CYCLIC_SYNC_TORQUE
        following = image.statusword & self._following_mask == self._following_mask
        if state is PowerState.OPERATION_ENABLED and in_mode and following and image.fresh:
            self._enter(Phase.ENABLED, now)
        elif now - self._since > self._settings.enable_timeout:
            waited, late = self._settings.enable_timeout, self._shows_late
            self._latch(Cause.ENABLE_TIMEOUT, fault_details.not_enabled(image, waited, in_mode, following, late), now)
        target = PowerState.OPERATION_ENABLED if in_mode or self._shows_late else PowerState.READY_TO_SWITCH_ON
        return cia402.next_controlword(state, target)

    def _disable(self, state: PowerState, now: float) -> Controlword:
        if self.phase is not Phase.DISABLING:
            self._enter(Phase.DISABLING, now)
        if state in (PowerState.READY_TO_SWITCH_ON, PowerState.SWITCH_ON_DISABLED):
            self._armed = False
            self._enter(Phase.STANDBY, now)
        elif now - self._since > self._settings.disable_timeout:
            self._latch(Cause.DISABLE_TIMEOUT, f"drive is in {state.value}", now)
        return cia402.next_controlword(state, PowerState.READY_TO_SWITCH_ON)

    def _in_fault(self, image: Image, state: PowerState, now: float) -> Controlword:
        """Keep the torque off. On request, reset the drive unless a new bring-up is needed first."""
        if self.phase is Phase.FAULT:
            if state is not PowerState.OPERATION_ENABLED:
                self._cut_off_due = now + _OBEY_TIME
            elif now >= self._cut_off_due:
                self._cut_off_due = now + _OBEY_TIME
                self.cut_off = self.needs_bring_up = True
            if self._reset_edge and not self.needs_bring_up:
                self._enter(Phase.RESETTING, now)
            return Controlword.DISABLE_VOLTAGE
        waited = now - self._since
        if state is PowerState.FAULT or state is PowerState.FAULT_REACTION_ACTIVE:
            if waited > self._settings.reset_timeout:
                self._latch(Cause.RESET_TIMEOUT, f"drive reports {_code(image.error_code)}", now)
            elif waited > _RESET_LOW_TIME and state is PowerState.FAULT:
                return Controlword.FAULT_RESET
        elif image.fresh:
            self.faults.clear()
            self._enter(Phase.STANDBY, now)
        elif waited > self._settings.reset_timeout:
            self._latch(Cause.RESET_TIMEOUT, "no fresh PDO", now)
        return Controlword.DISABLE_VOLTAGE

    def _latch(self, cause: Cause, detail: str, now: float) -> None:
        if self.phase is Phase.RESETTING and cause is Cause.STALE_PDO:
            return  # the time-out of the reset covers this case
        if all(fault.cause is not cause for fault in self.faults):  # keep the first fault of each cause
            self.faults.append(Fault(cause, detail, now))
        self.needs_bring_up = self.needs_bring_up or cause.needs_bring_up
        self._armed = False
        if self.phase is not Phase.FAULT:
            self._cut_off_due = now + _OBEY_TIME
        self._enter(Phase.FAULT, now)

    def _enter(self, phase: Phase, now: float) -> None:
        self.phase = phase
        self._since = now
        if phase is Phase.STANDBY:
            self._losses.reset()
            for sender in self._senders.values():
                sender.cycles.reset()


def _code(error_code: int) -> str:
    return f"error 0x{error_code:04X} ({cia301.text(error_code)})"
