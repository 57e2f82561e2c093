"""Compute excess work, joint speed and reaction times of a run from the plant's truth.

The excess work is the integral of (tau_J - tau_J_des) omega_J over the window in which it is largest. It is not
positive if only the set-point, the load and passive tendons move the joint. After a fault the desired torque is zero.
If tendons release a joint, the same run at compensation 0 also has excess work, which the caller subtracts.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.ipc.protocol import Event
from tsa_ctrl.virtual.result import Simulation

GUARD = ("passivity", "oscillation")  # first words of the guard's events
LATCHES = "latched at"  # words of an event in which the guard latches

STILL, REST = 0.01, 1.0  # rad/s below which the joint is at rest, and s of rest that end a run
LET_GO = 0.2  # s from a change until the hand releases the joint
LATCHED = 1.2  # s of observation after a latch
FloatArray = NDArray[np.float64]


def power(result: Simulation, begin: float) -> tuple[FloatArray, FloatArray]:
    """Return the times of the truth (s of the log) from `begin` on, and the excess work of each row, J."""
    axis, truth = result.axes[0], result.truth
    t = truth["clock"] - axis.start
    on = t >= begin
    if not axis.faults:  # an orderly stop ramps the torque down, so its desired value is not zero
        on &= t < axis.until
    desired = np.where(t < axis.until, np.interp(t, axis.log["t"], axis.log["tau_j_des"]), 0.0)
    step = np.diff(t, prepend=t[0])
    return t[on], ((truth["tau_j"] - desired) * truth["omega_j"] * step)[on]


def windows(work: FloatArray) -> FloatArray:
    """Return, for each row, the largest work of any window that ends there, J."""
    total = np.cumsum(work)
    least = np.minimum.accumulate(np.concatenate(([0.0], total[:-1])))
    return total - least if work.size else work


def most_work(result: Simulation, begin: float) -> float:
    """Return the largest excess work of any window after `begin` s of the log, J."""
    return float(windows(power(result, begin)[1]).max(initial=0.0))


def speed(result: Simulation, begin: float, end: float) -> float:
    """Return the joint's RMS speed between two times of the log, rad/s, or 0 if the run ended before."""
    t = result.truth["clock"] - result.axes[0].start
    on = (t >= begin) & (t < end) & (t < result.axes[0].until)
    return float(np.sqrt(np.mean(np.square(result.truth["omega_j"][on])))) if on.any() else 0.0


def peak_speed(result: Simulation, begin: float) -> float:
    """Return the joint's highest speed after `begin` s of the log, rad/s."""
    t = result.truth["clock"] - result.axes[0].start
    return float(np.abs(result.truth["omega_j"][t >= begin]).max(initial=0.0))


def latches(event: Event) -> bool:
    """Return True for a fault and for an event in which the guard latches."""
    return event.fault or LATCHES in event.text


def reactions(events: Sequence[Event], begin: float) -> dict[str, float | None]:
    """Return the time from `begin` to the first report and to the first latch, s, or None without one."""
    later = [event for event in events if event.t > begin and event.text]
    first = {"reported": later[:1], "latched": [event for event in later if latches(event)][:1]}
    return {name: found[0].t - begin if found else None for name, found in first.items()}


class Ended:
    """A function that returns True to end a run, after a latch or, with `stands`, once the joint has rested."""

    def __init__(self, at: float, stands: bool) -> None:
        self._at, self._stands = at, stands
        self._moved = at + LET_GO

    def __call__(self, t: float, omega: float, events: Sequence[Event]) -> bool:
        if abs(omega) > STILL:
            self._moved = max(t, self._moved)
        if self._stands and t - self._moved > REST:
            return True
        return any(self._at < event.t < t - LATCHED and latches(event) for event in events)
