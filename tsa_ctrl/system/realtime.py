"""Real time on Linux: absolute deadlines, whole periods skipped and counted, and rights that are read back.

A right that is asked for and not in force is an error unless the settings allow running without. Garbage collection is
frozen: what exists is never scanned again, and the loop makes no cycles of its own.
"""

from __future__ import annotations

import ctypes
import gc
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from tsa_ctrl.errors import BusError

MCL_CURRENT, MCL_FUTURE = 1, 2  # asm-generic/mman.h
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
    """What is in force for this process, read back from the kernel."""

    fifo: bool
    priority: int
    locked_bytes: int
    missing: tuple[str, ...]  # one line each: what was asked, what was found, what to do

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
    """What exists is never scanned again, and no collection starts; called right before the loop."""
    gc.collect()
    gc.freeze()
    gc.disable()


def in_force(missing: tuple[str, ...] = ()) -> Rights:
    """Scheduling policy and locked memory of this process as the kernel reports them."""
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


class Ticker:
    """Gives the absolute deadlines of a fixed rate; `skipped` counts whole periods that were lost."""

    def __init__(self, period: int, start: int) -> None:
        """`period` and `start` (the first deadline) in ns of CLOCK_MONOTONIC."""
        self.period = period
        self.deadline = start
        self.skipped = 0
        self.overruns = 0

    def advance(self, now: int) -> int:
        """Move to the next deadline after one cycle that ended at `now`; returns how many periods were skipped."""
        self.deadline += self.period
        late = now - self.deadline
        if late <= 0:
            return 0
        skip = late // self.period + 1
        self.deadline += skip * self.period
        self.skipped += skip
        self.overruns += 1
        return skip
