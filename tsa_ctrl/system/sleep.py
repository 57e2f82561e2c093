"""Sleep until an absolute time of the monotonic clock, or wait for a timer that was set earlier.

The module uses clock_nanosleep(2) with TIMER_ABSTIME and timerfd_create(2) of Linux. It imports the standard library
only, because the first process of the guest of tools/vcan imports it.
"""

from __future__ import annotations

import ctypes
import os
import time

_libc = ctypes.CDLL(None, use_errno=True)
CLOCK_MONOTONIC = 1  # linux/time.h
TIMER_ABSTIME = TFD_TIMER_ABSTIME = 1
_sleep, _create, _set = _libc.clock_nanosleep, _libc.timerfd_create, _libc.timerfd_settime


class _Timespec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class _Timerspec(ctypes.Structure):  # struct itimerspec
    _fields_ = (("interval", _Timespec), ("value", _Timespec))


_sleep.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.POINTER(_Timespec), ctypes.c_void_p)
_set.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.POINTER(_Timerspec), ctypes.c_void_p)


def sleep_until(deadline: int) -> None:
    """Sleep until `deadline` (ns of CLOCK_MONOTONIC). A signal handler interrupts the sleep, which then continues."""
    request = _Timespec(*divmod(deadline, 1_000_000_000))
    while _sleep(CLOCK_MONOTONIC, TIMER_ABSTIME, request, None) != 0:
        if time.monotonic_ns() >= deadline:
            return


class Alarm:
    """A descriptor `fd` that becomes readable at a preset time, so that waiting for it sets no timer.

    Raises:
        OSError: The kernel provides no such timer.
    """

    def __init__(self) -> None:
        self.fd: int = _create(CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
        if self.fd < 0:
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number))
        self._request = _Timerspec()

    def set(self, deadline: int) -> None:
        """Make the descriptor readable at `deadline` (ns of CLOCK_MONOTONIC, above 0), and not earlier."""
        value = self._request.value
        value.seconds, value.nanoseconds = divmod(deadline, 1_000_000_000)
        _set(self.fd, TFD_TIMER_ABSTIME, self._request, None)

    def close(self) -> None:
        """Close the descriptor. Call this only once."""
        os.close(self.fd)


class Lead:
    """The time before a deadline at which to request the wake-up, learned from recent wake-up latencies.

    Attributes:
        value: present lead, s.
    """

    GAIN = 0.1  # share of the difference by which one observation changes the lead
    STEP = 4e-6  # s, largest change, which limits the effect of a stall

    def __init__(self, most: float) -> None:
        """Start with a lead of 0; `most` is the largest lead, s."""
        self.value = 0.0
        self._most = most

    def learn(self, late: float) -> None:
        """Adapt the lead to one observation; `late` is the time from the requested to the actual wake-up, s."""
        step = max(-self.STEP, min(self.GAIN * (late - self.value), self.STEP))
        self.value = max(0.0, min(self.value + step, self._most))
