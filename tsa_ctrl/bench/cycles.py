"""Cycles of the real control loop at a rate, timed: waking up, the work up to the last command, and all of it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.bus.wire.bus import Bus
from tsa_ctrl.config import Configuration
from tsa_ctrl.control.axis import ControlAxis
from tsa_ctrl.control.cycle import follow_up, run_cycle
from tsa_ctrl.daemon.build import control_axes, tuners_of
from tsa_ctrl.daemon.events import Events
from tsa_ctrl.daemon.telemetry import Telemetry
from tsa_ctrl.ipc.mailbox import Mailbox
from tsa_ctrl.log.ring import RingWriter
from tsa_ctrl.safety.supervisor import Request
from tsa_ctrl.system.realtime import freeze_garbage

WARM_UP = 0.2  # share of the cycles that is not counted
LEAST = 50  # cycles
WHOLE = 0.999  # of the cycles are inside the figure that a rate is made of


@dataclass(frozen=True)
class Times:
    """Durations of one kind, in s."""

    p50: float
    p99: float
    p999: float
    worst: float

    @classmethod
    def of(cls, values: NDArray[np.float64]) -> Times:
        if not values.size:
            return cls(math.nan, math.nan, math.nan, math.nan)
        return cls(*(float(v) for v in np.quantile(values, [0.5, 0.99, WHOLE, 1.0])))


@dataclass(frozen=True)
class Measured:
    """The durations of some cycles at `rate` (Hz); `busy`: from the deadline to the end of all that a cycle does."""

    rate: float
    cycles: int
    lost: int  # cycles in which an answer was missing
    late: int  # begun after half a period
    enabled: int  # with torque permitted
    lateness: Times
    command: Times  # from waking up to the last command out
    busy: Times


@dataclass
class _Samples:
    lateness: list[float] = field(default_factory=list)
    command: list[float] = field(default_factory=list)
    busy: list[float] = field(default_factory=list)
    lost: int = 0
    late: int = 0
    enabled: int = 0


def measure(
    configuration: Configuration, bus: Bus, rate: float, seconds: float, enable: bool, progress: Callable[[float], None]
) -> Measured:
    """Run the loop's own cycle with its record, but no other process; torque is asked for only when `enable`.

    `progress` is called now and then with the share that is done. The bus stays open.
    """
    file = configuration.file
    rig = Rig(bus, file.bus, file.axes, configuration.profiles, wake_early=file.realtime.wake_early)
    axes = control_axes(configuration, rig)
    tuners = tuners_of(axes, configuration.period)
    mailbox = Mailbox(len(axes), len(tuners[0].parameters))
    ring = RingWriter(len(axes))
    try:
        telemetry = Telemetry(rig, axes, tuners, mailbox, ring, None, Events())
        rig.start()
        count = max(LEAST, round(seconds * rate))
        samples = _run(rig, axes, telemetry, rate, count, file.controller.collect / rate, enable, progress)
    finally:
        ring.close()
        mailbox.close()
    return Measured(
        rate,
        len(samples.busy),
        samples.lost,
        samples.late,
        samples.enabled,
        *(Times.of(np.array(values)) for values in (samples.lateness, samples.command, samples.busy)),
    )


def _run(
    rig: Rig,
    axes: tuple[ControlAxis, ...],
    telemetry: Telemetry,
    rate: float,
    count: int,
    collect: float,
    enable: bool,
    progress: Callable[[float], None],
) -> _Samples:
    samples = _Samples()
    clock, period = time.monotonic_ns, round(1e9 / rate)
    first = round(WARM_UP * count)
    freeze_garbage()
    deadline = clock() + 2 * period
    for number in range(first + count):
        rig.wait(deadline * 1e-9)
        woke = clock()
        now = woke * 1e-9
        run_cycle(rig, axes, now, now + collect)
        done = clock()
        follow_up(rig, axes, now)
        telemetry.record(number / rate, number, (woke - deadline) * 1e-9, (done - woke) * 1e-9)
        end = clock()
        if number >= first:
            complete = all(axis.image.fresh for axis in axes)
            samples.lost += not complete
            samples.late += woke - deadline > period // 2
            samples.enabled += all(axis.terms.permitted for axis in axes)
            samples.lateness.append((woke - deadline) * 1e-9)
            samples.command.append((done - woke) * 1e-9)
            samples.busy.append((end - deadline) * 1e-9)
        elif enable and number == first // 2:
            for axis in axes:
                axis.set_point.gain = 0.0  # everything is computed as usual, but substitute nodes deliver no torque
                axis.enable()
        if number % 256 == 0:
            progress(number / (first + count))
        deadline += period * max(1, -(-(clock() - deadline) // period))
    for axis in axes:
        axis.request = Request.DISABLE
    return samples
