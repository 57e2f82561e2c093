"""Sentences for people: the first line of the report, and what it is made of."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tsa_ctrl.identify.diagnosis.report.result import Cause, Diagnosis, Verdict
from tsa_ctrl.identify.diagnosis.residual.dependence import Finding
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.model.catalogue import CATALOGUE

ALIKE = 1.5  # ratio of the largest to the smallest size that would have been seen, which one number tells
EXCLUDED = 3  # names in the sentence; the report has them all


def spoken(name: str) -> str:
    """An effect's name as words."""
    return name.replace("_", " ")


def listed(names: Sequence[str], last: str = "and") -> str:
    """Names as a person lists them: a, b and c."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"


def sentence(result: Diagnosis) -> str:
    """What is wrong by how much, the cause with its parameter and interval, what was excluded, what it gained."""
    rms = result.rms
    assert rms.recalibrated is not None
    assert rms.extended is not None
    assert rms.noise_floor is not None
    start = f"After recalibration the simulation is off by {_torque(rms.recalibrated)} RMS on held-out data"
    if result.verdict is Verdict.CONSISTENT:
        return f"{start}, which is noise: nothing is wrong with the model beyond its parameters{_visible(result)}."
    if result.verdict is Verdict.UNEXPLAINED:
        return (
            f"{start} where noise is {_torque(rms.noise_floor)}, and nothing in the catalogue explains it: "
            f"{result.unexplained}."
        )
    causes = listed([cause_phrase(cause) for cause in result.causes])
    noise = _torque(rms.noise_floor)
    gained = f"the extended model is off by {_torque(rms.extended)} (noise {noise}, gain {result.gain:.0%})"
    ruled_out = [spoken(name) for name in result.details.excluded[:EXCLUDED]] if result.details else []
    excluded = f" Excluded: {listed(ruled_out)}." if ruled_out else ""
    end = f"; but {result.unexplained}" if result.verdict is Verdict.PARTLY_EXPLAINED else ""
    return f"{start}. Cause: {causes}; {gained}{end}.{excluded}"


def _visible(result: Diagnosis) -> str:
    """The smallest effects that would have been seen: the smallest of all, and that of the effect that hides best."""
    limits = result.detection_limit
    if not limits:
        return ""
    least, most = min(limits, key=lambda name: limits[name]), max(limits, key=lambda name: limits[name])
    if limits[most] < ALIKE * limits[least]:
        return f"; any effect of {_torque(limits[most])} or more would have been seen"
    return (
        f"; {spoken(least)} of {_torque(limits[least])} or more would have been seen, and any other effect from "
        f"{_torque(limits[most])} on ({spoken(most)})"
    )


def cause_phrase(cause: Cause) -> str:
    """Name, alternatives and main parameter of a cause."""
    name = spoken(cause.effect)
    if cause.alternatives:
        name += f" (or {listed([spoken(other) for other in cause.alternatives], 'or')}: this log cannot tell)"
    numbers = [
        f"{spoken(key)} {quantity}"
        for key, quantity in cause.parameters.items()
        if isinstance(quantity, Quantity) and 0.0 < quantity.high - quantity.low < math.inf
    ]
    return f"{name}, {numbers[0]}" if numbers else name


def insufficient_sentence(reason: str) -> str:
    """The first sentence of a report that cannot say anything else."""
    return f"These logs cannot tell: {reason}."


def summary_of(name: str) -> str:
    """What an effect is, from the catalogue; `parameter_error` is none of its effects."""
    return (
        CATALOGUE[name].summary
        if name in CATALOGUE
        else "the file's friction angle or pretension is further off than it says"
    )


def what_is_left(left: Sequence[Finding], suspicions: Sequence[str]) -> str:
    """The largest findings first; `suspicions` of the data, for what nothing else explains."""
    if not left:
        return ""
    first, *others = left[:3]
    share = f"({first.share:.0%} of its mean square)"
    told = [
        f"what is left depends on {first.what} {share}" if _drives(first) else f"what is left is {first.what} {share}"
    ]
    depends = [finding.what for finding in others if _drives(finding)]
    are = [finding.what for finding in others if not _drives(finding)]
    told += [f"it also depends on {listed(depends)}"] if depends else []
    told += [f"there is also {listed(are)}"] if are else []
    return "; ".join([*told, *suspicions])


def _drives(finding: Finding) -> bool:
    """Whether a finding names a signal on which the rest depends; else it names the rest itself."""
    return not finding.what.startswith(("a ", "bursts"))


def _torque(value: float) -> str:
    """A torque in the unit that people read easily."""
    return f"{value * 1e3:.3g} mN*m" if value < 0.1 else f"{value:.3g} N*m"
