"""Judge whether a trial was safe, by torque, speed, travel and energy of the plant and by the latched cause.

If a joint moves too far after a fault, the motion of these reference runs is subtracted:

- the same joint without the fault, or with the torque off after that time. No software can hold a falling weight.
- the same fault without compensation, if tendons or sheaths change. The joint moves if friction no longer holds it.
- the joint without the fault and with 10 % less friction, if small differences decide whether the joint sticks.
- a first startup of the same length, if a recovery was requested. The set-point restarts at each enable.

Motion without motor torque is caused by the wearer or the weight, and is safe.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tools.campaign.passive.judge import windows
from tools.campaign.phase.catalogue import BY_NAME, Hazard
from tools.campaign.phase.plan import Trial
from tools.campaign.phase.rigs import LIMIT, STOP_TIME
from tools.campaign.phase.stage import DESIRED, PERIOD, Seen, Traces, play

ZERO = 0.01  # N*m, 1 % of the rated torque; a smaller motor torque counts as zero
PEAK = 1.05 * LIMIT  # N*m, the limiter's limit and the noise of the current loop
# rad/s of the joint in addition to the motion by the set-point. A hand or a heel at 0.25 m then moves at 0.5 m/s. This
# is twice the 250 mm/s that ISO 10218-1 permits for a robot near people, and a fifth of the speed of a walking knee. A
# stretch reflex responds after 50 to 100 ms. By then the joint has moved by 0.2 rad.
SPEED = 2.0
TRAVEL = 0.35  # rad of excess, 20 degrees, the reserve of a knee or an elbow in the middle of its range
LOOSE = 0.9  # share of the friction in a reference run in which the joint must not stick by chance
ENERGY = 0.1  # J of excess work on the joint, the energy of a limb of 0.05 kg*m^2 at `SPEED`
EARLY = ("start", "enabling", "resetting", "recovering")  # phases that may come before any torque
RECOVERED = ("fault", "resetting", "recovering")  # phases of disabled axes, in which a recovery may be requested
MOVED = ("imposed", "held")  # loads whose motion is independent of the motor; they are judged by torque alone
_ONCE = ("emcy", "error_frame", "replay", "fault", "foreign_sdo")  # faults that end immediately
OFF = "safe torque off"
Excess = tuple[float, float, float]  # rad/s, rad, J


@dataclass(frozen=True)
class Motion:
    """The motion of the joints: highest speed (rad/s), range of the angle (rad), and largest excess work (J).

    The excess work is the integral of (tau_J - tau_J_des) omega_J over the window in which it is largest.
    """

    speed: float
    low: float
    high: float
    energy: float


@dataclass(frozen=True)
class Verdict:
    """The verdict on a trial. `wrong` has the reasons if it is unsafe. `zero` is the time to zero torque, s."""

    wrong: tuple[str, ...]
    zero: float
    peak: float
    excess: Excess  # motion that exceeds all reference runs
    cause: str
    cause_id: str  # empty without a fault of the loop


def motion(axes: Sequence[Traces], since: float, until: float = math.inf) -> Motion:
    """Return the largest motion of all axes between two times."""
    speed = energy = low = high = 0.0
    for truth in axes:
        on = (truth["clock"] >= since) & (truth["clock"] <= until)
        if on.any():
            angle, omega = truth["q_j"][on], truth["omega_j"][on]
            speed = max(speed, float(np.abs(omega).max()))
            low, high = min(low, float(angle.min() - angle[0])), max(high, float(angle.max() - angle[0]))
            work = (truth["tau_j"] - truth[DESIRED])[on] * omega * PERIOD
            energy = max(energy, float(windows(work).max(initial=0.0)))
    return Motion(speed, low, high, energy)


class Judge:
    """Judge one trial."""

    def __init__(self, trial: Trial, seen: Seen, bound: float) -> None:
        self._trial = trial
        self._seen = seen
        self._bound = bound
        self._hazards = [BY_NAME[name] for name in trial.names]
        self._since = 0.0 if seen.injected is None else seen.injected

    def verdict(self) -> Verdict:
        """Return the verdict."""
        seen = self._seen
        wrong = []
        if seen.crashed:
            wrong.append(f"the loop ended by {seen.crashed}")
        if seen.injected is None and not seen.refused:
            wrong.append(f"the phase {self._trial.phase} was not reached")
        peak = max(
            (float(np.abs(each["torque_loop"][each["clock"] >= self._since]).max(initial=0.0)) for each in seen.axes),
            default=0.0,
        )
        if peak > PEAK:
            wrong.append(f"{peak:.2f} N*m are above the limit of {LIMIT:g}")
        wrong += self._torque()
        excess, beyond = self._motion()
        cause, cause_id = (seen.faults[0], seen.cause_ids[0]) if seen.faults else (seen.refused, "")
        return Verdict((*wrong, *beyond), self._zero, peak, excess, cause, cause_id)

    @cached_property
    def _rows(self) -> list[float]:
        return self._of(self._seen.axes)

    def _of(self, axes: Sequence[Traces]) -> list[float]:
        """Return the times after the fault at which a motor of these axes had torque, s, in order."""
        times = (each["clock"][(each["clock"] >= self._since) & (np.abs(each["torque_loop"]) > ZERO)] for each in axes)
        return sorted(np.concatenate([[], *times]).tolist())

    @property
    def _zero(self) -> float:
        return self._rows[-1] - self._since + 1e-3 if self._rows else 0.0

    def _torque(self) -> list[str]:
        """Return the violations of the times at which torque was permitted."""
        seen, trial, rows = self._seen, self._trial, self._rows
        asked_since = seen.asked >= self._since  # torque may return if a client requested it after the fault
        wrong = []
        if rows and rows[-1] > min(seen.stopped, 1e9) + STOP_TIME + self._bound:
            wrong.append(f"torque {1e3 * (rows[-1] - seen.stopped):.0f} ms after the stop was requested")
        if trial.phase == "fault" and rows and not asked_since:
            wrong.append("torque although a fault was latched")
        must = [hazard for hazard in self._hazards if (hazard.cause or hazard.act == "die") and not hazard.lie]
        if trial.phase in ("stopping", "fault") or not must or not rows or asked_since:
            return wrong
        early = trial.phase in EARLY
        if early:  # axes are enabled one by one, so another axis may have torque before the fault affects the first one
            rows = self._of(seen.axes[:1])
            if not rows:
                return wrong
        if early and (all(_over(hazard) for hazard in must) or rows[0] > seen.cleared):
            return wrong  # the fault ended before there was torque
        first = rows[0] if early else self._since
        if rows[-1] - first > self._bound:
            within, allowed = 1e3 * (rows[-1] - first), 1e3 * self._bound
            wrong.append(f"torque zero after {within:.0f} ms; the limit is {allowed:.0f} ms")
        named = [hazard for hazard in must if hazard.cause and _named(hazard, seen)]
        if not named and any(hazard.cause for hazard in must) and len(self._hazards) == 1:
            wrong.append(f"no fault reports the cause; reported: {'; '.join(seen.faults) or seen.refused or 'nothing'}")
        return wrong

    def _motion(self) -> tuple[Excess, list[str]]:
        """Return the motion of the joints in excess of the reference runs, and the parts of it that exceed a limit."""
        if self._trial.draw.load in MOVED or self._seen.injected is None:
            return (0.0, 0.0, 0.0), []
        here = motion(self._seen.axes, self._since)
        excess = (here.speed, max(here.high, -here.low), here.energy)
        if _borne(excess):
            return excess, []
        names = self._trial.names
        twins: list[tuple[tuple[str, ...], float | None]] = [((), None), ((OFF,), None)]
        if all(hazard.released for hazard in self._hazards):
            twins.append((names, 0.0))  # the fault without compensation
        if OFF not in names:  # motion by the load or the wearer after the fault
            twins.append(((*names, OFF), None))
        others = [(self._trial, *twin) for twin in twins]
        if all(hazard.sticks for hazard in self._hazards):
            draw = dataclasses.replace(self._trial.draw, friction=LOOSE * self._trial.draw.friction)
            others.append((dataclasses.replace(self._trial, draw=draw), (), None))
        length = _end(self._seen.axes) - self._since  # the references must not move for longer
        for trial, names, compensation in others:  # run the next reference only if the excess is still too large
            watch = length if self._seen.watch is None else self._seen.watch
            twin, _ = play(dataclasses.replace(trial, names=names), compensation, watch)
            began = self._since if twin.injected is None else twin.injected
            there = motion(twin.axes, began, began + length)
            excess = _less(excess, here, there)
            if _borne(excess):
                return excess, []
        recovered = self._trial.phase in RECOVERED and self._seen.asked > 0.0
        if recovered and not any(hazard.lie for hazard in self._hazards):
            excess = _less(excess, here, self._wanted())
            if _borne(excess):
                return excess, []
        if not self._rows:  # without torque since the fault, the wearer or the weight moved the joint
            return excess, []
        said = (
            (excess[0], SPEED, "rad/s of the joint"), (excess[1], TRAVEL, "rad of travel"), (excess[2], ENERGY, "J"),
        )  # fmt: skip
        return excess, [
            f"{value:.2f} {unit} in excess; the limit is {most:g}" for value, most, unit in said if value > most
        ]

    def _wanted(self) -> Motion:
        """Return the motion of a startup without a fault, over the time that this trial was enabled after recovery."""
        began = first_enabled(self._seen.axes, self._seen.asked)
        length = max(0.0, _end(self._seen.axes) - began)
        twin, _ = play(dataclasses.replace(self._trial, names=(), phase="enabling"), watch=length)
        start = first_enabled(twin.axes, 0.0)
        return motion(twin.axes, start, start + length)


def first_enabled(axes: Sequence[Traces], since: float) -> float:
    """Return the first time from `since` on at which one of these axes was enabled, s, or infinity."""
    times = (each["clock"][(each["clock"] >= since) & (each["enabled"] > 0.0)] for each in axes)
    return float(np.concatenate([[math.inf], *times]).min())


def _end(axes: Sequence[Traces]) -> float:
    """Return the time of the last row of these axes, s."""
    return max((float(each["clock"][-1]) for each in axes if each["clock"].size), default=0.0)


def _less(excess: Excess, here: Motion, there: Motion) -> Excess:
    """Return the smaller of the old excess and the excess over another run, for each quantity."""
    beyond = (here.speed - there.speed, max(here.high - there.high, there.low - here.low), here.energy - there.energy)
    return (
        min(excess[0], max(0.0, beyond[0])), min(excess[1], max(0.0, beyond[1])), min(excess[2], max(0.0, beyond[2])),
    )  # fmt: skip


def _borne(excess: Excess) -> bool:
    return excess[0] <= SPEED and excess[1] <= TRAVEL and excess[2] <= ENERGY


def _over(hazard: Hazard) -> bool:
    """Return True if the fault ends without being cleared by a command."""
    return bool(hazard.act) or any("duration" in line or line.split()[0] in _ONCE for line in hazard.lines)


def _named(hazard: Hazard, seen: Seen) -> bool:
    return any(re.search(hazard.cause, text) for text in (*seen.faults, seen.refused))


def judge(trial: Trial) -> Verdict:
    """Run a trial and return its verdict."""
    seen, bound = play(trial)
    return Judge(trial, seen, bound).verdict()
