"""Sleep to an absolute time of the monotonic clock (Linux: clock_nanosleep(2), TIMER_ABSTIME)."""

from __future__ import annotations

import ctypes
import time

CLOCK_MONOTONIC = 1  # linux/time.h
TIMER_ABSTIME = 1
_sleep = ctypes.CDLL(None).clock_nanosleep


class _Timespec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


_sleep.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.POINTER(_Timespec), ctypes.c_void_p)


def sleep_until(deadline: int) -> None:
    """Sleep until `deadline` (ns of CLOCK_MONOTONIC); a signal's Python handler runs, then the sleep goes on."""
    request = _Timespec(*divmod(deadline, 1_000_000_000))
    while _sleep(CLOCK_MONOTONIC, TIMER_ABSTIME, request, None) != 0:
        if time.monotonic_ns() >= deadline:
            return
