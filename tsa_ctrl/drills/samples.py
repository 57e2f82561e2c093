"""What the listener saw of each drive's torque, and what follows from it. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import msgspec

Source = Literal["tpdo", "sdo"]


class Sample(msgspec.Struct, frozen=True, array_like=True):
    """`clock`: CLOCK_MONOTONIC in s on arrival; `torque`: N*m at the motor pulley, as the drive reports it."""

    clock: float
    node: int
    torque: float
    source: Source


class Said(msgspec.Struct, frozen=True, array_like=True):
    """An EMCY of a drive; `clock` as in a sample."""

    clock: float
    node: int
    code: int


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


class Watchdog(msgspec.Struct, frozen=True, kw_only=True):
    """Which of a drive's watchdogs took the torque, by the EMCY that it sent."""

    acted: str | None  # "rpdo" (0x8250), "heartbeat" (0x8130); None when the drive did not say
    after: float | None  # s since the loop was stopped
    warning: str  # about one that was armed and did not act in its time


_CODES = {0x8250: "rpdo", 0x8130: "heartbeat"}
_NAMES = {
    "rpdo": "the RPDO event timer (0x1400:5)",
    "heartbeat": "the heartbeat consumer (0x1016)",
    "guarding": "life guarding (0x100D)",
}
_LATE = 1.25  # times its time-out, and
_SLACK = 0.02  # s, after which a watchdog counts as one that did not act


def watchdog(said: Sequence[Said], node: int, stopped: float, armed: Mapping[str, int], loop_dead: bool) -> Watchdog:
    """What the drive said, against the time-outs (ms) that it held; with a live loop its RPDO timer has no cause."""
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
    """Life guarding and the heartbeat say the same."""
    return {acted, name} == {"heartbeat", "guarding"}
