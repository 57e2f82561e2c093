"""How a run of the runaway campaign is judged: by the plant's truth, and by what the loop said.

Work is that beyond the set-point's, from the change on, in windows: the most of any counts.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tools.campaign.passive.cases import AT, LOADS, REST, TO_REST, Case, play, play_healthy
from tsa_ctrl.virtual.result import Simulation

SWUNG = 0.05  # s after the guard acted, in which a swing has died out
FELT = 1e-3  # J: three times what a healthy reversal leaves
ALLOWED = 3e-3  # J, [axis.passivity] energy as shipped
TOLD = ("passivity", "oscillation")  # how what the guard says begins
LOWERED = "friction and pretension together are about"  # how what is said of the estimate begins
QUIET_SPEED, QUIET_TORQUE = 0.02, 0.02  # rad/s RMS, N*m peak to peak


def power(result: Simulation, begin: float = AT) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return times from `begin` on, s of the log, and the work per row beyond the set-point's, J."""
    axis, truth = result.axes[0], result.truth
    t = truth["clock"] - axis.start
    on = (t >= begin) & (t < axis.until)
    wanted = np.interp(t, axis.log["t"], axis.log["tau_j_des"])
    step = np.diff(t, prepend=t[0])
    return t[on], ((truth["tau_j"] - wanted) * truth["omega_j"] * step)[on]


def most_work(result: Simulation, begin: float) -> float:
    """Return the most work, J, beyond the set-point's that any window after `begin` s of the log gave the joint."""
    return float(windows(power(result, begin)[1]).max(initial=0.0))


def speed(result: Simulation, begin: float, end: float) -> float:
    """Return the joint's RMS speed between two times of the log, rad/s; 0 after a run that ended at rest before."""
    t = result.truth["clock"] - result.axes[0].start
    on = (t >= begin) & (t < end) & (t < result.axes[0].until)
    return float(np.sqrt(np.mean(np.square(result.truth["omega_j"][on])))) if on.any() else 0.0


def windows(work: NDArray[np.float64]) -> NDArray[np.float64]:
    """Most work of any window that ends in each row, J."""
    total = np.cumsum(work)
    least = np.minimum.accumulate(np.concatenate(([0.0], total[:-1])))
    return total - least if work.size else work


def judge(case: Case, compensation: float) -> dict[str, Any]:
    """Run a case and what it is compared with."""
    result = play(case, compensation)
    row: dict[str, Any] = {**dataclasses.asdict(case), "compensation": compensation}
    texts = [event.text for event in result.summary.events]
    row["told"] = any(text.startswith(TOLD) for text in texts)
    row["lowered"] = any(text.startswith(LOWERED) for text in texts)
    row["latched"] = any("latched at" in text for text in texts)
    row["faults"] = list(result.axes[0].faults)
    if not case.change:
        truth, axis = result.truth, result.axes[0]
        t = truth["clock"] - axis.start
        rest = (t > AT + TO_REST + REST) & (t < axis.until)
        row["speed"] = float(np.sqrt(np.mean(np.square(truth["omega_j"][rest]))))
        row["torque"] = float(np.ptp(truth["tau_m"][rest]))
        row["good"] = row["speed"] <= QUIET_SPEED and row["torque"] <= QUIET_TORQUE and not row["told"]
        return row
    t, work = power(result)
    given = windows(work)
    row |= _reaction(result, t, given)
    felt = np.flatnonzero(given > FELT)
    row["work"] = float(given.max(initial=0.0))
    row["late"] = _late(t, work, float(t[felt[0]]) + 1.0) if felt.size else 0.0
    row["onset"] = float(t[felt[0]]) - AT if felt.size else None
    most = 0.5 * LOADS[case.load]
    if row["work"] > most or row["late"] > FELT:
        t, without = power(play(case, 0.0))
        row["work_without"] = float(windows(without).max(initial=0.0))
        row["late_without"] = _late(t, without, AT + (row["onset"] or 0.0) + 1.0)
    row["added"] = max(0.0, row["work"] - row.get("work_without", 0.0))
    row["late_added"] = max(0.0, row["late"] - row.get("late_without", 0.0))
    row["silent"] = row["added"] > ALLOWED + FELT and not (row["told"] or row["lowered"])
    row["good"] = row["added"] <= most and row["late_added"] <= FELT and not row["silent"]
    return row


def _reaction(result: Simulation, t: NDArray[np.float64], given: NDArray[np.float64]) -> dict[str, Any]:
    """How fast the joint was at the change, when the guard first acted after it, and what was given from then on."""
    axis, truth = result.axes[0], result.truth
    speed = float(np.interp(AT, truth["clock"] - axis.start, truth["omega_j"]))
    acted = [event.t for event in result.summary.events if event.t >= AT and event.text.startswith(TOLD)]
    found: dict[str, Any] = {"speed": speed, "acted": None, "after": 0.0}
    if acted:
        at = int(np.searchsorted(t, acted[0]))
        swing = given[at : int(np.searchsorted(t, acted[0] + SWUNG))]
        found |= {"acted": acted[0] - AT, "after": max(0.0, float(swing.max(initial=0.0) - given[at]))}
    return found


def _late(t: NDArray[np.float64], work: NDArray[np.float64], begin: float) -> float:
    return float(windows(work[t >= begin]).max(initial=0.0))


def healthy(load: str, number: int, seconds: float, compensation: float) -> dict[str, Any]:
    """A slice with nothing wrong, its number the seed: what the guard said, and what faults there were."""
    result = play_healthy(load, seconds, compensation, number)
    said = [event.text for event in result.summary.events if event.text.startswith(TOLD)]
    said += [str(fault) for fault in result.axes[0].faults]
    return {"healthy": load, "slice": number, "seconds": seconds, "compensation": compensation, "said": said}


def words(row: dict[str, Any]) -> str:
    if not row["change"]:
        return f"{row['speed']:.3f} rad/s, {row['torque']:.3f} N*m at rest" + (", told" if row["told"] else "")
    silent = ", and nobody said so" if row["silent"] else ""
    acted = f", {1e3 * row['after']:.1f} mJ after all was taken back" if row["acted"] is not None else ""
    late = f"{1e3 * row['added']:.1f} mJ added{acted}, {1e3 * row['late_added']:.1f} mJ of it late"
    return f"{late}, at first {abs(row['speed']):.1f} rad/s{silent}"
