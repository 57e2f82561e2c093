"""Read back one object at a time in spare bus time while the loop runs; the loop never waits for an answer.

The loop sees a write by SDO on this bus at once (`Rig`). This module finds changes that the bus does not show: by a
tool on another port, or by a node that lost its settings. This includes the watchdogs and the torque clamp.

One object is read every 20 ms, and proportionally more slowly below 1 Mbit/s: the 80 objects of an axis take 2 s.
Equally often one of the drives is asked in turn which command it received last (`Hearing`). An emergency stop at a
drive's inputs has priority over both (`StopInput`).
"""

from __future__ import annotations

import itertools
import math
import struct
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from tsa_ctrl.bus.canopen import objects
from tsa_ctrl.bus.canopen.cia301 import SDO_REQUEST
from tsa_ctrl.bus.canopen.objects import Object
from tsa_ctrl.bus.drive.checks import Report
from tsa_ctrl.bus.live.image import Image
from tsa_ctrl.bus.wire.seam import Bus

# Which command a drive heard last: what its 0x6071 holds, asked for now and then, against what was sent to it.
#
# A command that is lost on its way, or in a drive that looks at its PDOs too seldom, tells nothing: the RPDO timer
# counts only those that are lost in a row. How far behind its question an answer may lie is the drive's own, a SYNC or
# a cycle of its firmware, and is learned as the least that was ever seen; a little more (JITTER) is no loss. What
# rests, or comes back to a value that it had, shows nothing, and does no harm either.

# commands beyond its usual that a drive may show late: its PDOs and its SDO server are often two tasks, neither in step
# with SYNC; two periods are no danger either, and a drive that hears each fifth command passes them half the time
JITTER = 2
HISTORY = 64  # commands that are remembered: more than a drive may miss before its RPDO timer ends, at 1 kHz


class Hearing:
    """One drive's. Digits of 0x6071, as they are sent.

    Attributes: `sent` (those since the last question, the newest last; whoever sends appends), `asked` (answers since
    the start), `unheard` (of them those that held a command older than they may), `too_many` (of these within a
    second).
    """

    def __init__(self) -> None:
        self.sent: deque[int] = deque(maxlen=HISTORY)
        self.asked = 0
        self.unheard = 0
        self.too_many = 1
        self._known: list[int] = []
        self._usual = HISTORY

    def begin(self, too_many: int) -> None:
        """The drive was configured anew, and may be another one."""
        self.too_many = too_many
        self._usual = HISTORY

    def ask(self) -> None:
        """A question goes out now."""
        self._known = [*self._known, *self.sent][-HISTORY:]
        self.sent.clear()

    def answered(self, value: int) -> None:
        """The answer to the last question."""
        self.asked += 1
        since = list(self.sent)
        everything = [*self._known, *since]
        ages = [age for age, digits in enumerate(reversed(everything)) if digits == value]
        if not ages:  # never sent: rounded or clamped there
            return
        if ages[-1] < len(everything) - 1:  # else it may be of a command before these
            self._usual = min(self._usual, ages[-1])
        self.unheard += ages[0] - len(since) > self._usual + JITTER


# The emergency stop at a drive's digital inputs (0x60FD), read by SDO while the loop runs.
#
# No PDO has room for it: the two that a drive sends are full. It is a second path. The first one is the drive's own
# safe-torque-off input, which needs no software.

UNREAD = 0.25  # s without an answer, after which the state of the stop is unknown; a slow drive answers within 0.05


@dataclass(frozen=True)
class StopBit:
    """Where the stop is wired."""

    bit: int  # of 0x60FD
    level: int  # of that bit while the stop is pressed, 0 or 1


class StopInput:
    """The stop of one axis; writes its state to the axis' image."""

    def __init__(self, node_id: int, entry: Object, wiring: StopBit, image: Image) -> None:
        """`entry`: 0x60FD of the axis."""
        self.node_id = node_id
        self.entry = entry
        self._wiring = wiring
        self._image = image
        self._due = math.inf  # s, when the state becomes unknown

    def asked(self, now: float) -> None:
        """Judge how long no answer has come, at each question; `now` in s."""
        self._due = min(self._due, now + UNREAD)
        if now >= self._due and self._image.pressed is None:
            self._image.pressed = f"{self._image.nodes[0]}: no answer about {self.entry} for {UNREAD:g} s"

    def answered(self, value: int) -> None:
        """Take the value of 0x60FD."""
        self._due = math.inf
        pressed = value >> self._wiring.bit & 1 == self._wiring.level
        self._image.pressed = f"{self._image.nodes[0]}: bit {self._wiring.bit} of {self.entry}" if pressed else None


INTERVAL = 0.02  # s between two questions at `BITRATE`: question and answer are 1.3 % of the bus then
# s between two questions for a command, no multiple of any cycle: else the same of those that a drive hears by turns
# would be met each time. The part beyond 20 ms is the golden ratio's of a millisecond.
LISTEN = 0.020618
LEAST_UNHEARD = 3  # commands within a second, where few are asked for: one that is lost with an error stops nothing
BITRATE = 1_000_000  # bit/s
PATIENCE = 1.0  # s for an answer; what does not come is asked again in the next round
STOP_PATIENCE = 0.05  # s, after which the emergency stop is asked for although another answer has not come
STOP_INTERVAL = 0.05  # s at most between two questions for it, however slow the bus is
BETWEEN = 4  # other objects between two questions for a torque offset, which turns the motor at command 0
_MOVES = frozenset({objects.CONTROLWORD.name, objects.TARGET_TORQUE.name, objects.MODE.name})  # others write them, too
_QUESTION = struct.Struct("<BHB4x")
_KEY = struct.Struct("<xHB")
_UPLOAD = 0x40
_FITS = 4  # bytes of an expedited answer; larger objects need several frames and are not read back here
_EXPEDITED = 0x43  # with its data in the frame, of as many bytes as bits 2 and 3 leave
_EXPEDITED_BITS = 0xE3


