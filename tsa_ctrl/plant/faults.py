"""Define the faults of the simulated machine in one table, each with its undo function.

Faults are injected by configuration or at run time.
"""

from __future__ import annotations

import difflib
import heapq
import itertools
import math
import random
from collections import deque
from collections.abc import Callable, Mapping, MutableMapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Protocol

import msgspec
import numpy as np

from tsa_ctrl import settings
from tsa_ctrl.bus.wire.bus import ERROR_FLAG
from tsa_ctrl.errors import UsageError
from tsa_ctrl.plant.axis import Axis
from tsa_ctrl.plant.dictionary import Key
from tsa_ctrl.plant.drive import Drive
from tsa_ctrl.plant.node import Node, Send
from tsa_ctrl.plant.sensors import Encoder, EncoderFaults, TorqueSensor, TorqueSensorFaults
from tsa_ctrl.plant.settings import FaultSettings

_HEARTBEAT = 0x700
_HISTORY = 4096  # most frames that a replay can repeat


@dataclass
class TransmitFaults:
    """Send the frames of one node, modified by the active faults of the wire and of the node's firmware.

    Faults can change TPDOs and the heartbeat. EMCY and SDO frames pass unchanged.
    """

    send: Send
    clock: Callable[[], float]
    noise: random.Random
    stuck: bool = False  # TPDOs repeat their last data
    copies: int = 1  # of each TPDO
    delay: float = 0.0  # s, of each TPDO
    loss: float = 0.0  # probability that a TPDO is not sent
    lost_in_a_row: int = 0  # lost frames of each TPDO before one is sent
    length: int | None = None  # bytes of each TPDO
    mute: bool = False  # no heartbeat
    history: deque[tuple[float, int, bytes]] = field(default_factory=lambda: deque(maxlen=_HISTORY))
    waiting: deque[tuple[float, int, bytes]] = field(default_factory=deque)
    _last: dict[int, bytes] = field(default_factory=dict)
    _lost: dict[int, int] = field(default_factory=dict)  # in a row, by identifier

    def __call__(self, can_id: int, data: bytes) -> bool:
        if can_id >= _HEARTBEAT:
            return False if self.mute else self.send(can_id, data)
        if not 0x180 <= can_id < 0x580:
            return self.send(can_id, data)
        return self._tpdo(can_id, data)

    def _tpdo(self, can_id: int, data: bytes) -> bool:
        if self.stuck:
            data = self._last.setdefault(can_id, data)
        else:
            self._last[can_id] = data
        if self.loss > 0.0 and self.noise.random() < self.loss:
            return False
        if self.lost_in_a_row:
            lost = self._lost.get(can_id, 0)
            self._lost[can_id] = lost + 1 if lost < self.lost_in_a_row else 0
            if lost < self.lost_in_a_row:
                return False
        if self.length is not None:
            data = data[: self.length].ljust(self.length, b"\0")
        now = self.clock()
        self.history.append((now, can_id, data))
        if self.delay > 0.0:
            self.waiting.append((now + self.delay, can_id, data))
            return True
        sent = True
        for _ in range(self.copies):
            sent = self.send(can_id, data)
        return sent

    def release(self, now: float) -> None:
        """Send the delayed frames that are due at `now` (s)."""
        while self.waiting and self.waiting[0][0] <= now:
            _, can_id, data = self.waiting.popleft()
            self.send(can_id, data)

    def replay(self, seconds: float) -> int:
        """Repeat all TPDOs of the last `seconds`, as an adapter with stale frames does, and return their number."""
        since = self.clock() - seconds
        stale = [(can_id, data) for at, can_id, data in self.history if at >= since]
        for can_id, data in stale:
            self.send(can_id, data)
        return len(stale)


Undo = Callable[[float], None]


class Changes:
    """Apply the changes of each value in the order of their start. The end of one leaves the others in force."""

    def __init__(self) -> None:
        self._active: dict[tuple[int, Any], tuple[Any, list[Callable[[Any], Any]]]] = {}

    def begin(self, owner: Any, name: Any, change: Callable[[Any], Any]) -> Undo:
        """Change an attribute or an item of `owner` by the function `change`, and return the function that ends it."""
        place = id(owner), name
        before, changes = self._active.setdefault(place, (_value_of(owner, name), []))
        changes.append(change)

        def apply() -> None:
            value = before
            for each in changes:
                value = each(value)
            if isinstance(owner, MutableMapping | np.ndarray):
                owner[name] = value
            else:
                setattr(owner, str(name), value)

        def end(now: float) -> None:
            changes.remove(change)
            apply()
            if not changes:
                del self._active[place]

        apply()
        return end


