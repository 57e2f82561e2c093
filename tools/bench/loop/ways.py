"""Define the variants of a control cycle that bench/cycle compares, as context managers that yield a `Way`."""

from __future__ import annotations

import contextlib
import ctypes
import resource
import shutil
import socket
import statistics
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tsa_ctrl.bench.responder import standing_in
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.bus.wire.socketcan import SocketCan
from tsa_ctrl.config import Configuration
from tsa_ctrl.control.axis import ControlAxis
from tsa_ctrl.control.cycle import after_commands, run_cycle
from tsa_ctrl.daemon.build import control_axes, tuners_of
from tsa_ctrl.daemon.notices import Events
from tsa_ctrl.daemon.run import Children, server_process
from tsa_ctrl.daemon.telemetry import Telemetry
from tsa_ctrl.system import realtime
from tsa_ctrl.system.sleep import sleep_until

FRAME = struct.Struct("=IB3x8s")
FILTER = struct.Struct("=II")
EXACTLY = 0xC00007FF
FLOOR = Path(__file__).with_name("floor.c")
PATIENCE = 0.05  # s for an answer


@dataclass(frozen=True)
class Way:
    """The functions of one variant.

    `cycle` runs one cycle at the present time (s), and returns True if it received all answers. `wait` sleeps until an
    absolute time (ns). `rest` does the work after the cycle, which is not part of the cycle's wall time.
    """

    cycle: Callable[[float], bool]
    wait: Callable[[int], object] = sleep_until
    rest: Callable[[float], None] = lambda now: None


@contextlib.contextmanager
def _raw(configuration: Configuration) -> Iterator[tuple[socket.socket, bytes, list[bytes], int]]:
    """Yield a raw socket, the frames of SYNC and of each command, and the number of answers to a SYNC."""
    axes = range(len(configuration.models))
    ids = [base + n for n in axes for base in (0x181, 0x281, 0x1A0, 0x1C0)]
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
        bus.setsockopt(
            socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"".join(FILTER.pack(can_id, EXACTLY) for can_id in ids)
        )
        bus.bind((configuration.file.bus.channel,))
        bus.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", 0, round(1e6 * PATIENCE)))
        yield (
            bus,
            FRAME.pack(0x080, 0, b""),
            [FRAME.pack(0x201 + n, 4, struct.pack("<Hh", 15, 0)) for n in axes],
            len(ids),
        )


@contextlib.contextmanager
def raw_socket(configuration: Configuration) -> Iterator[Way]:
    """Yield a cycle in Python that only sends SYNC, receives the TPDOs and sends the RPDOs."""
    with _raw(configuration) as (bus, sync, commands, answers):
        send, recv_into, buffer, expected = bus.send, bus.recv_into, bytearray(16), range(answers)

        def cycle(now: float) -> bool:
            send(sync)
            try:
                for _ in expected:
                    recv_into(buffer)
            except BlockingIOError:
                return False
            for command in commands:
                send(command)
            return True

        yield Way(cycle)


@contextlib.contextmanager
def raw_socket_in_c(configuration: Configuration, library: ctypes.CDLL) -> Iterator[Way]:
    """Yield the same cycle in C from the compiled floor.c. The call from Python takes about 1 us."""
    with _raw(configuration) as (bus, sync, commands, answers):
        handle, frames, axes, run = bus.fileno(), b"".join(commands), len(commands), library.cycle
        yield Way(lambda now: bool(run(handle, sync, frames, axes, answers) == 1))


