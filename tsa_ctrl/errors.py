"""One error tree. A message is one line: the place, the value found, the allowed range, the remedy."""

from __future__ import annotations


class TsaError(Exception):
    """Base of all errors that a user can cause; `exit_code`: of the command line."""

    exit_code = 1


class UsageError(TsaError):
    """The command, a configuration or a data file is wrong (exit code 2)."""

    exit_code = 2


class TooStillError(UsageError):
    """A log in which the joint moves too little for the requested result; another motion would."""


class StoppedError(TsaError):
    """Somebody asked for the end while something was waited for; the message is who, or what."""


class BusError(TsaError):
    """The machine or the bus failed (exit code 1)."""

    exit_code = 1


class LeaseLostError(BusError):
    """The set-point is no longer this client's; the message has the reason."""
