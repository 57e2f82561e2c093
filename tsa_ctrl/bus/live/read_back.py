"""Read back one object at a time in spare bus time while the loop runs; the loop never waits for an answer.

`Rig` detects an SDO write on this bus immediately. This module detects changes that the bus does not show: by a tool on
another port, or by a node that lost its settings. They include the watchdogs and the torque clamp.

One object is read every 20 ms, and proportionally more slowly below 1 Mbit/s: the 80 objects of an axis take 2 s. At
the same rate, the last received command of each drive is read in rotation (`CommandReadback`). An emergency stop at a
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
from tsa_ctrl.bus.wire.bus import Bus

# Number of commands by which an answer may exceed the drive's usual delay, because PDOs and the SDO server are often
# separate tasks. A delay of two periods is harmless. A drive that receives only every fifth command exceeds it half
# the time.
JITTER = 2
HISTORY = 64  # stored commands: at 1 kHz more than a drive may miss before its RPDO timer expires


class CommandReadback:
    """Detect lost commands of one drive by comparing its 0x6071, read periodically, with the commands sent.

    The RPDO timer of a drive detects only a sequence of lost commands. The usual delay of an answer depends on the
    drive and is learned as the smallest delay so far. An answer with a command that is older by more than `JITTER`
    commands counts as a loss. A command that is constant or returns to an earlier value cannot be checked.

    Attributes:
        sent: commands since the last request, in digits of 0x6071, newest last; the sender appends them.
        asked: answers since startup.
        outdated: answers since startup with too old a command.
        too_many: number of such answers within a second that is a fault.
    """

    def __init__(self) -> None:
        self.sent: deque[int] = deque(maxlen=HISTORY)
        self.asked = 0
        self.outdated = 0
        self.too_many = 1
        self._known: list[int] = []
        self._usual = HISTORY

    def begin(self, too_many: int) -> None:
        """Clear the usual delay after the drive was configured again, because it may be another drive.

        `too_many`: number of answers with too old a command within a second that is a fault.
        """
        self.too_many = too_many
        self._usual = HISTORY

    def ask(self) -> None:
        """Start a new list of commands, because a request is being sent."""
        self._known = [*self._known, *self.sent][-HISTORY:]
        self.sent.clear()

    def answered(self, value: int) -> None:
        """Evaluate the answer to the last request; `value` in digits of 0x6071."""
        self.asked += 1
        since = list(self.sent)
        everything = [*self._known, *since]
        ages = [age for age, digits in enumerate(reversed(everything)) if digits == value]
        if not ages:  # not a sent value: the drive rounds or clamps it
            return
        if ages[-1] < len(everything) - 1:  # otherwise it may belong to a command older than the stored ones
            self._usual = min(self._usual, ages[-1])
        self.outdated += ages[0] - len(since) > self._usual + JITTER


UNREAD = 0.25  # s without an answer after which the stop is unknown; a slow drive answers within 0.05 s


@dataclass(frozen=True)
class StopBit:
    """Wiring of the emergency stop."""

    bit: int  # of 0x60FD
    level: int  # of that bit while the stop is pressed, 0 or 1


class StopInput:
    """Read the emergency stop at a drive's digital inputs (0x60FD) by SDO and store its state in the image of the axis.

    SDO is used because both PDOs of a drive are full. This is a second path. The first one is the drive's
    safe-torque-off input, which needs no software.
    """

    def __init__(self, node_id: int, entry: Object, wiring: StopBit, image: Image) -> None:
        """`entry` is the object 0x60FD of the axis."""
        self.node_id = node_id
        self.entry = entry
        self._wiring = wiring
        self._image = image
        self._due = math.inf  # s, when the state becomes unknown

    def asked(self, now: float) -> None:
        """Check at each request (`now` in s) if an answer is overdue."""
        self._due = min(self._due, now + UNREAD)
        if now >= self._due and self._image.pressed is None:
            self._image.pressed = f"{self._image.nodes[0]}: no answer for {self.entry} within {UNREAD:g} s"

    def answered(self, value: int) -> None:
        """Evaluate the value of 0x60FD."""
        self._due = math.inf
        pressed = value >> self._wiring.bit & 1 == self._wiring.level
        self._image.pressed = f"{self._image.nodes[0]}: bit {self._wiring.bit} of {self.entry}" if pressed else None


INTERVAL = 0.02  # s between two requests at `BITRATE`; request and answer then take 1.3 % of the bus
# s between two requests for a command. It is not a multiple of any cycle, so that the requests do not always coincide
# with the same command of a periodic loss. The part beyond 20 ms is the golden ratio of a millisecond.
LISTEN = 0.020618
LEAST_OUTDATED = 3  # minimum number of lost commands within a second that is a fault; a single loss never is
BITRATE = 1_000_000  # bit/s
PATIENCE = 1.0  # s for an answer; without one, the object is read again in the next round
STOP_PATIENCE = 0.05  # s after which the emergency stop is read although another answer is still missing
STOP_INTERVAL = 0.05  # s, maximum between two requests for the emergency stop, on a slow bus as well
BETWEEN = 4  # other objects between two reads of a torque offset, which moves the motor at command 0
_MOVES = frozenset({objects.CONTROLWORD.name, objects.TARGET_TORQUE.name, objects.MODE.name})  # change while running
_QUESTION = struct.Struct("<BHB4x")
_KEY = struct.Struct("<xHB")
_UPLOAD = 0x40
_FITS = 4  # bytes of an expedited answer; larger objects need several frames and are not read back here
_EXPEDITED = 0x43  # data in the frame; bits 2 and 3 hold the number of unused bytes
_EXPEDITED_BITS = 0xE3


@dataclass(frozen=True)
class Held:
    """An object of a node and its value read back at startup."""

    node_id: int
    entry: Object
    value: int


def held_by(report: Report) -> tuple[Held, ...]:
    """Return all objects that a bring-up wrote and the loop does not change.

    An object that a drive shares with another axis appears once.
    """
    rows = [
        Held(node.node_id, row.entry, row.after)
        for node in report.nodes
        for row in node.rows
        if row.after is not None and row.entry.name not in _MOVES and row.entry.type.size <= _FITS
    ]
    return tuple(dict.fromkeys(rows))


@dataclass(frozen=True)
class ReadTarget:
    """The object in which a drive reports the last command that it received."""

    node_id: int
    entry: Object
    readback: CommandReadback


def _rotation(held: Sequence[Held]) -> Iterator[Held]:
    """Yield all objects in endless rotation, with a torque offset before every `BETWEEN` others."""
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
    """Read objects back and compare them; `altered` holds a message for each node with a changed object."""

    def __init__(
        self,
        bus: Bus,
        bitrate: int,
        held: Iterable[Held],
        targets: Sequence[ReadTarget] = (),
        lost_share: float = 1.0,
        stops: Sequence[StopInput] = (),
    ) -> None:
        """Prepare to read `held`, `targets` and `stops`.

        Args:
            bus: bus of the nodes.
            bitrate: bit/s.
            held: objects that must keep their values.
            targets: objects with the last received command.
            lost_share: share of the answers within a second, 1, that may hold too old a command.
            stops: emergency stop inputs.
        """
        self.altered: dict[int, str] = {}
        self._send = bus.send
        slower = max(1.0, BITRATE / bitrate)
        self._interval, self._listen = INTERVAL * slower, LISTEN * slower
        self._round = _rotation(tuple(held))
        self._drives = itertools.cycle(targets)
        self._stops = itertools.cycle(stops)
        self._stop_interval = min(self._interval, STOP_INTERVAL) / max(1, len(stops))
        self._asked: Held | ReadTarget | StopInput | None = None
        self._again: Held | None = None  # differed once, and counts only if it differs again
        self._next = -math.inf
        self._next_target = -math.inf if targets else math.inf
        self._next_stop = -math.inf if stops else math.inf
        self._asked_at = -math.inf
        for each in targets:
            asked = 1.0 / (self._listen * len(targets))  # requests per second
            each.readback.begin(max(LEAST_OUTDATED, math.ceil(lost_share * asked)))

    def update(self, now: float) -> None:
        """Request the next object when it is due; `now` is monotonic time in s."""
        if now < self._next and now < self._next_target and now < self._next_stop:
            return
        if now >= self._next_stop and (self._asked is None or now >= self._asked_at + STOP_PATIENCE):
            self._next_stop = now + self._stop_interval
            stop = next(self._stops)
            stop.asked(now)
            self._ask(stop, now)
            return
        if self._asked is not None and now < self._asked_at + PATIENCE:
            return
        asked: Held | ReadTarget
        if now < self._next and now < self._next_target:
            return
        if now >= self._next:
            self._next = now + self._interval
            asked = self._again or next(self._round)
        else:
            behind = now - self._next_target  # keeps the grid of `LISTEN`, which matches no cycle
            self._next_target = now + self._listen - (behind if behind < self._listen else 0.0)
            asked = next(self._drives)
            asked.readback.ask()
        self._ask(asked, now)

    def _ask(self, asked: Held | ReadTarget | StopInput, now: float) -> None:
        self._asked, self._asked_at = asked, now
        self._send(SDO_REQUEST + asked.node_id, _QUESTION.pack(_UPLOAD, *asked.entry.key))

    def answer(self, node_id: int, data: bytes) -> bool:
        """Evaluate an SDO answer of a node; return True if an object differs from its value for the second time."""
        asked = self._asked
        if asked is None or asked.node_id != node_id or len(data) != 8 or _KEY.unpack_from(data) != asked.entry.key:
            return False
        self._asked = None
        known = data[0] & _EXPEDITED_BITS == _EXPEDITED  # otherwise an abort, or too large for one frame
        if isinstance(asked, StopInput):
            if known:
                asked.answered(asked.entry.decode(data[4:8]))
            return False
        if isinstance(asked, ReadTarget):
            if known:
                asked.readback.answered(asked.entry.decode(data[4:8]))
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
                f"{asked.entry} is {asked.entry.shown(found)}, but was {asked.entry.shown(asked.value)} at startup"
            )
            return True
        return False
