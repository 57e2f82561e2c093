"""Faults of the simulated machine, by configuration or at run time: one table, each with its undoing."""

from __future__ import annotations

import difflib
import heapq
import itertools
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import msgspec

from tsa_ctrl.bus.wire.seam import ERROR_FLAG
from tsa_ctrl.errors import UsageError
from tsa_ctrl.plant.fault_kind import FaultKind, Target, Undo, nothing, parameter, swap
from tsa_ctrl.plant.mechanical_faults import MECHANICAL_FAULTS
from tsa_ctrl.plant.settings import FaultSettings


def _power_cycle(target: Target) -> Undo:
    for node in target.nodes:
        node.power_off()

    def on(now: float) -> None:
        for node in target.nodes:
            node.boot(now)

    return on


def _fault(target: Target) -> Undo:
    drive = target.drive
    drive.fault(int(target.value), stays=target.duration > 0.0)

    def cause_gone(now: float) -> None:
        drive.error_cause = False

    return cause_gone if target.duration > 0.0 else nothing


def _emcy(target: Target) -> Undo:
    target.node.emergency(int(target.value), 0x20)
    return nothing


def _encoder_jump(target: Target) -> Undo:
    if target.encoder is None:
        raise UsageError(f"fault encoder_jump: axis '{target.axis.name}' has no encoder; choose another fault")
    return swap(target.encoder.faults, "offset", target.encoder.faults.offset + target.value)


def _torque_sensor_stuck(target: Target) -> Undo:
    if target.torque_sensor is None:
        raise UsageError(f"fault torque_sensor_stuck: axis '{target.axis.name}' has no torque sensor")
    return swap(target.torque_sensor.faults, "stuck", True)


def _error_frame(target: Target) -> Undo:
    target.rig.inject(ERROR_FLAG | int(target.value), bytes(8))
    return nothing


def _foreign_sdo(target: Target) -> Undo:
    """Entry 1 of 0x1016 is written to 0: nobody is watched for any longer."""
    can_id, request = 0x600 + target.node.node_id, bytes((0x23, 0x16, 0x10, 0x01, 0, 0, 0, 0))
    target.rig.inject(can_id, request)
    target.node.receive(can_id, request, target.now)
    return nothing


def _torque_offset(target: Target) -> Undo:
    """Write 0x60B2 out of sight of the bus, as a tool on another port does."""
    values = target.drive.values
    before, values[0x60B2, 0] = values[0x60B2, 0], int(target.value)

    def undo(now: float) -> None:
        values[0x60B2, 0] = before

    return undo


def _replay(target: Target) -> Undo:
    target.outlet.replay(target.value)
    return nothing


def _interface_down(target: Target) -> Undo:
    target.rig.set_interface(False)

    def up(now: float) -> None:
        target.rig.set_interface(True)
        target.outlet.replay(target.value + now - target.now)
        target.rig.replay_commands(target.now - target.value, now)

    return up


