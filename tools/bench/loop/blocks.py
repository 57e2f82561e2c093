"""Ways of running a cycle measured in turns, so that what the machine does besides meets each of them."""

from __future__ import annotations

import contextlib
import statistics
import sys
import threading
import time
from collections.abc import Callable, Mapping

from tools.bench.loop import ways
from tsa_ctrl.bench.responder import standing_in
from tsa_ctrl.config import Configuration
from tsa_ctrl.system import realtime

WARM_UP = 0.2  # share of a block that is not counted
SETTLE = 0.02  # s after a block

Factory = Callable[[], contextlib.AbstractContextManager[ways.Way]]


class Samples:
    """Durations in us of one way."""

    def __init__(self) -> None:
        self.cycle: list[float] = []
        self.lateness: list[float] = []
        self.lost = 0
        self.worst: list[float] = []  # p99 of the lateness in each block

    def figures(self) -> dict[str, float | int]:
        found: dict[str, float | int] = {"cycles": len(self.lateness), "lost": self.lost}
        for name, values in (("cycle", self.cycle), ("lateness", self.lateness)):
            if values:
                parts = statistics.quantiles(values, n=100)
                found |= {f"{name}_p50": parts[49], f"{name}_p99": parts[98]}
        if self.worst:
            found["lateness_p99_median"] = statistics.median(self.worst)
        return found


def block(samples: Samples, cycles: int, period: int, way: ways.Way) -> None:
    """Run a block of cycles at absolute deadlines."""
    deadline = time.monotonic_ns() + 2 * period
    clock, wait, cycle = time.monotonic_ns, way.wait, way.cycle
    first = len(samples.lateness)
    for number in range(round(cycles * (1.0 + WARM_UP))):
        wait(deadline)
        woke = clock()
        complete = cycle(woke * 1e-9)
        done = clock()
        way.rest(woke * 1e-9)
        if number >= WARM_UP * cycles:
            samples.lateness.append((woke - deadline) * 1e-3)
            if not complete:
                samples.lost += 1
            else:
                samples.cycle.append((done - woke) * 1e-3)
        deadline += period * max(1, (clock() - deadline) // period + 1)
    samples.worst.append(statistics.quantiles(samples.lateness[first:], n=100)[98])


def nodes(configuration: Configuration) -> contextlib.AbstractContextManager[None]:
    """The nodes of a configuration as a process that answers each SYNC: those of `tsa bench`."""
    return standing_in(configuration.file.bus, configuration.file.axes)


def measure(table: Mapping[str, Factory], rate: float, rounds: int, cycles: int) -> dict[str, dict[str, float]]:
    """Figures (us) of every way; `rate` in Hz."""
    period = round(1e9 / rate)
    found = {name: Samples() for name in table}
    names = list(table)
    for number in range(rounds):
        first = number % len(names)
        for name in names[first:] + names[:first]:
            with table[name]() as way:
                realtime.freeze_garbage()
                block(found[name], cycles, period, way)
            time.sleep(SETTLE)
            if sys.stdout.isatty() and threading.active_count() == 1:
                print(f"\r{number + 1}/{rounds} {name:20}", end="", file=sys.stderr, flush=True)
    return {name: samples.figures() for name, samples in found.items()}
