"""Define the error tree. A message is one line with the place, the value found, the allowed range and the remedy."""

from __future__ import annotations

import math


class TsaError(Exception):
    """The base of all errors that are reported to the user. `exit_code` is the exit code of the command line."""

    exit_code = 1


class UsageError(TsaError):
    """The command, a configuration or a data file is wrong (exit code 2)."""

    exit_code = 2


class ArgumentsError(UsageError, TypeError):
    """A function of the Python interface has no such argument, or lacks one."""


class TooStillError(UsageError):
    """The joint moves too little in the logs for the requested result, which another motion would permit."""


class StoppedError(TsaError):
    """A stop was requested during a wait. The message is its origin."""


class BusError(TsaError):
    """The machine or the bus failed (exit code 1)."""


class LeaseLostError(BusError):
    """This client no longer controls the set-point. The message has the reason."""


def rounded_down(value: float, digits: int) -> str:
    """Return an upper limit from 0 on with `digits` significant digits, rounded down so that the text is permitted."""
    if value <= 0.0:
        return "0"
    unit = 10.0 ** (math.floor(math.log10(value)) - digits + 1)
    return f"{math.floor(value / unit + 1e-9) * unit:.{digits}g}"