def _value_of(owner: Any, name: Any) -> Any:
    if isinstance(owner, np.ndarray):
        return owner[name].item()
    return owner[name] if isinstance(owner, MutableMapping) else getattr(owner, str(name))


class Rig(Protocol):
    """Give a fault access to parts of the machine other than its axis."""

    flood_rate: float
    changes: Changes

    def inject(self, can_id: int, data: bytes, place: int = 0) -> bool:
        """Send any frame on the bus at `place`."""

    def set_interface(self, up: bool | None, place: int = 0) -> None:
        """Take the interface of a bus down or up; raises UsageError if the user lacks the permission.

        `up` None only checks the permission.
        """

    def replay_commands(self, since: float, now: float) -> None:
        """Process the master's frames since the time `since` (s) again."""

    def later(self, at: float, action: Callable[[float], None]) -> None:
        """Call `action(now)` in the first tick at or after `at`."""


@dataclass(frozen=True)
class Target:
    """Hold the parts on which a fault acts, and its value."""

    rig: Rig
    axis: Axis
    drive: Drive
    encoder: Encoder | None
    torque_sensor: TorqueSensor | None
    nodes: tuple[Node, ...]
    node: Node
    transmit: TransmitFaults
    value: float
    duration: float
    now: float
    place: int = 0  # of the axis' bus


COUNTED = frozenset({  # units of values that are whole numbers
    "error code", "times", "TPDOs", "RPDOs", "bytes", "mode", "error class", "per mille of the rated torque", "bit",
    "tendon",
})  # fmt: skip


@dataclass(frozen=True)
class FaultKind:
    """Hold one fault: its description, its effect, and the default, unit and range of its value.

    `needs`: kind of node, or object of the drive, without which the fault is impossible.
    `switches`: True if the fault needs the permission to switch the interface.
    """

    doc: str
    start: Callable[[Target], Undo]
    value: float = 0.0
    unit: str = ""
    low: float = 0.0
    high: float = 0.0
    needs: str | Key = "drive"
    switches: bool = False


def nothing(now: float) -> None:
    """Do nothing, as the undo function of a fault that is a single event."""


def swap(target: Target, owner: object, name: Any, value: Any) -> Undo:
    """Set an attribute or an item of `owner` and return the function that ends this change."""
    return target.rig.changes.begin(owner, name, lambda before: value)


def parameter(target: Target, name: str, value: float) -> Undo:
    """Change a parameter of the mechanics and return the function that ends this change."""
    return swap(target, target.axis.parameters, name, value)


FLAP = 0.1  # s, period of a flapping power stage, which is off for half of it
_FRAYED = 0.05  # of the pretension: lower bound, held by the last wires
_STEP = 1e-3  # s between two steps of a gradual fault
_TORQUE_OFFSET: Key = (0x60B2, 0)


def _all(*undos: Undo) -> Undo:
    def undo(now: float) -> None:
        for each in reversed(undos):
            each(now)

    return undo


def _repeated(target: Target, period: float, action: Callable[[float], None]) -> Undo:
    """Call `action` every `period` s from now on, until it is undone."""
    on = True

    def again(now: float) -> None:
        if on:
            action(now)
            target.rig.later(now + period, again)

    def end(now: float) -> None:
        nonlocal on
        on = False

    again(target.now)
    return end


def _varying(target: Target, owner: object, name: str, period: float, change: Callable[[int, float, Any], Any]) -> Undo:
    """Change a value every `period` s; `change` has the number of the step, the time (s) and the unchanged value."""
    number = itertools.count()
    end: Undo = nothing

    def step(now: float) -> None:
        nonlocal end
        end(now)
        n = next(number)
        end = target.rig.changes.begin(owner, name, lambda before: change(n, now, before))

    return _all(lambda now: end(now), _repeated(target, period, step))


def _fraying(target: Target) -> Undo:
    """Reduce the pretension by the share `value` per second."""

    def frayed(number: int, now: float, before: float) -> float:
        return before * max(_FRAYED, 1.0 - target.value * (now - target.now))

    return _varying(target, target.axis.parameters, "pretension_factor", _STEP, frayed)


