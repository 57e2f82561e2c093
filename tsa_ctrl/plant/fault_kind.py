"""What a fault of the simulated machine is: what it may get hold of, what its value means, how it is undone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from tsa_ctrl.plant.axis import Axis
from tsa_ctrl.plant.drive import Drive
from tsa_ctrl.plant.node import Node
from tsa_ctrl.plant.outlet import Outlet
from tsa_ctrl.plant.sensors import Encoder, TorqueSensor

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
