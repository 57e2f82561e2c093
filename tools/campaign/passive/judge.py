"""Measures of a run, by the plant's truth: work beyond the set-point's, speed of the joint, and when the loop reacted.

The work that counts is the integral of (tau_J - tau_J_des) omega_J over the window that makes it largest. It is zero or
less for a joint that nothing but its set-point, its load and passive tendons move. Once a fault has ended the torque,
no torque is desired. Where tendons release a joint, the same run at compensation 0 has such work as well; the
caller subtracts it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.ipc.protocol import Event
from tsa_ctrl.virtual.result import Simulation

GUARD = ("passivity", "oscillation")  # first words of the guard's events
LATCHED = "latched at"  # in an event of the guard that latches

FloatArray = NDArray[np.float64]


def power(result: Simulation, begin: float) -> tuple[FloatArray, FloatArray]:
    """Return times from `begin` on, s of the log, and the work beyond the set-point's of each row of the truth, J."""
    axis, truth = result.axes[0], result.truth
    t = truth["clock"] - axis.start
    on = t >= begin
    if not axis.faults:  # an orderly stop goes on to ask for torque, which it ramps down
        on &= t < axis.until
    desired = np.where(t < axis.until, np.interp(t, axis.log["t"], axis.log["tau_j_des"]), 0.0)
    step = np.diff(t, prepend=t[0])
    return t[on], ((truth["tau_j"] - desired) * truth["omega_j"] * step)[on]


def windows(work: FloatArray) -> FloatArray:
    """Return the most work of any window that ends in each row, J."""
    total = np.cumsum(work)
    least = np.minimum.accumulate(np.concatenate(([0.0], total[:-1])))
    return total - least if work.size else work


def most_work(result: Simulation, begin: float) -> float:
    """Return the most work, J, beyond the set-point's that any window after `begin` s of the log gave the joint."""
    return float(windows(power(result, begin)[1]).max(initial=0.0))


def speed(result: Simulation, begin: float, end: float) -> float:
    """Return the joint's RMS speed between two times of the log, rad/s; 0 after a run that ended at rest before."""
    t = result.truth["clock"] - result.axes[0].start
    on = (t >= begin) & (t < end) & (t < result.axes[0].until)
    return float(np.sqrt(np.mean(np.square(result.truth["omega_j"][on])))) if on.any() else 0.0


def peak_speed(result: Simulation, begin: float) -> float:
    """Return the joint's highest speed after `begin` s of the log, rad/s."""
    t = result.truth["clock"] - result.axes[0].start
    return float(np.abs(result.truth["omega_j"][t >= begin]).max(initial=0.0))


def latches(event: Event) -> bool:
    """Return True for an event that takes torque or compensation away for good."""
    return event.fault or LATCHED in event.text


def reactions(events: Sequence[Event], begin: float) -> dict[str, float | None]:
    """Return s from `begin` s of the log to the first report and to the first event that latches; None without one."""
    later = [event for event in events if event.t > begin and event.text]
    first = {"reported": later[:1], "latched": [event for event in later if latches(event)][:1]}
    return {name: found[0].t - begin if found else None for name, found in first.items()}
