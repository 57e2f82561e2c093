"""What the listener saw of each drive's torque, and what follows from it. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import msgspec

Source = Literal["tpdo", "sdo"]


class Sample(msgspec.Struct, frozen=True, array_like=True):
    """`clock`: CLOCK_MONOTONIC in s on arrival; `torque`: N*m at the motor pulley, as the drive reports it."""

    clock: float
    node: int
    torque: float
    source: Source


class Timing(msgspec.Struct, frozen=True, kw_only=True):
    """One drive in one trial; times in s since the loop was stopped, None for what was not seen."""

    torque_before: float | None  # N*m, the last before
    last_torque: float | None  # the last time that torque was seen
    zero_after: float | None  # the first time that none was seen, and none came back
    source: Source | None  # how that was seen


def timing(samples: Sequence[Sample], node: int, stopped: float, zero: float) -> Timing:
    """`stopped`: when the loop was stopped, clock as in the samples; `zero`: N*m up to which torque counts as none.

    `zero_after` is an upper bound: the torque fell between `last_torque` and it.
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
