"""Calculate the marks of a diagnosis from the hidden effects. Define the targets of the benchmark."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from scipy.stats import beta

from .cases import Case
from .outside import OF_A_CLOCK, OF_A_FILTER, OF_AN_INSTANT

MOST_ALTERNATIVES = 2
LEAST_DESCRIBED = 0.7  # smallest share of the residual that a formula must explain to describe it
WHOLE = ("cycles_per_revolution", "elements")  # parameters without an interval


@dataclass
class Mark:
    """The marks of one diagnosis. A mark is None if it does not apply to the family."""

    named: bool = False  # at least one cause is listed
    unique: bool | None = None  # only the truth is listed, without alternatives
    within: bool | None = None  # one cause that includes the truth and has at most two alternatives
    wrong: bool = False  # a cause without alternatives that is not the truth
    both: bool | None = None  # pairs: both effects, at most two alternatives each, and no other cause
    both_within: bool | None = None
    flagged: bool | None = None  # outside: unexplained or partly explained
    falsely_explained: bool | None = None
    described: bool | None = None  # outside: a formula explains most of the residual above the noise
    # confounded: a group with the truth and an indistinguishable effect (or another allowed answer), not one cause
    grouped: bool | None = None
    advised: bool | None = None  # confounded: an experiment is proposed
    resolved: bool | None = None  # confounded: the experiment's log identifies the truth alone
    covered: dict[str, bool] = field(default_factory=dict)  # parameter: True if its interval contains the truth

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def mark(case: Case, report: dict[str, Any], experiment: dict[str, Any] | None = None) -> Mark:
    """Return the marks of the reports (contents of diagnosis.json) on a case and on its experiment."""
    causes = report["causes"]
    truth = set(case.truth.effects)
    out = Mark(named=bool(causes))
    out.wrong = any(not cause["alternatives"] and cause["effect"] not in truth for cause in causes)
    if case.family == "confounded":
        _mark_confounded(out, case, report, experiment)
        out.wrong = any(not cause["alternatives"] for cause in causes) and not out.grouped
    elif case.truth.outside:
        out.flagged = report["verdict"] in ("unexplained", "partly_explained")
        out.falsely_explained = report["verdict"] == "explained"
        out.described = _taken_by_the_formula(report, case.truth.noise) >= LEAST_DESCRIBED
    elif len(truth) == 1:
        out.unique = is_unique(causes, truth)
        out.within = len(causes) == 1 and _holds(causes[0], truth)
        if out.unique:
            out.covered = _covered(causes[0], case)
    elif len(truth) == 2:
        few = all(len(cause["alternatives"]) <= MOST_ALTERNATIVES for cause in causes)
        out.both = {cause["effect"] for cause in causes} == truth and len(causes) == 2 and few
        first, second = truth
        out.both_within = len(causes) == 2 and any(
            _holds(a, {first}) and _holds(b, {second}) for a, b in (causes, causes[::-1])
        )
    if not truth and not case.truth.outside:
        out.covered = _base_covered(report["parameter_errors"], case.truth.numbers)
    return out


def is_unique(causes: list[dict[str, Any]], truth: set[str]) -> bool:
    return len(causes) == 1 and causes[0]["effect"] in truth and not causes[0]["alternatives"]


def _holds(cause: dict[str, Any], truth: set[str]) -> bool:
    alternatives = cause["alternatives"]
    return len(alternatives) <= MOST_ALTERNATIVES and bool(truth & {cause["effect"], *alternatives})


def _mark_confounded(out: Mark, case: Case, report: dict[str, Any], experiment: dict[str, Any] | None) -> None:
    causes, truth, twins = report["causes"], set(case.truth.effects), set(case.truth.twins)
    names = {causes[0]["effect"], *causes[0]["alternatives"]} if len(causes) == 1 else set()
    group = truth <= names and bool((twins - truth) & names)
    absorbed = "parameter_error" in twins
    out.grouped = group or report["verdict"] == "insufficient"
    if absorbed:  # recalibration absorbs it, so that finding no cause is right
        out.grouped = out.grouped or report["verdict"] == "consistent"
    if not case.truth.exact:
        out.grouped = out.grouped or is_unique(causes, truth)
    out.advised = bool(report["experiment"])
    if experiment is not None:
        out.resolved = is_unique(experiment["causes"], truth)


def _covered(cause: dict[str, Any], case: Case) -> dict[str, bool]:
    """Return for each parameter: True if its interval contains the hidden value. Empty for a different law."""
    hidden = case.truth.effects[cause["effect"]]
    found = cause["parameters"]
    defaults = {"elements": 1, "displacement": "motor" if any("q_m" in log.columns for log in case.logs) else "joint"}
    for key in ("law", "curvature_profile", "displacement", *WHOLE):
        value = found.get(key)
        value = value["value"] if isinstance(value, dict) else value
        if value is not None and value != hidden.get(key, defaults.get(key, value)):
            return {}
    out = {}
    for key, value in hidden.items():
        quantity = found.get(key)
        if isinstance(value, str) or key in WHOLE or not isinstance(quantity, dict) or quantity.get("low") is None:
            continue
        if quantity["low"] == quantity["high"]:
            continue
        turns = (-2.0 * np.pi, 0.0, 2.0 * np.pi) if key == "phase" else (0.0,)
        out[f"{cause['effect']}.{key}"] = any(quantity["low"] <= value + turn <= quantity["high"] for turn in turns)
    return out


def _base_covered(errors: dict[str, Any], numbers: dict[str, float]) -> dict[str, bool]:
    out = {}
    for key, quantity in errors.items():
        if key in numbers and quantity.get("low") is not None and quantity["low"] < quantity["high"]:
            out[key] = bool(quantity["low"] <= numbers[key] <= quantity["high"])
    return out


def _taken_by_the_formula(report: dict[str, Any], noise: float) -> float:
    """Return the share of the held-out mean square above the noise (N*m RMS) that a formula explains, or 0."""
    formula = report.get("formula")
    if formula is None:
        return 0.0
    before, after = formula["rms"]["before"] ** 2, formula["rms"]["after"] ** 2
    return float((before - after) / max(before - noise**2, 1e-300)) if before > noise**2 else 0.0


def interval(count: int, total: int, level: float = 0.95) -> tuple[float, float]:
    """Return the Clopper-Pearson interval of the binomial share for `count` successes in `total` trials."""
    if total == 0:
        return 0.0, 1.0
    tail = 0.5 * (1.0 - level)
    low = 0.0 if count == 0 else float(beta.ppf(tail, count, total - count + 1))
    high = 1.0 if count == total else float(beta.ppf(1.0 - tail, count + 1, total - count))
    return low, high


@dataclass(frozen=True)
class Target:
    """One row of the table: its results, the criterion of success, and the required share."""

    text: str
    family: str
    success: Callable[[dict[str, Any]], bool | None]
    share: float
    at_most: bool = False


def _key(name: str) -> Callable[[dict[str, Any]], bool | None]:
    return lambda result: result["mark"][name]


TARGETS = (
    Target("no effect: something named", "none", _key("named"), 0.01, at_most=True),
    Target("single effect: named uniquely", "single", _key("unique"), 0.95),
    Target("single effect: within effect and two alternatives", "single", _key("within"), 0.99),
    Target("single effect: confidently wrong", "single", _key("wrong"), 0.01, at_most=True),
    Target("two effects: both named, nothing else", "pair", _key("both"), 0.90),
    Target("outside the catalogue: noticed", "outside", _key("flagged"), 0.95),
    Target("outside the catalogue: falsely explained", "outside", _key("falsely_explained"), 0.05, at_most=True),
    Target("exactly confounded: a group, not a name", "confounded", _key("grouped"), 1.00),
    Target("exactly confounded: an experiment is named", "confounded", _key("advised"), 1.00),
    Target("exactly confounded: resolved by the experiment", "confounded", _key("resolved"), 0.90),
    Target("plain drive, no effect: something named", "rigid_none", _key("named"), 0.01, at_most=True),
    Target("plain drive, one effect: named uniquely", "rigid", _key("unique"), 0.95),
    Target("geared drive, no effect: something named", "geared_none", _key("named"), 0.01, at_most=True),
    Target("geared drive, one effect: named uniquely", "geared", _key("unique"), 0.95),
)


def _described_of(names: Sequence[str]) -> Callable[[dict[str, Any]], bool | None]:
    """Return a criterion that is True if a formula explains most of the residual, and None for other `names`."""
    return lambda result: bool(result["mark"]["described"]) if result["name"] in names else None


QUIET = ("consistent", "insufficient")
FURTHER = (
    Target(
        "no effect: a verdict but consistent or insufficient", "none", lambda r: r["verdict"] not in QUIET, 0.05, True
    ),
    Target("direction hidden, no effect: something named", "hidden_direction", _key("named"), 0.01, at_most=True),
    Target(
        "direction hidden, no effect: structure claimed",
        "hidden_direction",
        lambda r: r["verdict"] not in QUIET,
        0.02,
        True,
    ),
    Target("two effects: both within two alternatives", "pair", _key("both_within"), 0.90),
    Target("outside the catalogue: a confident name", "outside", _key("wrong"), 0.05, at_most=True),
    Target("outside the catalogue: a formula takes 70 % of what is left", "outside", _key("described"), 0.60),
    Target("of these, a function of an instant: the same", "outside", _described_of(OF_AN_INSTANT), 0.60),
    Target("of these, with a filter's memory of the load: the same", "outside", _described_of(OF_A_FILTER), 0.60),
    Target("of these, by a clock: the same", "outside", _described_of(OF_A_CLOCK), 0.60),
    Target("exactly confounded: a confident name", "confounded", _key("wrong"), 0.0, at_most=True),
)


def family_of(result: dict[str, Any]) -> str:
    family = str(result["family"])
    return f"{family}_none" if family in ("rigid", "geared") and result["name"] == "none" else family


def counted(target: Target, results: Iterable[dict[str, Any]]) -> tuple[int, int]:
    """Return successes and trials of one row."""
    answers = [target.success(r) for r in results if family_of(r) == target.family]
    answers = [answer for answer in answers if answer is not None]
    return sum(bool(answer) for answer in answers), len(answers)
