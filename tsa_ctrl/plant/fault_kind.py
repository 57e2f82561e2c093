"""Define a fault of the simulated machine: the parts it may change, the meaning of its value, how it is undone."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from tsa_ctrl.plant.axis import Axis
from tsa_ctrl.plant.drive import Drive
from tsa_ctrl.plant.node import Node, Send
from tsa_ctrl.plant.sensors import Encoder, TorqueSensor

_HEARTBEAT = 0x700
_HISTORY = 4096  # frames that a replay can reach back


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
    lost_in_a_row: int = 0  # of each TPDO, before one is sent again
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


class Rig(Protocol):
    """Give a fault access to parts of the machine other than its axis."""

    flood_rate: float

    def inject(self, can_id: int, data: bytes, place: int = 0) -> bool:
        """Send any frame on the bus at `place`."""

    def set_interface(self, up: bool, place: int = 0) -> None:
        """Take the interface of a bus down or up; raises UsageError if the user lacks the permission."""

    def replay_commands(self, since: float, now: float) -> None:
        """Receive the master's frames since the time `since` (s) again."""

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


@dataclass(frozen=True)
class FaultKind:
    """Hold one fault: its description, its effect, and the default, unit and range of its value."""

    doc: str
    start: Callable[[Target], Undo]
    value: float = 0.0
    unit: str = ""
    low: float = 0.0
    high: float = 0.0


def nothing(now: float) -> None:
    """Do nothing, as the undo function of a fault that is a single event."""


def swap(target: object, name: str, value: Any) -> Undo:
    """Set an attribute and return the function that restores it."""
    before = getattr(target, name)
    setattr(target, name, value)
    return lambda now: setattr(target, name, before)


def parameter(target: Target, name: str, value: float) -> Undo:
    """Change a parameter of the mechanics and return the function that restores it."""
    record = target.axis.parameters
    before = record[name][0].item()
    record[name] = value

    def undo(now: float) -> None:
        record[name] = before

    return undo
