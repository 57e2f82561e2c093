"""Run in real time on Linux, with absolute deadlines, counted overruns, and rights that are read back.

A requested right that is not in force is an error, unless the settings permit running without it. Garbage collection is
frozen: existing objects are never scanned again, and the loop creates no reference cycles. An overrun skips whole
periods.
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
RATES = (2000, 1000, 500, 250, 200, 125, 100, 50, 40, 25, 20, 10)  # Hz, with periods that every drive accepts (0x60C2)
SKIPPED_SHARE = 0.01  # 1, share of the periods of a second above which skipped periods are reported
_SECOND = 1.0  # s
_HOLD_UPS = 2  # overruns within a second that are not attributed to the execution time of a cycle
_KEPT = 2.5  # s for which an overrun is kept: one second before the last report, and the second after it
_libc = ctypes.CDLL(None, use_errno=True)


class RealtimeSettings(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """[realtime]."""

    priority: Annotated[int, Meta(ge=1, le=99)] = 80  # SCHED_FIFO
    lock_memory: bool = True
    cpu: Annotated[int, Meta(ge=0, le=1023)] | None = None  # run on this processor only; default: any
    wake_early: Annotated[float, Meta(ge=0.0, le=1e-3)] = 2e-4  # s, longest lead before a deadline; the lead is learned
    allow_without: bool = False  # run even without real-time scheduling, memory lock or the processor


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
    """Request real-time scheduling and lock the memory.

    Threads and processes that are started later run without real-time scheduling (SCHED_RESET_ON_FORK), so that they
    cannot delay the loop.

    Raises:
        BusError: A right was refused, and `allow_without` is not set.
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
    """Exclude existing objects from garbage collection, and disable it. Call this right before the loop."""
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
    """Undo `acquire` and `freeze_garbage`, so that the slow end of a run does not block the machine."""
    gc.enable()
    gc.unfreeze()
    _libc.munlockall()
    if os.sched_getscheduler(0) != os.SCHED_OTHER:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


class Overruns:
    """The cycles of the last seconds that took longer than their period."""

    def __init__(self) -> None:
        self._recent: deque[tuple[float, int, float]] = deque()

    def add(self, now: float, periods: int, took: float) -> None:
        """Add one overrun.

        Args:
            now: end of the cycle, s.
            periods: number of skipped periods.
            took: time from the deadline to the end of the cycle, s.
        """
        recent = self._recent
        recent.append((now, periods, took))
        while now - recent[0][0] > _KEPT:
            recent.popleft()

    def skipped(self, begin: float) -> int:
        """Return the number of periods that were skipped since `begin` (s)."""
        return sum(periods for now, periods, _ in self._recent if now >= begin)

    def worst_second(self, since: float) -> tuple[int, float]:
        """Return the largest number of periods skipped within one second, and the start of that second, s.

        Only seconds that ended after `since` (s) count.
        """
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
        """Discard all overruns after a new bring-up."""
        self._recent.clear()

    def remedy(self, begin: float, planned: int) -> str:
        """Return the remedy for the overruns: a rate that this machine reaches, or the likely cause.

        Args:
            begin: start of the evaluated time, s.
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
    """The absolute deadlines of a fixed rate.

    Attributes:
        period: period, ns.
        deadline: present deadline, ns of CLOCK_MONOTONIC.
        skipped: number of skipped periods.
        overruns: number of cycles that took longer than their period.
        history: overruns of the last seconds.
    """

    def __init__(self, period: int, start: int) -> None:
        """Prepare the deadlines; `period` and `start` (the first deadline) are in ns of CLOCK_MONOTONIC."""
        self.period = period
        self.deadline = start
        self.skipped = 0
        self.overruns = 0
        self.history = Overruns()

    def advance(self, now: int) -> int:
        """Move to the next deadline after a cycle that ended at `now` (ns). Return the number of skipped periods."""
        self.deadline += self.period
        late = now - self.deadline
        if late <= 0:
            return 0
        skip = -(-late // self.period)  # as above, a deadline that is due exactly now is not skipped
        self.history.add(1e-9 * now, skip, 1e-9 * (late + self.period))
        self.deadline += skip * self.period
        self.skipped += skip
        self.overruns += 1
        return skip
