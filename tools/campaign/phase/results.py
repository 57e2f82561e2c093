"""Return the results of a campaign as one row for each trial and a summary for each hazard."""

from __future__ import annotations

import re
import statistics
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from tools.campaign.phase.catalogue import HAZARDS
from tools.campaign.phase.plan import Trial
from tools.campaign.phase.verdict import Verdict
from tools.command import Row

WITH_TORQUE = ("ramping", "running", "tuning")  # phases with torque, for which the time to zero torque is evaluated
KEPT = Path(__file__).with_name("hazards.json")  # source of the table in the manual


def row(trial: Trial, verdict: Verdict, seed: int) -> Row:
    """Return the row of one trial."""
    draw, (speed, travel, energy) = trial.draw, verdict.excess
    return {
        "key": trial.key,
        "names": list(trial.names),
        "phase": trial.phase,
        "seed": seed,
        "rig": [draw.load, draw.shape, draw.wanted, draw.axes, draw.sensor, draw.delay],
        "wrong": list(verdict.wrong),
        "zero": round(verdict.zero, 4),
        "peak": round(verdict.peak, 3),
        "speed": round(speed, 3),
        "travel": round(travel, 3),
        "energy": round(energy, 4),
        "cause": verdict.cause,
        "cause_id": verdict.cause_id,
    }


def summary(rows: Iterable[Row]) -> dict[str, Row]:
    """Return trials, safe trials, causes, times to zero torque, and worst motion and energy of each hazard."""
    by_name: dict[str, list[Row]] = {hazard.name: [] for hazard in HAZARDS}
    for each in rows:
        if len(each["names"]) == 1:
            by_name[each["names"][0]].append(each)
    return {name: _summed(found) for name, found in by_name.items() if found}


def _summed(rows: list[Row]) -> Row:
    running = [each for each in rows if each["phase"] in WITH_TORQUE]
    stopped = [each for each in running if each["cause"]]
    zeros = [each["zero"] for each in stopped]
    causes = Counter((_short(each["cause"]), each.get("cause_id", "")) for each in stopped).most_common(2)
    unsafe = Counter(each["phase"] for each in rows if each["wrong"])
    return {
        "trials": len(rows),
        "safe": sum(not each["wrong"] for each in rows),
        "running": len(running),
        "stopped": len(stopped),
        "causes": [cause for (cause, _), _ in causes],
        "cause_ids": [cause_id for (_, cause_id), _ in causes],
        "zero_median": round(statistics.median(zeros), 3) if zeros else None,
        "zero_worst": round(max(zeros), 3) if zeros else None,
        "peak": max(each["peak"] for each in rows),
        "speed": round(max(each["speed"] for each in rows), 2),
        "travel": round(max(each["travel"] for each in rows), 2),
        "energy": round(max(each["energy"] for each in rows), 3),
        "unsafe": dict(unsafe),
        **({"beyond": _beyond([each for each in rows if each["wrong"]])} if unsafe else {}),
    }


def _beyond(rows: list[Row]) -> Row:
    """Return the joints of the unsafe trials, the number without a torque sensor, and the worst values."""
    return {
        "joints": dict(Counter(each["rig"][0] for each in rows).most_common()),
        "blind": sum(not each["rig"][4] for each in rows),
        **{name: max(each[name] for each in rows) for name in ("peak", "speed", "travel", "energy")},
    }


def _short(cause: str) -> str:
    """Return the kind of a cause without the numbers of one trial."""
    words = cause
    for separator in (" says ", ": ", " by ", "; ", " (", ", "):
        words = words.partition(separator)[0]
    if cause.startswith("emergency") and "EMCY" in cause:
        words = f"{words}: EMCY {cause.partition('EMCY ')[2][:6]}"
    return re.sub(r" \d+ of \d+ .*", "", words)