def floor_library(folder: str) -> ctypes.CDLL | None:
    """Return floor.c compiled in `folder`, or None without a C compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        return None
    library = f"{folder}/floor.so"
    subprocess.run([compiler, "-O2", "-shared", "-fPIC", "-o", library, str(FLOOR)], check=True)
    return ctypes.CDLL(library)


@contextlib.contextmanager
def ours(configuration: Configuration) -> Iterator[Way]:
    """Yield the control cycle of `tsa run`, with enabled axes."""
    file = configuration.file
    bus = SocketCan(file.bus.channel, file.bus.send_queue)
    rig = Rig(bus, file.bus, file.axes, configuration.profiles, wake_early=file.realtime.wake_early)
    axes = control_axes(configuration, rig)
    rig.start()
    collect = file.controller.collect * configuration.period
    start: list[float] = []

    def cycle(now: float) -> bool:
        if not start:
            start.append(now)
        elif len(start) == 1 and now - start[0] > 10 * configuration.period:
            start.append(now)
            for axis in axes:
                axis.enable()
        run_cycle(rig, axes, now, now + collect)
        return all(axis.image.fresh for axis in axes)

    try:
        yield Way(cycle, lambda deadline: rig.wait(deadline * 1e-9), lambda now: after_commands(rig, axes, now))
        _tell_faults(axes)
    finally:
        bus.close()


@contextlib.contextmanager
def ours_all(configuration: Configuration) -> Iterator[Way]:
    """Yield the cycle with log record, log writer and socket server, and with at most one command per cycle."""
    collect = configuration.file.controller.collect * configuration.period
    with _with_children(configuration) as (rig, axes, tuners, mailbox, telemetry):
        count = 0

        def cycle(now: float) -> bool:
            nonlocal count
            count += 1
            if count == 10:
                for axis in axes:
                    axis.enable()
            run_cycle(rig, axes, now, now + collect)
            after_commands(rig, axes, now)
            telemetry.record(count * configuration.period, count, 0.0, 0.0)
            command = mailbox.take()
            if command is not None:
                tuners[command.axis].set(command.parameter, command.value)
            for tuner in tuners:
                tuner.update()
            return all(axis.image.fresh for axis in axes)

        yield Way(cycle, lambda deadline: rig.wait(deadline * 1e-9))


@contextlib.contextmanager
def _with_children(configuration: Configuration) -> Iterator[tuple[Any, ...]]:
    file = configuration.file
    bus = SocketCan(file.bus.channel, file.bus.send_queue)
    rig = Rig(bus, file.bus, file.axes, configuration.profiles, wake_early=file.realtime.wake_early)
    axes = control_axes(configuration, rig)
    tuners = tuners_of(axes, configuration.period)
    with contextlib.ExitStack() as stack:
        stack.callback(bus.close)
        children = Children(configuration, tuners, server_process(configuration))
        stack.callback(children.end)
        telemetry = Telemetry(rig, axes, tuners, children.mailbox, children.ring, children.log, Events())
        rig.start()
        yield rig, axes, tuners, children.mailbox, telemetry
        _tell_faults(axes)


def _tell_faults(axes: Sequence[ControlAxis]) -> None:
    """Print faults, because the cycles after a fault ran without torque."""
    for axis in axes:
        for fault in axis.supervisor.faults:
            print(f"\nfault while measuring: {axis.name}: {fault}", file=sys.stderr)


WARM_UP = 0.2  # share of a block that is not counted
SETTLE = 0.02  # s after a block

Factory = Callable[[], contextlib.AbstractContextManager[Way]]


class Samples:
    """The durations of one variant, us."""

    def __init__(self) -> None:
        self.cycle: list[float] = []
        self.lateness: list[float] = []
        self.lost = 0
        self.worst: list[float] = []  # p99 of the wake-up latency in each block
        self.user = self.kernel = 0.0  # us of processor time, of all cycles with `wait` and `rest`
        self.counted = 0  # cycles in `user` and `kernel`

    def figures(self) -> dict[str, float | int]:
        found: dict[str, float | int] = {"cycles": len(self.lateness), "lost": self.lost}
        for name, values in (("cycle", self.cycle), ("lateness", self.lateness)):
            if values:
                parts = statistics.quantiles(values, n=100)
                found |= {f"{name}_p50": parts[49], f"{name}_p99": parts[98]}
        if self.counted:
            found |= {"user": self.user / self.counted, "kernel": self.kernel / self.counted}
        if self.worst:
            found["lateness_p99_median"] = statistics.median(self.worst)
        return found


def block(samples: Samples, cycles: int, period: int, way: Way) -> None:
    """Run a block of cycles at absolute deadlines."""
    deadline = time.monotonic_ns() + 2 * period
    clock, wait, cycle = time.monotonic_ns, way.wait, way.cycle
    first = len(samples.lateness)
    begun = resource.getrusage(resource.RUSAGE_THREAD)
    total = round(cycles * (1.0 + WARM_UP))
    for number in range(total):
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
    ended = resource.getrusage(resource.RUSAGE_THREAD)
    samples.user += 1e6 * (ended.ru_utime - begun.ru_utime)
    samples.kernel += 1e6 * (ended.ru_stime - begun.ru_stime)
    samples.counted += total
    samples.worst.append(statistics.quantiles(samples.lateness[first:], n=100)[98])


def nodes(configuration: Configuration) -> contextlib.AbstractContextManager[None]:
    """Run the nodes of a configuration as a process that answers each SYNC, as in `tsa bench`."""
    return standing_in(configuration.file.bus, configuration.file.axes, configuration.profiles)


def measure(table: Mapping[str, Factory], rate: float, rounds: int, cycles: int) -> dict[str, dict[str, float]]:
    """Measure all variants alternately at `rate` (Hz), and return their figures (us)."""
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
