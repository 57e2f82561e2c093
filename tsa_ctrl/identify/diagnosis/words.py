"""Sentences for people: the first line of the report, and what it is made of."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tsa_ctrl.identify.diagnosis.result import Cause, Diagnosis, Verdict
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.model.catalogue import CATALOGUE


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
        smallest = min(result.detection_limit.values(), default=None)
        seen = f"; an effect of {_torque(smallest)} or more would have been seen" if smallest else ""
        return f"{start}, which is noise: nothing is wrong with the model beyond its parameters{seen}."
    if result.verdict is Verdict.UNEXPLAINED:
        return (
            f"{start} where noise is {_torque(rms.noise_floor)}, and nothing in the catalogue explains it: "
            f"{result.unexplained}."
        )
    causes = listed([cause_phrase(cause) for cause in result.causes])
    noise = _torque(rms.noise_floor)
    gained = f"the extended model is off by {_torque(rms.extended)} (noise {noise}, gain {result.gain:.0%})"
    end = f"; but {result.unexplained}" if result.verdict is Verdict.PARTLY_EXPLAINED else ""
    return f"{start}. Cause: {causes}; {gained}{end}."


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


def _torque(value: float) -> str:
    """A torque in the unit that people read easily."""
    return f"{value * 1e3:.3g} mN*m" if value < 0.1 else f"{value:.3g} N*m"