def _flapping(target: Target) -> Undo:
    return _varying(
        target, target.drive.faults, "dead_stage", FLAP / 2.0, lambda number, now, before: before or number % 2 == 0
    )


def _torque_off(target: Target) -> Undo:
    back = swap(target, target.drive.faults, "torque_off", True)
    target.drive.power_off()
    return back


def _watchdogs_lost(target: Target) -> Undo:
    """Clear the drive's watchdogs as a tool on another port would do, without any frame on the bus."""
    values = target.drive.values
    return _all(*(swap(target, values, key, 0) for key in ((0x1400, 5), (0x1016, 1)) if key in values))


def _turned(target: Target, name: str) -> Undo:
    """Change the sign of an attribute of the drive's faults."""
    return target.rig.changes.begin(target.drive.faults, name, lambda before: -before)


def _polarity(target: Target) -> Undo:
    return _all(_turned(target, "torque_sign"), _turned(target, "turned"))


def _encoder(target: Target) -> EncoderFaults:
    assert target.encoder is not None
    return target.encoder.faults


def _sensor(target: Target) -> TorqueSensorFaults:
    assert target.torque_sensor is not None
    return target.torque_sensor.faults


def _encoder_drift(target: Target) -> Undo:
    faults = _encoder(target)
    return _all(swap(target, faults, "since", target.now), swap(target, faults, "drift", target.value))


def _encoder_slip(target: Target) -> Undo:
    faults = _encoder(target)
    angle = target.axis.readings.joint_angle
    return _all(swap(target, faults, "pivot", angle), swap(target, faults, "gain", target.value))


def _object(target: Target, distorted: Callable[[int], int], index: int) -> Undo:
    """Distort the value that the drive reports in this object."""
    distortion, distortions = (index, distorted), target.drive.faults.distortions
    distortions.append(distortion)
    return lambda now: distortions.remove(distortion)


def _scaled(target: Target, index: int) -> Undo:
    """Multiply an object by the fault's value; of a position, multiply only the change since the fault began."""
    start = target.drive.values[index, 0] if index == 0x6064 else 0
    return _object(target, lambda value: start + round(target.value * (value - start)), index)


def _stuck(target: Target, index: int) -> Undo:
    """Hold an object at its present value."""
    held = target.drive.values[index, 0]
    return _object(target, lambda _: held, index)


def _digital_input(target: Target) -> Undo:
    """Set a bit of 0x60FD, and keep the others."""
    return target.rig.changes.begin(target.drive.faults, "inputs", lambda before: before | 1 << int(target.value))


def _reported_offset(target: Target) -> Undo:
    settings = target.drive.settings
    rated = settings.rated_torque * settings.gear_ratio * settings.torque_sign
    offset = round(target.value / rated * target.drive.emulation.torque_digits)
    return _object(target, lambda value: value + offset, 0x6077)


def _motor_encoder_stuck(target: Target) -> Undo:
    """Hold the position; the velocity that the drive derives from it is 0."""
    return _all(_stuck(target, 0x6064), _object(target, lambda _: 0, 0x606C))


def _encoder_stuck(target: Target) -> Undo:
    faults, held = _encoder(target), list[int]()

    def first(counts: int) -> int:
        if not held:
            held.append(counts)
        return held[0]

    return swap(target, faults, "distorted", first)


def _encoder_bit(target: Target) -> Undo:
    mask = 1 << int(target.value)
    return swap(target, _encoder(target), "distorted", lambda counts: counts | mask)


def _forged(target: Target) -> Undo:
    """Send the node's TPDOs every `value` s with the data that they had when the fault began."""
    identifiers = [tpdo.cob_id for tpdo in target.node.tpdos if tpdo.valid]
    last = {tpdo.cob_id: tpdo.last for tpdo in target.node.tpdos if tpdo.valid}

    def send(now: float) -> None:
        for can_id in identifiers:
            target.rig.inject(can_id, last[can_id], target.place)

    return _repeated(target, target.value, send)


def _power_cycle(target: Target) -> Undo:
    for node in target.nodes:
        node.power_off()

    def on(now: float) -> None:
        for node in target.nodes:
            node.boot(now)

    return on


def _fault(target: Target) -> Undo:
    undo = swap(target, target.drive, "error_cause", True) if target.duration > 0.0 else nothing
    target.drive.fault(int(target.value))
    return undo