NO_OTHERS: Mapping[str, FaultKind] = MappingProxyType({})
FAULTS: Mapping[str, FaultKind] = {
    "power_cycle": FaultKind("the nodes of the axis lose power; after the duration they boot", _power_cycle),
    "fault": FaultKind("the drive faults", _fault, 0x2310, "error code", 1, 0xFFFF),
    "emcy": FaultKind("an EMCY without a fault", _emcy, 0x2310, "error code", 0, 0xFFFF),
    "stuck_tpdo": FaultKind("TPDOs repeat their last data", lambda t: swap(t.outlet, "stuck", True)),
    "repeated_tpdo": FaultKind(
        "each TPDO is sent several times", lambda t: swap(t.outlet, "copies", int(t.value)), 2, "times", 1, 10
    ),
    "late_tpdo": FaultKind("TPDOs are late", lambda t: swap(t.outlet, "delay", t.value), 2e-3, "s", 0.0, 1.0),
    "missing_tpdo": FaultKind("TPDOs are lost", lambda t: swap(t.outlet, "loss", t.value), 1.0, "probability", 0, 1),
    "sparse_tpdo": FaultKind(
        "so many of each TPDO are lost in a row, then one is sent",
        lambda t: swap(t.outlet, "lost_in_a_row", int(t.value)), 2, "TPDOs", 0, 1000,
    ),
    "wrong_length": FaultKind(
        "TPDOs have a wrong length", lambda t: swap(t.outlet, "length", int(t.value)), 3, "bytes", 0, 8
    ),
    "wrong_mode": FaultKind(
        "0x6061 shows another mode", lambda t: swap(t.drive.faults, "wrong_mode", int(t.value)), 8, "mode", -128, 127
    ),
    "ignored_command": FaultKind(
        "bit 12 is low, the target torque is not followed", lambda t: swap(t.drive.faults, "ignore_command", True)
    ),
    "foreign_sdo": FaultKind("somebody else writes by SDO: the node watches our heartbeat no more", _foreign_sdo),
    "torque_offset": FaultKind(
        "another tool writes the torque offset 0x60B2 out of sight of this bus",
        _torque_offset, 120, "per mille of the rated torque", -1000, 1000,
    ),
    "rpdo_lost": FaultKind("commands do not reach the node", lambda t: swap(t.node, "deaf", True)),
    "heartbeat_lost": FaultKind("a node's heartbeat stops", lambda t: swap(t.outlet, "mute", True)),
    "error_frame": FaultKind("an error frame on the bus", _error_frame, 0x40, "error class", 1, 0x1FFFFFFF),
    "replay": FaultKind("the TPDOs of the last time are sent again at once", _replay, 0.05, "s", 0.0, 10.0),
    "interface_down": FaultKind(
        "the interface is down; when it is up again, what was on the bus just before is replayed to both sides",
        _interface_down, 0.05, "s", 0.0, 10.0,
    ),
    "flood": FaultKind(
        "frames of other identifiers", lambda t: swap(t.rig, "flood_rate", t.value), 2000, "frames/s", 0, 20000
    ),
    "torque_sensor_stuck": FaultKind("the joint torque sensor stands still", _torque_sensor_stuck),
    "encoder_jump": FaultKind("the joint encoder jumps", _encoder_jump, 0.5, "rad", -100.0, 100.0),
    "reversed_sign": FaultKind(
        "the motor turns the wrong way", lambda t: swap(t.drive.faults, "torque_sign", -t.drive.faults.torque_sign)
    ),
    "torque_gain": FaultKind(
        "the motor gives so many times the torque that the drive reports",
        lambda t: swap(t.drive.faults, "torque_gain", t.value), 2.0, "1", 0.0, 10.0,
    ),
    "torn_tendon": FaultKind(
        "a tendon tears: 0 is a (backward), 1 is b (forward)",
        lambda t: parameter(t, "torn_b" if t.value else "torn_a", 1),
        1, "tendon", 0, 1,
    ),
    "slack": FaultKind(
        "the tensioner gives way", lambda t: parameter(t, "pretension_factor", t.value), 0.1, "of the pretension", 0, 1
    ),
    "clock_drift": FaultKind(
        "the drive works by a clock of its own", lambda t: swap(t.drive.faults, "clock_drift", t.value),
        0.01, "relative", -0.1, 0.1,
    ),
    "digital_input": FaultKind(
        "an input of the drive is active (0x60FD)",
        lambda t: swap(t.drive.faults, "inputs", t.drive.faults.inputs ^ 1 << int(t.value)),
        3, "bit", 0, 31,
    ),
    **MECHANICAL_FAULTS,
}  # fmt: skip


