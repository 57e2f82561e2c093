"""Run one change of the plant while the loop is running, and evaluate the plant's true torque and speed."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tools.campaign.passive.experiment import INERTIA, Experiment
from tools.campaign.passive.judge import GUARD, FloatArray, latches, peak_speed, power, reactions, speed, windows
from tools.campaign.passive.scan import RELAXED, REST, STILL
from tsa_ctrl.ipc.protocol import Event
from tsa_ctrl.virtual.result import Simulation
from tsa_ctrl.virtual.script import Change, Fault

AT, WATCHED, LATCHED = 1.2, 3.0, 1.2  # s: time of the change; observation after the change, and after a latch
LET_GO = 0.2  # s from the change until the hand releases the joint
TO_REST, AT_REST, MEASURED = 2.0, 3.0, 1.0  # s: set-point gain fades to 0, motion decays, measurement at rest
SWUNG = 0.05  # s after the guard has acted, by which a swing has decayed
FELT = 1e-3  # J, three times the energy of a healthy reversal
ALLOWED = 3e-3  # J, [axis.passivity] energy as shipped
CONFIRMED = 2.5  # s of the log, by which the tendons have slid in both directions with a sine
LOST = {"free": 60e-3}  # J, most work that a loss after CONFIRMED may add with a joint encoder; 30 mJ for other loads
QUIET_SPEED, QUIET_TORQUE = 0.02, 0.02  # rad/s RMS, N*m peak to peak


@dataclass(frozen=True)
class Case:
    """One run with a change at the time `at` (s) of the log. Without a `change`, the set-point ends at this time."""

    sensors: str
    load: str
    set_point: str
    change: str
    share: float
    delay: int
    at: float

    @property
    def name(self) -> str:
        return f"{self.sensors}, {self.load}, {self.set_point}, {self.what}, delay {self.delay}, at {self.at:g} s"

    @property
    def what(self) -> str:
        return f"{self.change} {self.share:g}" if self.change else "nothing"

    @property
    def stands(self) -> bool:
        return self.set_point in ("zero", "constant")

    @property
    def most(self) -> float | None:
        """Return the goal for the added work, J, or None without a goal."""
        if self.sensors == "sensor":
            return 0.5 * INERTIA[self.load]
        lost = self.change in ("pretension", "friction") and self.share < 1.0
        if self.sensors == "encoder" and self.set_point == "sine" and lost and self.at >= CONFIRMED:
            return LOST.get(self.load, 30e-3)
        return None

    def play(self, compensation: float) -> Simulation:
        """Run the case with this compensation."""
        go = self.at + LET_GO
        hands: dict[str, Sequence[Sequence[float]]] = {
            "limb": ((0.0, 0.0, 1.0, 0.0), (go, 0.0, 1.0, 0.0), (go + 0.01, 0.0, 0.0, 0.0)),
            "wearer": RELAXED,
        }
        hand = hands.get(self.load) if self.stands else None
        rig = Experiment(
            self.load, self.set_point, self.sensors, delay=self.delay, compensation=compensation, hand=hand
        )
        if not self.change:
            changes = [Change("setpoint_gain", 0.0, self.at)]
            return rig.play(self.at + TO_REST + AT_REST + MEASURED, changes=changes)
        faults = [Fault(f"{self.change} value={self.share:g}", self.at)]
        if self.stands:
            faults.append(Fault("push value=0.5 duration=0.05", self.at))
        return rig.play(self.at + WATCHED, faults, ended=Ended(self.at, self.stands))


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


def judge(case: Case, compensation: float, compare: bool = False) -> dict[str, Any]:
    """Run and evaluate a case. If it may miss a goal, or with `compare`, also run it at compensation 0."""
    result = case.play(compensation)
    events = result.summary.events
    row: dict[str, Any] = {**dataclasses.asdict(case), "compensation": compensation, **reactions(events, case.at)}
    row["told"] = any(event.text.startswith(GUARD) for event in events)
    row["words"] = next((event.text for event in events if event.t > case.at and event.text), "")
    if not case.change:
        truth, axis = result.truth, result.axes[0]
        begin = case.at + TO_REST + AT_REST
        t = truth["clock"] - axis.start
        row["speed"] = speed(result, begin, axis.until)
        row["torque"] = float(np.ptp(truth["tau_m"][(t > begin) & (t < axis.until)]))
        row["good"] = row["speed"] <= QUIET_SPEED and row["torque"] <= QUIET_TORQUE and not row["told"]
        return row
    t, work = power(result, case.at)
    given = windows(work)
    row |= _swing(result, case.at, t, given)
    felt = np.flatnonzero(given > FELT)
    row["work"] = float(given.max(initial=0.0))
    row["late"] = _late(t, work, float(t[felt[0]]) + 1.0) if felt.size else 0.0
    row["onset"] = float(t[felt[0]]) - case.at if felt.size else None
    row["peak"] = peak_speed(result, case.at)
    most = 0.0 if compare else ALLOWED
    if row["work"] > most or row["late"] > FELT:
        t, work, row["peak_without"] = _without(dataclasses.replace(case, sensors="sensor"))
        row["work_without"] = float(windows(work).max(initial=0.0))
        row["late_without"] = _late(t, work, case.at + (row["onset"] or 0.0) + 1.0)
    row["added"] = max(0.0, row["work"] - row.get("work_without", 0.0))
    row["late_added"] = max(0.0, row["late"] - row.get("late_without", 0.0))
    row["silent"] = row["added"] > ALLOWED + FELT and row["reported"] is None
    row["good"] = case.most is None or row["added"] <= case.most
    if case.sensors == "sensor":
        row["good"] &= row["late_added"] <= FELT and not row["silent"]
    return row


@functools.lru_cache(maxsize=8)
def _without(case: Case) -> tuple[FloatArray, FloatArray, float]:
    """Return times, work per row and highest speed of a case at compensation 0, which do not depend on the sensors."""
    result = case.play(0.0)
    return *power(result, case.at), peak_speed(result, case.at)


def _swing(result: Simulation, at: float, t: FloatArray, given: FloatArray) -> dict[str, Any]:
    """Return the joint's speed at the change, and the work after the guard first acted on it."""
    axis, truth = result.axes[0], result.truth
    speed_then = float(np.interp(at, truth["clock"] - axis.start, truth["omega_j"]))
    acted = [event.t for event in result.summary.events if event.t >= at and event.text.startswith(GUARD)]
    found: dict[str, Any] = {"speed": speed_then, "acted": None, "after": 0.0}
    if acted and t.size:
        place = min(int(np.searchsorted(t, acted[0])), t.size - 1)
        swing = given[place : int(np.searchsorted(t, acted[0] + SWUNG))]
        found |= {"acted": acted[0] - at, "after": max(0.0, float(swing.max(initial=0.0) - given[place]))}
    return found


def _late(t: FloatArray, work: FloatArray, begin: float) -> float:
    return float(windows(work[t >= begin]).max(initial=0.0))
