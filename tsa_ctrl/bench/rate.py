"""From measured times to the highest rate with margin, and what sets it. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tsa_ctrl.bench.cycles import Measured

HIGHEST = 4000.0  # Hz, of [controller] rate
LOWEST = 10.0  # Hz


@dataclass(frozen=True)
class Bound:
    """One thing that bounds the rate, and how."""

    name: str
    rate: float  # Hz
    found: str


def bounds(measured: Measured, margin: float, collect: float, bus_rate: float, max_load: float) -> tuple[Bound, ...]:
    """All bounds, the lowest first. `margin`: share of the period that stays free; `collect`: of it for answers."""
    busy, command = measured.busy.p999, measured.command.p999
    found = (
        Bound("cycle", _inverse((1.0 - margin), busy), f"{_us(busy)} from the deadline to the end of a cycle"),
        Bound("answers", _inverse((1.0 - margin) * collect, command), f"{_us(command)} from SYNC to the command"),
        Bound("bit rate", bus_rate, f"{100 * max_load:.0f} % of the bit rate in the worst case"),
        Bound("configuration", HIGHEST, "[controller] rate is at most this"),
    )
    return tuple(sorted(found, key=lambda bound: bound.rate))


def rounded_down(rate: float) -> float:
    """Two significant digits, downwards; 0 below the lowest rate that can be configured."""
    if not rate >= LOWEST:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(rate)) - 1)
    return math.floor(rate / unit + 1e-9) * unit


def holds(measured: Measured, margin: float) -> bool:
    """Whether cycles at a rate kept to it: no answer lost, none late, and half of the margin still free."""
    allowed = (1.0 - 0.5 * margin) / measured.rate
    return measured.lost == 0 and measured.late == 0 and measured.busy.p999 <= allowed


def _inverse(share: float, seconds: float) -> float:
    return share / seconds if seconds > 0.0 else 0.0  # nan: nothing was measured


def _us(seconds: float) -> str:
    return f"{1e6 * seconds:.0f} us (99.9 %)"
