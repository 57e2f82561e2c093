"""Measure the highest rate of this machine and bus.

The bench runs cycles at the configured rate, computes the highest rate from them, and runs cycles at that rate. A cycle
of the real control loop is timed from the wake-up to the last command, and as a whole.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import msgspec
import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.bench.responder import standing_in
from tsa_ctrl.bus.drive.bring_up import bring_up
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.bus.wire.bus import Bus
from tsa_ctrl.bus.wire.link import is_simulated, open_bus
from tsa_ctrl.config import HIGHEST_RATE, LOWEST_RATE, Configuration
from tsa_ctrl.control.axis import ControlAxis
from tsa_ctrl.control.cycle import after_commands, run_cycle
from tsa_ctrl.daemon.build import control_axes, tuners_of
from tsa_ctrl.daemon.notices import Events
from tsa_ctrl.daemon.telemetry import Telemetry
from tsa_ctrl.doctor.can_interface import Result, answering, judged, listen
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.ipc.mailbox import Mailbox
from tsa_ctrl.log.ring import RingWriter
from tsa_ctrl.safety.shut_down import shut_down
from tsa_ctrl.safety.supervisor import Request
from tsa_ctrl.system import realtime
from tsa_ctrl.system.realtime import freeze_garbage

WARM_UP = 0.2  # cycles run before counting, as a share of the counted ones
LEAST = 50  # minimum number of counted cycles
WHOLE = 0.999  # quantile of the durations that determines a rate


@dataclass(frozen=True)
class Times:
    """Quantiles of a duration, s."""

    p50: float
    p99: float
    p999: float
    worst: float

    @classmethod
    def of(cls, values: NDArray[np.float64]) -> Times:
        return cls(*(float(v) for v in np.quantile(values, [0.5, 0.99, WHOLE, 1.0])))


@dataclass(frozen=True)
class Measured:
    """Durations of cycles at `rate` (Hz). `busy` lasts from the deadline to the end of all work in a cycle."""

    rate: float
    cycles: int
    lost: int  # cycles in which an answer was missing
    late: int  # cycles that began more than half a period late
    enabled: int  # cycles with torque permitted
    lateness: Times
    command: Times  # from the wake-up to the last command
    busy: Times


def measure(
    configuration: Configuration,
    bus: Bus,
    rate: float,
    seconds: float,
    enable: bool,
    nodes: Callable[[], contextlib.AbstractContextManager[None]],
    progress: Callable[[float], None],
) -> Measured:
    """Run the cycle of the loop, including its log, without other processes.

    Torque is requested only if `enable` is True. The cycles run within `nodes()`, which provides operational nodes.
    `progress` repeatedly receives the completed share. The bus stays open.
    """
    file = configuration.file
    rig = Rig(bus, file.bus, file.axes, configuration.profiles, wake_early=file.realtime.wake_early)
    axes = control_axes(configuration, rig)
    tuners = tuners_of(axes, configuration.period)
    mailbox = Mailbox(len(axes), len(tuners[0].parameters))
    ring = RingWriter(len(axes))
    try:
        telemetry = Telemetry(rig, axes, tuners, mailbox, ring, None, Events())
        count = max(LEAST, round(seconds * rate))
        freeze_garbage()  # slow, and the drives miss our heartbeat between bring-up and the first cycle
        with nodes():
            rig.start()
            return _run(rig, axes, telemetry, rate, count, file.controller.collect / rate, enable, progress)
    finally:
        ring.close()
        mailbox.close()


def _run(
    rig: Rig,
    axes: tuple[ControlAxis, ...],
    telemetry: Telemetry,
    rate: float,
    count: int,
    collect: float,
    enable: bool,
    progress: Callable[[float], None],
) -> Measured:
    lost = late = enabled = 0
    times: list[tuple[float, float, float]] = []  # s: wake-up after the deadline, to the last command, and to the end
    clock, period = time.monotonic_ns, round(1e9 / rate)
    first = round(WARM_UP * count)
    deadline = clock() + 2 * period
    for number in range(first + count):
        rig.wait(deadline * 1e-9)
        woke = clock()
        now = woke * 1e-9
        run_cycle(rig, axes, now, now + collect)
        done = clock()
        after_commands(rig, axes, now)
        telemetry.record(number / rate, number, (woke - deadline) * 1e-9, (done - woke) * 1e-9)
        end = clock()
        if number >= first:
            complete = all(axis.image.fresh for axis in axes)
            lost += not complete
            late += woke - deadline > period // 2
            enabled += all(axis.terms.permitted for axis in axes)
            times.append(((woke - deadline) * 1e-9, (done - woke) * 1e-9, (end - deadline) * 1e-9))
        elif enable and number == first // 2:
            for axis in axes:
                axis.set_point.gain = 0.0  # everything is computed as usual, but simulated nodes deliver no torque
                axis.enable()
        if number % 256 == 0:
            progress(number / (first + count))
        deadline += period * max(1, -(-(clock() - deadline) // period))
    for axis in axes:
        axis.request = Request.DISABLE
    return Measured(rate, len(times), lost, late, enabled, *map(Times.of, np.array(times).T))


@dataclass(frozen=True)
class Bound:
    """One upper bound of the rate, and its measured reason."""

    name: str
    rate: float  # Hz
    found: str


def bounds(measured: Measured, margin: float, collect: float, bus_rate: float, max_load: float) -> tuple[Bound, ...]:
    """Return all bounds of the rate, the lowest first, from the measured times.

    Args:
        measured: durations of the cycles.
        margin: share of the period that stays free, 1.
        collect: share of the remaining period in which the answers must arrive, 1.
        bus_rate: highest rate of the bus, Hz.
        max_load: largest share of the bit rate, 1.
    """
    busy, command = measured.busy.p999, measured.command.p999
    found = (
        Bound("cycle", (1.0 - margin) / busy, f"{_us(busy)} from the deadline to the end of a cycle"),
        Bound("answers", (1.0 - margin) * collect / command, f"{_us(command)} from SYNC to the command"),
        Bound("bit rate", bus_rate, f"at most {100 * max_load:.0f} % of the bit rate, in the worst case"),
        Bound("configuration", HIGHEST_RATE, "largest value of [controller] rate"),
    )
    return tuple(sorted(found, key=lambda bound: bound.rate))


def rounded_down(rate: float) -> float:
    """Return the rate rounded down to two significant digits; 0 below the lowest rate that can be configured."""
    if not rate >= LOWEST_RATE:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(rate)) - 1)
    return math.floor(rate / unit + 1e-9) * unit


def holds(measured: Measured, margin: float) -> bool:
    """Return True if no answer was lost or late at this rate and half of the margin stayed free."""
    allowed = (1.0 - 0.5 * margin) / measured.rate
    return measured.lost == 0 and measured.late == 0 and measured.busy.p999 <= allowed


def _us(seconds: float) -> str:
    return f"{1e6 * seconds:.0f} us (99.9 %)"


LOWER = 0.8  # factor on the rate for the next attempt
TRIES = 8
TOLERATED = 100  # cycles that the supervision tolerates, because the bench counts losses itself

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Found:
    """Results of `tsa bench`. `confirmed` holds cycles at `highest` with simulated nodes, or None with real ones."""

    bus: str
    rights: str
    missing: tuple[str, ...]  # rights that are not in force
    simulated: bool
    margin: float
    configured: Measured
    bounds: tuple[Bound, ...]
    highest: float  # Hz; 0 if not even the lowest rate holds
    limited_by: str
    confirmed: Measured | None

    @property
    def fits(self) -> bool:
        """Return True if the configured rate is within the margin."""
        return self.configured.rate <= self.highest


def bench(
    configuration: Configuration,
    seconds: float,
    margin: float,
    progress: Progress,
    say: Callable[[str], None] = lambda line: None,
) -> Found:
    """Measure for `seconds` at each rate that is tried, and return the results.

    With real nodes on the bus nothing is enabled. They are brought up, answer every SYNC with the drives off, and are
    left as after a run. On a virtual bus without nodes, simulated nodes answer, and the loop runs as with torque.
    `say` is called with a line for each drive that does not confirm that it is off.

    Raises:
        BusError: the bus or its nodes are not suitable.
        UsageError: the configuration has several buses.
    """
    if configuration.file.other_buses:
        raise UsageError(f"{configuration.path}: tsa bench measures one bus; use a file with one [bus]")
    configuration = _tolerant(configuration)
    bus = open_bus(configuration.file.bus)
    try:
        simulated = _nobody(configuration, bus)
        rights = realtime.acquire(msgspec.structs.replace(configuration.file.realtime, allow_without=True))
        try:
            return _measure(configuration, bus, seconds, margin, simulated, rights, say, progress)
        finally:
            realtime.release()
    finally:
        bus.close()


def _tolerant(configuration: Configuration) -> Configuration:
    """Return the configuration with a supervision that counts losses instead of removing the torque."""
    file = configuration.file
    supervision = msgspec.structs.replace(
        file.bus.supervision, tolerated_misses=TOLERATED, tolerated_drops=TOLERATED, lost_share=1.0
    )
    return replace(
        configuration,
        file=msgspec.structs.replace(file, bus=msgspec.structs.replace(file.bus, supervision=supervision)),
    )


def _nobody(configuration: Configuration, bus: Bus) -> bool:
    """Return True if simulated nodes are needed.

    Raises:
        BusError: another master is active, only some drives answer, or a real bus has no nodes.
    """
    settings = configuration.file.bus
    seen = listen(bus)
    heard = judged(bus, seen, settings, configuration.file.axes, "", configuration.profiles)
    if heard.result is Result.FAIL:
        raise BusError(f"{bus.name}: {heard.found}; {heard.fix}")
    drives = [axis.drive.node_id for axis in configuration.file.axes]
    there = [node for node in drives if answering(bus, node) is not None]
    if there == drives:
        return False
    if there or seen or not is_simulated(settings.interface, settings.channel):
        silent = ", ".join(str(node) for node in drives if node not in there)
        others = sorted({can_id & 0x7F for can_id in seen if can_id & 0x7F})
        talk = f" (active nodes: {', '.join(map(str, others))})" if others else ""
        raise BusError(
            f"{bus.name}: no answer from drive node {silent}{talk}; switch it on and check node id and bit rate"
        )
    return True


@contextlib.contextmanager
def _nodes(configuration: Configuration, bus: Bus, simulated: bool, say: Callable[[str], None]) -> Iterator[None]:
    """Provide nodes that answer SYNC during the block."""
    file = configuration.file
    if simulated:
        with standing_in(file.bus, file.axes, configuration.profiles):
            yield
        return
    bring_up(bus, file.bus, file.axes, configuration.profiles, configuration.period)  # undoes its writes if it fails
    try:
        yield
    finally:
        rig = Rig(bus, file.bus, file.axes, configuration.profiles)
        rig.start()
        for line in shut_down(rig, configuration.period):
            say(line)


def _measure(
    configuration: Configuration,
    bus: Bus,
    seconds: float,
    margin: float,
    simulated: bool,
    rights: realtime.Rights,
    say: Callable[[str], None],
    progress: Progress,
) -> Found:
    file = configuration.file

    def at(rate: float) -> Measured:
        nodes = partial(_nodes, configuration, bus, simulated, say)
        return measure(
            configuration, bus, rate, seconds, simulated, nodes, lambda share: progress(f"{rate:g} Hz", share)
        )

    configured = at(file.controller.rate)
    if configured.lost == configured.cycles:
        raise BusError(f"{bus.name}: no SYNC was answered by all nodes; check their mapping (tsa run prints details)")
    bus_rate = configuration.load.highest_rate(file.bus.max_load)
    found = bounds(configured, margin, file.controller.collect, bus_rate, file.bus.max_load)
    highest, limited_by = rounded_down(found[0].rate), found[0].name
    confirmed = None
    for _ in range(TRIES if simulated else 0):
        if highest == 0.0:
            break
        confirmed = at(highest)
        if holds(confirmed, margin):
            break
        highest, limited_by = rounded_down(LOWER * highest), "losses and delays at a higher rate"
    else:
        if simulated:
            highest = 0.0
    return Found(
        bus.name, str(rights), rights.missing, simulated, margin, configured, found, highest, limited_by, confirmed
    )