CHANGES: Mapping[str, FaultKind] = {
    "friction": FaultKind(
        "the friction coefficient changes",
        lambda t: parameter(t, "friction", t.value * t.axis.friction),
        0.5, "of that at the start", 0, 10,
    ),
    "pretension": FaultKind(
        "the pretension changes",
        lambda t: parameter(t, "pretension_factor", t.value),
        0.5, "of that at the start", 0, 10,
    ),
    "bending": FaultKind(
        "the sheath bends otherwise; the path length follows (3.50)",
        lambda t: parameter(t, "theta_factor", t.value),
        1.2, "of the bending angle", 0, 10,
    ),
    "push": FaultKind(
        "a torque on the joint from outside", lambda t: parameter(t, "push", t.value), 0.5, "N*m", -100, 100
    ),
    "let_go": FaultKind("the hand lets the joint go", lambda t: parameter(t, "hand_factor", 0.0)),
}  # fmt: skip
"""What may happen to a healthy rig while it runs; begun, ended and parsed as faults are."""


def check_fault(fault: FaultSettings, where: str, others: Mapping[str, FaultKind] = NO_OTHERS) -> FaultKind:
    """Return the kind that a fault names; raise UsageError for an unknown name or a value out of range.

    Args:
        fault: the fault.
        where: its place, for the message.
        others: kinds in addition to those of the plant.
    """
    kinds = {**FAULTS, **CHANGES, **others}
    kind = kinds.get(fault.name)
    if kind is None:
        known = list(kinds)
        near = difflib.get_close_matches(fault.name, known, n=1, cutoff=0.5)
        advice = f"did you mean '{near[0]}'?" if near else f"known faults are {', '.join(known)}"
        raise UsageError(f"{where}: unknown fault '{fault.name}'; {advice}")
    if fault.value is None:
        return kind
    if not kind.unit:
        raise UsageError(f"{where}: fault {fault.name} takes no value, found {fault.value:g}; leave it out")
    if not kind.low <= fault.value <= kind.high:
        raise UsageError(
            f"{where}: fault {fault.name}: value {fault.value:g}; "
            f"allowed is {kind.low:g} to {kind.high:g} ({kind.unit})"
        )
    return kind


def parse_fault(text: str, others: Mapping[str, FaultKind] = NO_OTHERS) -> tuple[str | None, FaultSettings]:
    """Parse `torn_tendon axis=knee value=1 duration=0.5` as on the control socket; axis None is the first one."""
    name, *pairs = text.split()
    values: dict[str, Any] = {"name": name}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals:
            raise UsageError(f"fault {name}: found '{pair}'; write key=value")
        values[key] = value
    axis = values.pop("axis", None)
    try:
        fault = msgspec.convert(values, FaultSettings, strict=False)
    except msgspec.ValidationError as error:
        raise UsageError(f"fault {name}: {error}; keys are axis, node, value, duration, at") from None
    check_fault(fault, "control", others)
    return axis, fault


class FaultPlan:
    """Faults to come and faults to end, by time; `active` counts those that are on."""

    def __init__(self) -> None:
        self.active = 0
        self._queue: list[tuple[float, int, Callable[[float], None]]] = []
        self._undo: dict[int, Undo] = {}
        self._number = itertools.count()

    def schedule(self, at: float, action: Callable[[float], None]) -> None:
        heapq.heappush(self._queue, (at, next(self._number), action))

    def start(self, kind: FaultKind, target: Target) -> None:
        """Begin a fault now; it ends after its duration, or stays."""
        undo = kind.start(target)
        if undo is nothing:
            return
        number = next(self._number)
        self._undo[number] = undo
        self.active = len(self._undo)
        if target.duration > 0.0:
            self.schedule(target.now + target.duration, lambda now: self._end(number, now))

    def _end(self, number: int, now: float) -> None:
        undo = self._undo.pop(number, None)
        if undo is not None:
            undo(now)
        self.active = len(self._undo)

    def clear(self, now: float) -> int:
        """End all faults, the last one first; how many."""
        count = len(self._undo)
        for number in sorted(self._undo, reverse=True):
            self._end(number, now)
        return count

    def tick(self, now: float) -> None:
        while self._queue and self._queue[0][0] <= now:
            heapq.heappop(self._queue)[2](now)
