"""Generate the table of hazards from the catalogue and the results of the campaign in virtual time."""

from __future__ import annotations

import json
from typing import Any

from tools.campaign.phase import plan
from tools.campaign.phase.catalogue import HAZARDS, Hazard
from tools.campaign.phase.results import KEPT
from tools.campaign.phase.rigs import LIMIT
from tsa_ctrl.safety.causes import Cause

HEAD = (
    "hazard", "cause", "detected as", "reaction", "torque zero after, median (worst)",
    "joint at worst: rad/s, rad, J", "residual risk", "safe of trials",
)  # fmt: skip
HARDWARE = (
    ("the motor has torque although its drive reports that it is off", "safe torque off, by a switch within reach"),
    ("a limb falls when the torque ends", "a brake, a counterweight or springs; a mechanical end stop"),
    ("both measurements of a quantity have the same error", "a second sensor of another kind; a slipping clutch"),
    ("the unloaded tendon tears, and the other pulls with its pretension", "an end stop; less pretension"),
)
WHOLE = len(HAZARDS) * len(plan.PHASES) * plan.MOMENTS  # trials of the campaign
PAIRS = plan.PAIRS
STOPS = "latched"


def load() -> dict[str, Any]:
    """Return the results that `tools/run campaign/virtual --keep` wrote."""
    found: dict[str, Any] = json.loads(KEPT.read_text(encoding="utf-8"))
    return found


def rows() -> list[tuple[str, ...]]:
    """Return a line for each hazard with results, in the order of the catalogue."""
    kept = load()
    found, watched = kept["hazards"], kept["about"]["watched"]
    return [_line(hazard, found[hazard.name], watched) for hazard in HAZARDS if hazard.name in found]


def _line(hazard: Hazard, row: dict[str, Any], watched: float) -> tuple[str, ...]:
    stopped, running = row["stopped"], row["running"]
    goes_on = hazard.goes_on or f"no effect within {watched:g} s"
    if not running:
        reaction = "no trial with torque in this sample"
    elif not stopped:
        reaction = "the drive's time-out" if hazard.act == "die" else f"continues: {goes_on}"
    elif stopped < running:
        reaction = f"{STOPS} in {stopped} of {running}, otherwise continues: {goes_on}"
    else:
        reaction = STOPS
    detected = "; ".join(row["causes"]) or "-"
    zero = "-"
    if row["zero_worst"] is not None:
        zero = f"{1e3 * row['zero_median']:.0f} ms ({1e3 * row['zero_worst']:.0f} ms)"
    worst = f"{row['speed']:.1f}, {row['travel']:.2f}, {row['energy']:.2f}"
    unsafe = "".join(f"; {count} unsafe while {phase}" for phase, count in row["unsafe"].items())
    residual = "; ".join(words for words in (hazard.residual, _open(hazard, row)) if words) or "-"
    counted = f"{row['safe']}/{row['trials']}{unsafe}"
    return hazard.hazard, hazard.name, detected, reaction, zero, worst, residual, counted


def _open(hazard: Hazard, row: dict[str, Any]) -> str:
    """Describe the known unsafe trials of a hazard: their number, joints and excess, and the present limits."""
    if not hazard.open:
        return ""
    beyond = row.get("beyond")
    if beyond is None:
        return f"open, although all these trials were safe: {hazard.open}"
    count = sum(row["unsafe"].values())
    joints = ", ".join(f"{name} {times}" for name, times in beyond["joints"].items())
    worst = f"{beyond['speed']:.1f} rad/s, {beyond['travel']:.2f} rad, {beyond['energy']:.2f} J"
    if beyond["peak"] > LIMIT:
        worst += f", {beyond['peak']:.1f} N*m at the motor"
    return (
        f"open in {count} of {row['trials']} (joint {joints}; {beyond['blind']} of them without a torque sensor; at "
        f"worst {worst}): {hazard.open}"
    )


def not_shown() -> list[str]:
    """Return the titles of the causes that are not among the main causes of any hazard."""
    shown = {cause_id for row in load()["hazards"].values() for cause_id in row["cause_ids"]}
    return [cause.title for cause in Cause if cause.id not in shown]