def _emcy(target: Target) -> Undo:
    target.node.emergency(int(target.value), 0x20)
    return nothing


def _encoder_jump(target: Target) -> Undo:
    return target.rig.changes.begin(_encoder(target), "offset", lambda before: before + target.value)


def _error_frame(target: Target) -> Undo:
    target.rig.inject(ERROR_FLAG | int(target.value), bytes(8), target.place)
    return nothing


def _foreign_sdo(target: Target) -> Undo:
    """Write 0 to entry 1 of 0x1016, so that the node no longer monitors this heartbeat."""
    can_id, request = 0x600 + target.node.node_id, bytes((0x23, 0x16, 0x10, 0x01, 0, 0, 0, 0))
    target.rig.inject(can_id, request, target.place)
    target.node.receive(can_id, request, target.now)
    return nothing


def _torque_offset(target: Target) -> Undo:
    """Write 0x60B2 without a frame on the bus, as a tool on another port would do."""
    return swap(target, target.drive.values, _TORQUE_OFFSET, int(target.value))


def _replay(target: Target) -> Undo:
    target.transmit.replay(target.value)
    return nothing


def _interface_down(target: Target) -> Undo:
    target.rig.set_interface(False, target.place)

    def up(now: float) -> None:
        target.rig.set_interface(True, target.place)
        target.transmit.replay(target.value + now - target.now)
        target.rig.replay_commands(target.now - target.value, now)

    return up


