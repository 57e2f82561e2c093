"""Real time on Linux: absolute deadlines, whole periods skipped and counted, and rights that are read back.

A right that is asked for and not in force is an error unless the settings allow running without. Garbage collection is
frozen: existing objects are never scanned again, and the loop makes no reference cycles.
"""

from __future__ import annotations

import ctypes
import gc
import os
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from tsa_ctrl.errors import BusError

MCL_CURRENT, MCL_FUTURE = 1, 2  # asm-generic/mman.h
RATES = (2000, 1000, 500, 250, 200, 125, 100, 50, 40, 25, 20, 10)  # Hz, with periods that every drive takes (0x60C2)
SKIPPED_SHARE = 0.01  # 1, of the periods of a second; from this share on skipped periods are reported
_SECOND = 1.0  # s
_HOLD_UPS = 2  # overruns within a second that show nothing of how long a cycle takes
_KEPT = 2.5  # s for which an overrun is kept: a second before the last report, and the second since
_libc = ctypes.CDLL(None, use_errno=True)


class RealtimeSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[realtime]."""

    priority: Annotated[int, Meta(ge=1, le=99)] = 80  # SCHED_FIFO
    lock_memory: bool = True
    cpu: Annotated[int, Meta(ge=0, le=1023)] | None = None  # run on this processor only; default: any
    wake_early: Annotated[float, Meta(ge=0.0, le=1e-3)] = 2e-4  # s at most before a deadline; how much is learned
    allow_without: bool = False  # run even if the scheduler or the memory lock is refused


@dataclass(frozen=True)
class Rights:
    """The real-time state of this process, read back from the kernel."""

    fifo: bool
    priority: int
    locked_bytes: int
    missing: tuple[str, ...]  # one line each: request, result, remedy

    def __str__(self) -> str:
        policy = f"SCHED_FIFO {self.priority}" if self.fifo else "no real-time scheduling"
        return f"{policy}, {self.locked_bytes / 2**20:.0f} MiB locked"


def acquire(settings: RealtimeSettings) -> Rights:
    """Take real-time scheduling and lock the memory; raise BusError when refused and not allowed to run without.

    Threads and processes started afterwards run without (SCHED_RESET_ON_FORK): none of them may hold up the loop.
    """
    missing: list[str] = []
    if settings.cpu is not None:
        try:
            os.sched_setaffinity(0, {settings.cpu})
        except OSError as error:
            missing.append(f"processor {settings.cpu} refused ({error.strerror}); give one that exists")
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(settings.priority))
    except OSError as error:
        missing.append(
            f"SCHED_FIFO {settings.priority} refused ({error.strerror}); "
            "give the user an rtprio limit (limits.conf or LimitRTPRIO=)"
        )
    if settings.lock_memory and _libc.mlockall(MCL_CURRENT | MCL_FUTURE) != 0:
        reason = os.strerror(ctypes.get_errno())
        missing.append(f"memory lock refused ({reason}); give the user memlock unlimited (LimitMEMLOCK=)")
    rights = in_force(tuple(missing))
    if missing and not settings.allow_without:
        raise BusError(f"real-time rights are missing: {'; '.join(missing)}; or set allow_without under [realtime]")
    return rights


def freeze_garbage() -> None:
    """Existing objects are never scanned again, and no collection starts; called right before the loop."""
    gc.collect()
    gc.freeze()
    gc.disable()


def in_force(missing: tuple[str, ...] = ()) -> Rights:
    """Return the scheduling policy and locked memory of this process as the kernel reports them."""
    policy = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
    locked = 0
    for line in Path("/proc/self/status").read_text(encoding="ascii", errors="replace").splitlines():
        if line.startswith("VmLck:"):
            locked = int(line.split()[1]) * 1024
    return Rights(policy == os.SCHED_FIFO, os.sched_getparam(0).sched_priority, locked, missing)


def release() -> None:
    """Give back what `acquire` and `freeze_garbage` took, so that the slow end of a run does not hold the machine."""
    gc.enable()
    gc.unfreeze()
    _libc.munlockall()
    if os.sched_getscheduler(0) != os.SCHED_OTHER:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


class Overruns:
    """Keep the cycles of the last seconds that took longer than their period."""

    def __init__(self) -> None:
        self._recent: deque[tuple[float, int, float]] = deque()

    def add(self, now: float, periods: int, took: float) -> None:
        """Keep one overrun.

        Args:
            now: when the cycle ended, s.
            periods: how many periods it skipped.
            took: time from its deadline to its end, s.
        """
        recent = self._recent
        recent.append((now, periods, took))
        while now - recent[0][0] > _KEPT:
            recent.popleft()

    def skipped(self, begin: float) -> int:
        """Return how many periods were skipped since `begin`, s."""
        return sum(periods for now, periods, _ in self._recent if now >= begin)

    def worst_second(self, since: float) -> tuple[int, float]:
        """Return the most periods that were skipped within a second that ended after `since` (s), and its begin, s."""
        worst, begin, within = 0, since, 0
        first, recent = 0, tuple(self._recent)
        for now, periods, _ in recent:
            within += periods
            while now - recent[first][0] > _SECOND:
                within -= recent[first][1]
                first += 1
            if now >= since and within > worst:
                worst, begin = within, now - _SECOND
        return worst, begin

    def clear(self) -> None:
        """Forget all overruns, after a new bring-up."""
        self._recent.clear()

    def remedy(self, begin: float, planned: int) -> str:
        """Return what ends the overruns: a rate that this machine reaches, or what to look for.

        Args:
            begin: start of the time that is judged, s.
            planned: periods in that time. A rate is reached if less than `SKIPPED_SHARE` of the cycles take longer.
        """
        took = sorted((took for now, _, took in self._recent if now >= begin), reverse=True)
        if not took:
            return "a cycle took longer than its period; set a lower rate in [controller]"
        rare = max(_HOLD_UPS, int(SKIPPED_SHARE * (planned - self.skipped(begin))))
        if rare >= len(took):
            return (
                f"the computer held the loop up for {1e3 * took[0]:.3g} ms at most; look for missing real-time rights "
                "and for other programs with tsa doctor"
            )
        reached = [rate for rate in RATES if rate * took[rare] <= 1.0]
        cycle = f"a cycle takes {1e3 * took[rare]:.3g} ms"
        if not reached:
            return f"{cycle}, so this machine reaches no rate of {RATES[-1]} Hz or more; use a faster machine"
        return f"{cycle}; set rate = {reached[0]} in [controller], which this machine reaches"


class Ticker:
    """Gives the absolute deadlines of a fixed rate; `skipped` counts whole periods that were lost."""

    def __init__(self, period: int, start: int) -> None:
        """`period` and `start` (the first deadline) in ns of CLOCK_MONOTONIC."""
        self.period = period
        self.deadline = start
        self.skipped = 0
        self.overruns = 0
        self.history = Overruns()

    def advance(self, now: int) -> int:
        """Move to the next deadline after one cycle that ended at `now`; returns how many periods were skipped."""
        self.deadline += self.period
        late = now - self.deadline
        if late <= 0:
            return 0
        skip = -(-late // self.period)  # a deadline that is due exactly now is not skipped, here and above
        self.history.add(1e-9 * now, skip, 1e-9 * (late + self.period))
        self.deadline += skip * self.period
        self.skipped += skip
        self.overruns += 1
        return skip
