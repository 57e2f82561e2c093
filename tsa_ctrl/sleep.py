"""Sleep to an absolute time of the monotonic clock (Linux: clock_nanosleep(2), TIMER_ABSTIME); what waking up costs."""

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


class Lead:
    """How much before a deadline to ask to be woken: what waking has cost lately, `most` (s) at most."""

    GAIN = 0.1  # of the difference by which one observation moves it
    STEP = 4e-6  # s at most: a stall counts no more than that

    def __init__(self, most: float) -> None:
        self.value = 0.0
        self._most = most

    def learn(self, late: float) -> None:
        """`late`: s from the time asked for to being awake."""
        step = max(-self.STEP, min(self.GAIN * (late - self.value), self.STEP))
        self.value = max(0.0, min(self.value + step, self._most))