NO_OTHERS: Mapping[str, FaultKind] = MappingProxyType({})
FAULTS: Mapping[str, FaultKind] = {
    "power_cycle": FaultKind("the nodes of the axis lose power; after the duration they boot", _power_cycle),
    "fault": FaultKind("the drive faults", _fault, 0x2310, "error code", 1, 0xFFFF),
    "emcy": FaultKind("an EMCY without a fault", _emcy, 0x2310, "error code", 0, 0xFFFF),
    "stuck_tpdo": FaultKind("TPDOs repeat their last data", lambda t: swap(t, t.transmit, "stuck", True)),
    "repeated_tpdo": FaultKind(
        "each TPDO is sent several times", lambda t: swap(t, t.transmit, "copies", int(t.value)), 2, "times", 1, 10
    ),
    "late_tpdo": FaultKind("TPDOs are late", lambda t: swap(t, t.transmit, "delay", t.value), 2e-3, "s", 0.0, 1.0),
    "missing_tpdo": FaultKind(
        "TPDOs are lost", lambda t: swap(t, t.transmit, "loss", t.value), 1.0, "probability", 0, 1
    ),
    "sparse_tpdo": FaultKind(
        "this many of each TPDO are lost in a row, then one is sent",
        lambda t: swap(t, t.transmit, "lost_in_a_row", int(t.value)), 2, "TPDOs", 0, 1000,
    ),
    "wrong_length": FaultKind(
        "TPDOs have a wrong length", lambda t: swap(t, t.transmit, "length", int(t.value)), 3, "bytes", 0, 8
    ),
    "wrong_mode": FaultKind(
        "0x6061 reports another mode",
        lambda t: swap(t, t.drive.faults, "wrong_mode", int(t.value)), 8, "mode", -128, 127,
    ),
    "ignored_command": FaultKind(
        "bit 12 is low, the target torque is ignored", lambda t: swap(t, t.drive.faults, "ignore_command", True)
    ),
    "foreign_sdo": FaultKind("another master writes by SDO: the node no longer monitors our heartbeat", _foreign_sdo),
    "torque_offset": FaultKind(
        "another tool writes the torque offset 0x60B2, and no frame on this bus shows it",
        _torque_offset, 120, "per mille of the rated torque", -1000, 1000, needs=_TORQUE_OFFSET,
    ),
    "rpdo_lost": FaultKind("commands do not reach the node", lambda t: swap(t, t.node, "deaf", True)),
    "heartbeat_lost": FaultKind("a node's heartbeat stops", lambda t: swap(t, t.transmit, "mute", True)),
    "error_frame": FaultKind("an error frame on the bus", _error_frame, 0x40, "error class", 1, 0x1FFFFFFF),
    "replay": FaultKind("the most recent TPDOs are sent again at once", _replay, 0.05, "s", 0.0, 10.0),
    "interface_down": FaultKind(
        "the interface is down; when it is up again, the last frames on the bus are replayed to both sides",
        _interface_down, 0.05, "s", 0.0, 10.0, switches=True,
    ),
    "flood": FaultKind(
        "frames with other identifiers flood the bus",
        lambda t: swap(t, t.rig, "flood_rate", t.value), 2000, "frames/s", 0, 20000,
    ),
    "torque_sensor_stuck": FaultKind(
        "the joint torque sensor is stuck", lambda t: swap(t, _sensor(t), "stuck", True), needs="torque_sensor"
    ),
    "encoder_jump": FaultKind("the joint encoder jumps", _encoder_jump, 0.5, "rad", -100.0, 100.0, "encoder"),
    "reversed_sign": FaultKind(
        "the motor turns the wrong way", lambda t: _turned(t, "torque_sign")
    ),
    "torque_gain": FaultKind(
        "the motor delivers a multiple of the torque that the drive reports",
        lambda t: swap(t, t.drive.faults, "torque_gain", t.value), 2.0, "1", 0.01, 10.0,
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
        "the drive's clock runs too fast or too slow", lambda t: swap(t, t.drive.faults, "clock_drift", t.value),
        0.01, "relative", -0.1, 0.1,
    ),
    "digital_input": FaultKind("an input of the drive is active (0x60FD)", _digital_input, 3, "bit", 0, 31),
    "position_stuck": FaultKind("0x6064 repeats its last value", lambda t: _stuck(t, 0x6064)),
    "velocity_stuck": FaultKind("0x606C repeats its last value", lambda t: _stuck(t, 0x606C)),
    "position_gain": FaultKind(
        "0x6064 is wrong by a factor", lambda t: _scaled(t, 0x6064), 2.0, "of the motor angle", -10, 10
    ),
    "velocity_gain": FaultKind("0x606C is wrong by a factor", lambda t: _scaled(t, 0x606C), 2.0, "1", -10, 10),
    "motor_encoder_stuck": FaultKind("the motor encoder stops: 0x6064 is held, 0x606C is 0", _motor_encoder_stuck),
    "reported_gain": FaultKind("0x6077 is wrong by a factor", lambda t: _scaled(t, 0x6077), 0.5, "1", -10, 10),
    "reported_offset": FaultKind("0x6077 is wrong by an offset", _reported_offset, 0.2, "N*m", -100, 100),
    "reported_stuck": FaultKind("0x6077 repeats its last value", lambda t: _stuck(t, 0x6077)),
    "encoder_stuck": FaultKind("the joint encoder repeats its last value", _encoder_stuck, needs="encoder"),
    "encoder_bit": FaultKind("a bit of the joint encoder is stuck at 1", _encoder_bit, 12, "bit", 0, 31, "encoder"),
    "forged_tpdo": FaultKind(
        "another node sends old TPDOs under the identifiers of this one", _forged, 1e-3, "s between frames", 1e-4, 1.0
    ),
    "fraying": FaultKind(
        "the tendons fray: the pretension drops", _fraying, 2.0, "of the pretension per second", 0, 100
    ),
    "dead_stage": FaultKind(
        "the power stage loses its voltage: no torque, bit 4 low, still enabled",
        lambda t: swap(t, t.drive.faults, "dead_stage", True),
    ),
    "flapping_stage": FaultKind("the power stage is off for half of each 0.1 s", _flapping),
    "torque_off": FaultKind("safe torque off; after the duration its input is closed again", _torque_off),
    "derating": FaultKind(
        "the drive overheats and limits its torque: bit 11 is set",
        lambda t: swap(t, t.drive.faults, "most_torque", t.value),
        0.2, "of rated torque", 0, 10,
    ),
    "polarity": FaultKind("0x607E is inverted: torque, position and velocity change their sign", _polarity),
    "encoder_drift": FaultKind("the joint encoder drifts", _encoder_drift, 0.5, "rad/s", -100, 100, "encoder"),
    "encoder_noise": FaultKind(
        "the joint encoder is noisy", lambda t: swap(t, _encoder(t), "noise", t.value), 1e-3, "rad RMS", 0, 10,
        "encoder",
    ),
    "encoder_slip": FaultKind(
        "the joint encoder's coupling slips", _encoder_slip, 0.5, "of the joint motion", -10, 10, "encoder",
    ),
    "torque_sensor_gain": FaultKind(
        "the joint torque sensor is wrong by a factor",
        lambda t: swap(t, _sensor(t), "gain", t.value),
        -1.0, "of the torque", -10, 10, "torque_sensor",
    ),
    "watchdogs_lost": FaultKind("the drive's time-outs are cleared, and no frame on the bus shows it", _watchdogs_lost),
    "sparse_rpdo": FaultKind(
        "this many commands in a row do not reach the node, then one does",
        lambda t: swap(t, t.node, "lost_in_a_row", int(t.value)), 2, "RPDOs", 0, 1000,
    ),
    "deaf": FaultKind("broken wire: the node sends but receives nothing", lambda t: swap(t, t.node, "unhearing", True)),
}  # fmt: skip


