"""What a fault of the simulated machine is: what it may get hold of, what its value means, how it is undone."""

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

# What a node says on its way to the bus: unchanged, unless a fault of the wire or of the node's firmware is on.

_HEARTBEAT = 0x700
_HISTORY = 4096  # frames that a replay can reach back


@dataclass
class Outlet:
    """`Send` of one node. TPDOs and the heartbeat can be tampered with; EMCY and SDO pass."""

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
        """Send delayed frames whose time has come."""
        while self.waiting and self.waiting[0][0] <= now:
            _, can_id, data = self.waiting.popleft()
            self.send(can_id, data)

    def replay(self, seconds: float) -> int:
        """Send again all TPDOs of the last seconds, as an adapter that plays out stale frames; how many."""
        since = self.clock() - seconds
        stale = [(can_id, data) for at, can_id, data in self.history if at >= since]
        for can_id, data in stale:
            self.send(can_id, data)
        return len(stale)


Undo = Callable[[float], None]


class Rig(Protocol):
    """What a fault may get hold of beside its axis."""

    flood_rate: float

    def inject(self, can_id: int, data: bytes) -> bool:
        """Put any frame on the bus."""

    def set_interface(self, up: bool) -> None:
        """Take the interface down, or up again; raises UsageError where this user may not."""

    def replay_commands(self, since: float, now: float) -> None:
        """Hear again what the master sent since then."""

    def later(self, at: float, action: Callable[[float], None]) -> None:
        """Call `action(now)` in the first tick at or after `at`."""


@dataclass(frozen=True)
class Target:
    """Where a fault acts, and how strongly."""

    rig: Rig
    axis: Axis
    drive: Drive
    encoder: Encoder | None
    torque_sensor: TorqueSensor | None
    nodes: tuple[Node, ...]
    node: Node
    outlet: Outlet
    value: float
    duration: float
    now: float


@dataclass(frozen=True)
class FaultKind:
    """One fault: what it does, what its value means, the value unless given."""

    doc: str
    start: Callable[[Target], Undo]
    value: float = 0.0
    unit: str = ""
    low: float = 0.0
    high: float = 0.0


def nothing(now: float) -> None:
    """Nothing to undo: it happened once."""


def swap(target: object, name: str, value: Any) -> Undo:
    """Set an attribute, and what sets it back."""
    before = getattr(target, name)
    setattr(target, name, value)
    return lambda now: setattr(target, name, before)


def parameter(target: Target, name: str, value: float) -> Undo:
    """Change a parameter of the mechanics from now on."""
    record = target.axis.parameters
    before = record[name][0].item()
    record[name] = value

    def undo(now: float) -> None:
        record[name] = before

    return undo