@dataclass(frozen=True)
class Held:
    """An object of a node, and the value that was read back at the start."""

    node_id: int
    entry: Object
    value: int


def held_by(report: Report) -> tuple[Held, ...]:
    """Everything that a bring-up wrote and the loop does not change; what a drive shares with another axis once."""
    rows = [
        Held(node.node_id, row.entry, row.after)
        for node in report.nodes
        for row in node.rows
        if row.after is not None and row.entry.name not in _MOVES and row.entry.type.size <= _FITS
    ]
    return tuple(dict.fromkeys(rows))


@dataclass(frozen=True)
class Heard:
    """Where a drive shows the command that it heard last."""

    node_id: int
    entry: Object
    hearing: Hearing


def _rotation(held: Sequence[Held]) -> Iterator[Held]:
    """Yield all objects by turns without end, and a torque offset after every `BETWEEN` others."""
    offsets = [each for each in held if each.entry.name == objects.TORQUE_OFFSET.name]
    others = [each for each in held if each not in offsets]
    if not offsets or not others:
        yield from itertools.cycle(held)
    turn = itertools.cycle(offsets)
    for number, each in enumerate(itertools.cycle(others)):
        if number % BETWEEN == 0:
            yield next(turn)
        yield each


class ReadBack:
    """Asks and compares; `altered` says for each node what it no longer holds as it was written."""

    def __init__(
        self,
        bus: Bus,
        bitrate: int,
        held: Iterable[Held],
        heard: Sequence[Heard] = (),
        lost_share: float = 1.0,
        stops: Sequence[StopInput] = (),
    ) -> None:
        """`bitrate` in bit/s; `lost_share`: 1, of the commands asked for in a second that may be older ones."""
        self.altered: dict[int, str] = {}
        self._send = bus.send
        slower = max(1.0, BITRATE / bitrate)
        self._interval, self._listen = INTERVAL * slower, LISTEN * slower
        self._round = _rotation(tuple(held))
        self._drives = itertools.cycle(heard)
        self._stops = itertools.cycle(stops)
        self._stop_interval = min(self._interval, STOP_INTERVAL) / max(1, len(stops))
        self._asked: Held | Heard | StopInput | None = None
        self._again: Held | None = None  # differed, and is asked once more before it counts
        self._next = -math.inf
        self._next_heard = -math.inf if heard else math.inf
        self._next_stop = -math.inf if stops else math.inf
        self._asked_at = -math.inf
        for each in heard:
            asked = 1.0 / (self._listen * len(heard))  # in a second
            each.hearing.begin(max(LEAST_UNHEARD, math.ceil(lost_share * asked)))

    def update(self, now: float) -> None:
        """Ask for the next object when it is due; `now` in s, monotonic."""
        if now < self._next and now < self._next_heard and now < self._next_stop:
            return
        if now >= self._next_stop and (self._asked is None or now >= self._asked_at + STOP_PATIENCE):
            self._next_stop = now + self._stop_interval
            stop = next(self._stops)
            stop.asked(now)
            self._ask(stop, now)
            return
        if self._asked is not None and now < self._asked_at + PATIENCE:
            return
        asked: Held | Heard
        if now < self._next and now < self._next_heard:
            return
        if now >= self._next:
            self._next = now + self._interval
            asked = self._again or next(self._round)
        else:
            behind = now - self._next_heard  # of a grid that is no cycle's
            self._next_heard = now + self._listen - (behind if behind < self._listen else 0.0)
            asked = next(self._drives)
            asked.hearing.ask()
        self._ask(asked, now)

    def _ask(self, asked: Held | Heard | StopInput, now: float) -> None:
        self._asked, self._asked_at = asked, now
        self._send(SDO_REQUEST + asked.node_id, _QUESTION.pack(_UPLOAD, *asked.entry.key))

    def answer(self, node_id: int, data: bytes) -> bool:
        """An SDO answer of a node; True when it shows for the second time what was not written."""
        asked = self._asked
        if asked is None or asked.node_id != node_id or len(data) != 8 or _KEY.unpack_from(data) != asked.entry.key:
            return False
        self._asked = None
        known = data[0] & _EXPEDITED_BITS == _EXPEDITED  # else an abort, or more than fits
        if isinstance(asked, StopInput):
            if known:
                asked.answered(asked.entry.decode(data[4:8]))
            return False
        if isinstance(asked, Heard):
            if known:
                asked.hearing.answered(asked.entry.decode(data[4:8]))
            return False
        if not known:
            self._again = None
            return False
        found = asked.entry.decode(data[4:8])
        if found == asked.value:
            self._again = None
        elif self._again is None:
            self._again = asked
        else:
            self._again = None
            self.altered[node_id] = (
                f"{asked.entry} is {asked.entry.shown(found)}, at the start it was {asked.entry.shown(asked.value)}"
            )
            return True
        return False
