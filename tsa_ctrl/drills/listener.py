"""Watch the drives in a separate process: `python -m tsa_ctrl.drills.listener CONTROLLER.toml`.

It reads one word per line on stdin and answers each with one line of JSON:

- `torque`: return the last torque of each axis.
- `begin`: another loop is started.
- `pull`: return sign and gain of the motor torque of each axis.
- `guard`: record observations from now on.
- `quiet`: end the guard, and return its observations.
- `armed`: return the time-outs stored in the drives.
- `end`: end the process.

Drives report on SYNC, which ends with the loop. It must not be replaced, because the RPDO timer of some drives acts on
SYNC only. A drive that sends no TPDOs is therefore read by SDO, which has no effect on it. A drive that still has
torque when the guard ends is switched off.

`pull` tests sign and gain while a small motor torque begins. The torque stretches the tendons, so that motor and joint
move apart with its sign, both on a locked and on a free joint. A joint torque sensor follows by at most r_J/r_M. Both
relations are straight lines through all samples of the pull. The tested loop decides with a different filter
(`safety.polarity_check`). A joint that something else moves is not judged, because its friction stretches the tendons a
hundred times as far as a small torque does.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import signal
import statistics
import struct
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Literal, NamedTuple

import msgspec

from tsa_ctrl.bus.canopen import cia301, objects
from tsa_ctrl.bus.canopen.cia301 import NmtCommand
from tsa_ctrl.bus.canopen.cia402 import Controlword
from tsa_ctrl.bus.canopen.pdo import DriveLayout
from tsa_ctrl.bus.drive.network import layout_of, open_buses
from tsa_ctrl.bus.drive.profile import drive_scale
from tsa_ctrl.bus.live.axis import Axis
from tsa_ctrl.bus.wire.bus import Bus
from tsa_ctrl.config import Configuration, load_configuration
from tsa_ctrl.errors import TsaError
from tsa_ctrl.model.steady_sliding import wound_by_friction
from tsa_ctrl.safety.polarity_check import CLEAR, EXCESS, FAR, RESTING, SHOWN
from tsa_ctrl.system.process_supervisor import READY, ignore

KEPT = 4000  # maximum number of samples of each axis: the last seconds
LEAST = 20  # minimum number of samples
HALF = 0.5  # share of the largest torque
MOVED = 0.03  # share of rated torque by which the torque must have changed


class Pull(msgspec.Struct, frozen=True, kw_only=True):
    """Observations of one axis. Correlations are dimensionless; None means that nothing can be observed."""

    stretch: float | None  # correlation of the motor torque with the angle between motor and joint
    sensor: float | None  # correlation of the motor torque with the joint torque sensor
    gain: float | None  # N*m at the joint per N*m of the motor, if the sensor follows clearly
    geared: float  # r_J/r_M: the gain of the pulleys

    @property
    def wrong(self) -> str:
        """Return the contradiction in words, or an empty text."""
        shown = self.stretch if self.stretch is not None else self.sensor
        if shown is not None and shown < -SHOWN:
            return (
                "motor and joint answer the motor's torque the wrong way round: torque_sign and position_sign of the "
                "drive, sign of the encoder, crossed tendons or motor wires"
            )
        if self.gain is not None and self.gain > EXCESS * self.geared:
            return (
                f"the joint torque sensor follows the motor's torque by {self.gain:.2f}, the pulleys give "
                f"{self.geared:.2f} at most: torque constant and rated torque of the motor, gain of the sensor"
            )
        return ""

    def __str__(self) -> str:
        """Return the text for the table of results."""
        shown = self.stretch if self.stretch is not None else self.sensor
        if self.wrong:
            return "WRONG"
        if shown is None or shown < SHOWN:
            return "not shown"
        return "right" if self.gain is None else f"right, gain {self.gain:.2f} of {self.geared:.2f}"


class Row(NamedTuple):
    """Values of one cycle; a missing value is nan."""

    torque: float  # N*m, of the motor
    apart: float  # rad, q_m - (r_J/r_M) q_j
    joint: float  # N*m, of the joint torque sensor
    angle: float  # rad, r_J/r_M times the joint angle; the motor angle without a joint encoder


def pull(rows: Sequence[Row], rated: float, geared: float, wound: float) -> Pull:
    """Return the observations of one axis.

    Args:
        rows: samples in order.
        rated: rated torque, N*m.
        geared: r_J/r_M.
        wound: rad at the motor by which friction stretches the tendons.
    """
    torques = [row.torque for row in rows]
    nothing = Pull(stretch=None, sensor=None, gain=None, geared=geared)
    if len(rows) < LEAST or max(torques) - min(torques) < MOVED * rated:
        return nothing
    least = RESTING * wound
    if _moved_by_something(rows, MOVED * rated, least):
        return nothing
    stretch, _ = _line(torques, [row.apart for row in rows])
    most = max(map(abs, torques))
    upper = [row for row in rows if abs(row.torque) > HALF * most]  # below it the sheath's friction may absorb it all
    sensor, slope = _line([row.torque for row in upper], [row.joint for row in upper])
    held = _range([row.angle for row in rows]) <= least  # otherwise a hand may act too
    clear = sensor is not None and slope is not None and sensor > CLEAR and slope < (FAR if held else EXCESS) * geared
    return Pull(stretch=stretch, sensor=sensor, gain=slope if clear else None, geared=geared)


def _moved_by_something(rows: Sequence[Row], begun: float, least: float) -> bool:
    """Return True if the joint moved by `least` rad without torque (below `begun`, N*m), or against the motor.

    A motor that moves its joint leads it. A motor that its joint drags along lags.
    """
    if _range([row.angle for row in rows if abs(row.torque) < begun]) > least:
        return True
    angles = [row.angle for row in rows]
    against, _ = _line(angles, [row.apart for row in rows])
    return _range(angles) > least and against is not None and against < -SHOWN


def _range(values: Sequence[float]) -> float:
    """Return the range of the finite values, or 0 without any."""
    known = [value for value in values if math.isfinite(value)]
    return max(known) - min(known) if known else 0.0


def _line(x: Sequence[float], y: Sequence[float]) -> tuple[float | None, float | None]:
    """Return correlation and slope; None if a value is missing or a quantity is constant."""
    if not all(map(math.isfinite, (*x, *y))):
        return None, None
    try:
        return statistics.correlation(x, y), statistics.linear_regression(x, y).slope
    except statistics.StatisticsError:
        return None, None


class Watch:
    """Observe one axis in parallel with its loop. `take` must receive every frame, including SYNC."""

    def __init__(self, configuration: Configuration, index: int, axis: Axis) -> None:
        """`axis` is a separate object of this process that sends no commands."""
        model, drive = configuration.models[index], axis.nodes.drive
        self._axis = axis
        self._geared = model.joint_pulley_radius / model.motor_pulley_radius
        self._rated = drive.rated_torque * drive.gear_ratio
        self._wound = wound_by_friction(model)
        self._inboxes = dict(zip(axis.tpdo_ids, axis.inboxes, strict=True))
        self._rows: deque[Row] = deque(maxlen=KEPT)
        self._arm()

    @property
    def can_ids(self) -> Iterable[int]:
        """Return the identifiers of the frames that `take` must receive."""
        return (cia301.SYNC, *self._inboxes)

    def begin(self) -> None:
        """Discard the rows of the previous loop before another one starts."""
        self._rows.clear()

    def take(self, can_id: int, data: bytes, now: float) -> None:
        """Process a frame received at `now` (s)."""
        if can_id == cia301.SYNC:
            self._close(now)
            return
        inbox = self._inboxes.get(can_id)
        if inbox is not None and len(data) == inbox.length:
            inbox.store(inbox.unpack(data))
            inbox.armed = False

    def _close(self, now: float) -> None:
        """Add the answers to the last SYNC as one sample if all of them have arrived."""
        image = self._axis.image
        if not any(inbox.armed for inbox in self._inboxes.values() if inbox.every == 1):
            self._axis.settle(now, True)
            geared = self._geared * image.q_j
            angle = geared if math.isfinite(geared) else image.q_m
            self._rows.append(Row(image.tau_m, image.q_m - geared, image.tau_j, angle))
        self._arm()

    def _arm(self) -> None:
        for inbox in self._inboxes.values():
            inbox.armed = True

    def seen(self) -> Pull:
        return pull(tuple(self._rows), self._rated, self._geared, self._wound)


# Observed torque of each drive, and its evaluation by pure functions.

Source = Literal["tpdo", "sdo"]


class Sample(msgspec.Struct, frozen=True, array_like=True):
    """A torque that a drive reported, N*m at the motor pulley. `clock` is the arrival in s of CLOCK_MONOTONIC."""

    clock: float
    node: int
    torque: float
    source: Source


class Said(msgspec.Struct, frozen=True, array_like=True):
    """An EMCY of a drive; `clock` as in `Sample`."""

    clock: float
    node: int
    code: int


class Timing(msgspec.Struct, frozen=True, kw_only=True):
    """Times of one drive in one trial, in s since the loop was stopped; None if not observed."""

    torque_before: float | None  # N*m, last value before the stop
    last_torque: float | None  # time of the last sample with torque
    zero_after: float | None  # time of the first sample without torque after which no torque returned
    source: Source | None  # source of that sample


def timing(samples: Sequence[Sample], node: int, stopped: float, zero: float) -> Timing:
    """Return the times of a drive.

    `zero_after` is an upper bound: the torque fell between `last_torque` and `zero_after`.

    Args:
        samples: samples in order of arrival.
        node: node id of the drive.
        stopped: time at which the loop was stopped, on the clock of the samples, s.
        zero: torque that counts as zero, N*m.
    """
    mine = [sample for sample in samples if sample.node == node]
    before = [sample.torque for sample in mine if sample.clock < stopped]
    after = [sample for sample in mine if sample.clock >= stopped]
    place = max((n for n, sample in enumerate(after) if abs(sample.torque) > zero), default=-1)
    first = after[place + 1] if place + 1 < len(after) else None
    return Timing(
        torque_before=before[-1] if before else None,
        last_torque=after[place].clock - stopped if place >= 0 else None,
        zero_after=None if first is None else first.clock - stopped,
        source=None if first is None else first.source,
    )


class Watchdog(msgspec.Struct, frozen=True, kw_only=True):
    """The watchdog of a drive that removed the torque, according to the EMCY of the drive."""

    acted: str | None  # "rpdo" (0x8250), "heartbeat" (0x8130); None without such an EMCY
    after: float | None  # s since the loop was stopped
    warning: str  # about a watchdog that was armed and did not act in time


_CODES = {0x8250: "rpdo", 0x8130: "heartbeat"}
_NAMES = {
    "rpdo": "the RPDO event timer (0x1400:5)",
    "heartbeat": "the heartbeat consumer (0x1016)",
    "guarding": "life guarding (0x100D)",
}
_LATE = 1.25  # factor on its time-out, and
_SLACK = 0.02  # s added to it, after which a watchdog counts as not acting


def watchdog(said: Sequence[Said], node: int, stopped: float, armed: Mapping[str, int], loop_dead: bool) -> Watchdog:
    """Return the watchdog that acted, by comparing the EMCYs of a drive with its time-outs (ms).

    While the loop runs (`loop_dead` is False), the RPDO timer need not act.
    """
    mine = [one for one in said if one.node == node and one.clock >= stopped and one.code in _CODES]
    first = mine[0] if mine else None
    acted = None if first is None else _CODES[first.code]
    after = None if first is None else first.clock - stopped
    due = {name: time * 1e-3 for name, time in armed.items() if loop_dead or name != "rpdo"}
    idle = [
        name
        for name, time in sorted(due.items(), key=lambda item: item[1])
        if after is not None and acted != name and not _same(acted, name) and after > _LATE * time + _SLACK
    ]
    warning = ""
    if idle and after is not None and acted is not None:
        warning = (
            f"{_NAMES[idle[0]]} is armed with {1e3 * due[idle[0]]:.0f} ms and did not act: {_NAMES[acted]} did, after "
            f"{1e3 * after:.0f} ms; the torque lasts that long when this computer dies"
        )
    return Watchdog(acted=acted, after=after, warning=warning)


def _same(acted: str | None, name: str) -> bool:
    """Return True if the two watchdogs send the same EMCY: life guarding and heartbeat."""
    return {acted, name} == {"heartbeat", "guarding"}


SILENT = 0.01  # s without a TPDO after which a drive is read by SDO
ASK = 0.002  # s between two requests if the last one was answered
UNANSWERED = 0.5  # s after which a request counts as lost
PATIENCE = 1.0  # s to wait for the answer about a time-out
ZERO_SHARE = 0.02  # share of rated torque up to which torque counts as zero
_UPLOAD = struct.Struct("<BHB4x")
_ANSWER = struct.Struct("<BHB4s")
_EXPEDITED = 0x43  # answer to an upload, with its size; bits 2 and 3 hold the number of unused bytes
_CONSUMERS = 4  # entries of 0x1016 that are read
_DOWNLOAD_WORD = struct.Struct("<BHBH2x")


class Drive:
    """State of one drive in the listener."""

    def __init__(self, node: int, torque: float, rated: float, layout: DriveLayout, slot: int) -> None:
        self.node = node
        self.layout = layout
        self.torque_actual = objects.TORQUE_ACTUAL.of(slot)
        self.controlword = objects.CONTROLWORD.of(slot)
        self.torque_per_digit = torque
        self.zero = ZERO_SHARE * rated
        self.last: float | None = None  # N*m
        self.heard = 0.0
        self.asked = 0.0
        self.waits = False  # a request is not answered yet
        self.guard_time = 0  # ms
        self.armed: dict[str, int] = {}  # time-outs of its watchdogs, ms


class Listener:
    """Observe all drives of a configuration on `bus`; `step` processes one frame."""

    def __init__(self, configuration: Configuration, bus: Bus, clock: Callable[[], float] = time.monotonic) -> None:
        self._bus = bus
        self._clock = clock
        self._drives: dict[str, Drive] = {}  # by axis
        self._tpdo: dict[int, Drive] = {}
        self._sdo: dict[int, list[Drive]] = {}
        self._emcy: dict[int, int] = {}
        self._watches: dict[str, Watch] = {}  # by axis
        for index, (axis, profile) in enumerate(zip(configuration.file.axes, configuration.profiles, strict=True)):
            self._watches[axis.name] = Watch(configuration, index, Axis(axis, profile, bus))
            settings = axis.drive
            scale = drive_scale(settings, profile, f"axis '{axis.name}'")
            rated = settings.rated_torque * settings.gear_ratio
            drive = Drive(settings.node_id, scale.torque, rated, layout_of(settings), settings.slot)
            self._drives[axis.name] = drive
            self._tpdo[drive.layout.tpdo_ids[0]] = drive
            self._sdo.setdefault(cia301.SDO_ANSWER + drive.node, []).append(drive)
            self._emcy[cia301.EMCY + drive.node] = drive.node
        watched = {can_id for watch in self._watches.values() for can_id in watch.can_ids}
        bus.accept([*self._sdo, *self._emcy, *(watched | set(self._tpdo))])
        self._guard = False
        self.samples: list[Sample] = []
        self.said: list[Said] = []

    def torques(self) -> dict[str, float | None]:
        return {axis: drive.last for axis, drive in self._drives.items()}

    def begin(self) -> None:
        for watch in self._watches.values():
            watch.begin()

    def pulls(self) -> dict[str, Pull]:
        """Return the observations of each axis since `begin`."""
        return {axis: watch.seen() for axis, watch in self._watches.items()}

    def guard(self) -> None:
        self._guard = True
        self.samples, self.said = [], []

    def quiet(self) -> tuple[list[Sample], list[Said]]:
        """End the guard and return its observations; switch off a drive with torque by every available means."""
        self._guard = False
        for drive in self._drives.values():
            if drive.last is not None and abs(drive.last) > drive.zero:
                self.switch_off(drive)
        return self.samples, self.said

    def switch_off(self, drive: Drive) -> None:
        off = int(Controlword.DISABLE_VOLTAGE)
        self._bus.send(drive.layout.rpdo_id, drive.layout.command.struct.pack(off, 0))
        self._bus.send(cia301.SYNC, b"")
        self._bus.send(cia301.SDO_REQUEST + drive.node, _DOWNLOAD_WORD.pack(0x2B, *drive.controlword.key, off))
        self._bus.send(cia301.NMT, cia301.nmt(NmtCommand.STOP, drive.node))

    def armed(self) -> dict[str, dict[str, int]]:
        """Return the time-outs stored in the drives by axis, ms (`rpdo`, `heartbeat`, `guarding`), if not 0."""
        for drive in self._drives.values():
            drive.armed = {}
            timer = drive.layout.command.communication(5, objects.Type.U16, "")
            consumers = [(objects.HEARTBEAT_CONSUMER.index, number) for number in range(1, _CONSUMERS + 1)]
            for key in (timer.key, objects.GUARD_TIME.key, objects.LIFE_TIME_FACTOR.key, *consumers):
                self._ask(drive, key)
                end = self._clock() + PATIENCE
                while drive.waits and self._clock() < end:
                    self.step(0.01)
        return {axis: drive.armed for axis, drive in self._drives.items()}

    def step(self, timeout: float) -> None:
        """Wait at most `timeout` s for one frame and process it; on guard, read drives that no longer send TPDOs."""
        frame = self._bus.recv(timeout)
        now = self._clock()
        if frame is not None:
            self._take(*frame, now)
        if self._guard:
            for drive in self._drives.values():
                patience = UNANSWERED if drive.waits else ASK
                if now - drive.heard > SILENT and now >= drive.asked + patience:
                    self._ask(drive, drive.torque_actual.key)

    def _ask(self, drive: Drive, key: tuple[int, int]) -> None:
        drive.asked, drive.waits = self._clock(), True
        self._bus.send(cia301.SDO_REQUEST + drive.node, _UPLOAD.pack(0x40, *key))

    def _take(self, can_id: int, data: bytes, now: float) -> None:
        if not self._guard:
            for watch in self._watches.values():
                watch.take(can_id, data, now)
        drive = self._tpdo.get(can_id)
        if drive is not None:
            if len(data) == drive.layout.motion.length:
                drive.heard = now
                self._keep(drive, drive.layout.motion.struct.unpack(data)[1], now, "tpdo")
        elif can_id in self._emcy:
            found = cia301.decode(data)
            if self._guard and found is not None and not found.is_reset:
                self.said.append(Said(now, self._emcy[can_id], found.code))
        elif can_id in self._sdo and len(data) == _ANSWER.size:
            for drive in self._sdo[can_id]:
                self._answer(drive, data, now)

    def _answer(self, drive: Drive, data: bytes, now: float) -> None:
        drive.waits = False
        command, index, sub, value = _ANSWER.unpack(data)
        if command & 0xE3 != _EXPEDITED:
            return
        size = 4 - (command >> 2 & 0x03)
        number = int.from_bytes(value[:size], "little")
        if (index, sub) == drive.torque_actual.key and size == objects.TORQUE_ACTUAL.type.size:
            self._keep(drive, objects.TORQUE_ACTUAL.decode(value), now, "sdo")
        elif index == objects.HEARTBEAT_CONSUMER.index and number & 0xFFFF and number >> 16 & 0x7F:
            drive.armed["heartbeat"] = number & 0xFFFF
        elif index == drive.layout.command.communication(5, objects.Type.U16, "").index and number:
            drive.armed["rpdo"] = number
        elif index == objects.GUARD_TIME.index:
            drive.guard_time = number
        elif index == objects.LIFE_TIME_FACTOR.index and number * drive.guard_time:
            drive.armed["guarding"] = number * drive.guard_time

    def _keep(self, drive: Drive, digits: int, now: float, source: str) -> None:
        drive.last = digits * drive.torque_per_digit
        if self._guard:
            self.samples.append(Sample(now, drive.node, drive.last, "tpdo" if source == "tpdo" else "sdo"))


def main(argv: list[str]) -> int:
    """Serve until an end is requested, or until stdin closes."""
    ignore(signal.SIGINT, signal.SIGHUP)
    try:
        configuration = load_configuration(argv[0])
        bus = open_buses(configuration.file.buses, configuration.file.axes)
    except TsaError as error:
        print(error, flush=True)
        return error.exit_code
    listener = Listener(configuration, bus)
    with contextlib.suppress(BrokenPipeError):  # the parent has ended: no process receives the answer
        return _serve(listener, 0.5 * configuration.period)
    return 1


def _serve(listener: Listener, patience: float) -> int:
    """Answer the requests on stdin; `patience` is the longest wait for a frame, s."""
    os.write(1, READY)
    received = b""
    while True:
        listener.step(patience)
        if not select.select([0], [], [], 0.0)[0]:
            continue
        data = os.read(0, 4096)
        if not data:
            return 0
        received += data
        while b"\n" in received:
            word, _, received = received.partition(b"\n")
            if word == b"end":
                return 0
            sys.stdout.buffer.write(msgspec.json.encode(_answer(listener, word.decode())) + b"\n")
            sys.stdout.flush()


def _answer(listener: Listener, word: str) -> object:
    if word == "guard":
        listener.guard()
        return True
    if word == "quiet":
        samples, said = listener.quiet()
        return {"samples": samples, "said": said}
    if word == "armed":
        return listener.armed()
    if word == "begin":
        listener.begin()
        return True
    if word == "pull":
        return listener.pulls()
    return listener.torques()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