CHANGES: Mapping[str, FaultKind] = {
    "friction": FaultKind(
        "the friction coefficient changes",
        lambda t: parameter(t, "friction", t.value * t.axis.friction),
        0.5, "of the initial value", 0, 10,
    ),
    "pretension": FaultKind(
        "the pretension changes",
        lambda t: parameter(t, "pretension_factor", t.value),
        0.5, "of the initial value", 0, 10,
    ),
    "bending": FaultKind(
        "the bending angle changes; the path length follows (3.50)",
        lambda t: parameter(t, "theta_factor", t.value),
        1.2, "of the bending angle", 0, 10,
    ),
    "push": FaultKind(
        "an external torque acts on the joint", lambda t: parameter(t, "push", t.value), 0.5, "N*m", -100, 100
    ),
    "let_go": FaultKind("the hand releases the joint", lambda t: parameter(t, "hand_factor", 0.0)),
}  # fmt: skip
"""What may happen to a healthy rig while it runs; begun, ended and parsed as faults are."""


def check_fault(fault: FaultSettings, where: str, others: Mapping[str, FaultKind] = NO_OTHERS) -> FaultKind:
    """Return the kind of a fault; raises UsageError for an unknown name or a value out of range.

    Args:
        fault: the fault.
        where: its place in the file, for the message.
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
    if kind.unit in COUNTED and fault.value != int(fault.value):
        raise UsageError(
            f"{where}: fault {fault.name}: value {fault.value:g}; "
            f"allowed are whole numbers from {kind.low:g} to {kind.high:g} ({kind.unit})"
        )
    return kind


def parse_fault(text: str, others: Mapping[str, FaultKind] = NO_OTHERS) -> tuple[str | None, FaultSettings]:
    """Parse a line like `torn_tendon axis=knee value=1 duration=0.5` of the control socket; axis None is the first."""
    name, *pairs = text.split()
    values: dict[str, Any] = {"name": name}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or key in values:
            raise UsageError(f"fault {name}: found '{pair}'; write key=value, each key once")
        if key not in KEYS:
            raise UsageError(f"fault {name}: unknown key '{key}'; keys are {', '.join(KEYS)}")
        values[key] = _number(f"fault {name}", key, value) if KEYS[key] is float else value
    axis = values.pop("axis", None)
    try:
        fault = msgspec.convert(values, FaultSettings)
    except msgspec.ValidationError as error:
        explained = settings.explain(str(error), FaultSettings, values)
        raise UsageError(f"fault {name}: {explained}") from None
    check_fault(fault, "control", others)
    return axis, fault


KEYS = {"axis": str, "node": str, "value": float, "duration": float, "at": float}  # of the control socket


def _number(where: str, key: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise UsageError(f"{where}: {key}={text}; allowed is a finite number, for example {key}=1")
    return number


class FaultPlan:
    """Schedule the start and the end of faults by time; `active` is the number of active faults."""

    def __init__(self) -> None:
        self.active = 0
        self._queue: list[tuple[float, int, Callable[[float], None]]] = []
        self._undo: dict[int, Undo] = {}
        self._number = itertools.count()

    def schedule(self, at: float, action: Callable[[float], None]) -> None:
        heapq.heappush(self._queue, (at, next(self._number), action))

    def start(self, kind: FaultKind, target: Target) -> None:
        """Start a fault now. It ends after its duration; with duration 0 it stays active."""
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
        """End all faults, the last one first, and return their number."""
        count = len(self._undo)
        for number in sorted(self._undo, reverse=True):
            self._end(number, now)
        return count

    def tick(self, now: float) -> None:
        while self._queue and self._queue[0][0] <= now:
            heapq.heappop(self._queue)[2](now)
