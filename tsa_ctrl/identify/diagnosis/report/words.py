"""Sentences for people: the first line of the report, what follows it, and what they are made of."""

from __future__ import annotations

from collections.abc import Sequence

from tsa_ctrl.identify.diagnosis.report.result import Cause, Diagnosis, Rms, Verdict
from tsa_ctrl.identify.diagnosis.residual.dependence import Finding
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.identify.three_errors import MORE_THAN_NOISE, ThreeErrors
from tsa_ctrl.model.catalogue import CATALOGUE, PARAMETER_ERROR

MOST_WORDS = 35  # of the first sentence: more is not read at once
ALIKE = 1.5  # ratio of the largest to the smallest size that would have been seen, which one number tells
EXCLUDED = 3  # names in the remarks; the report has them all
MOSTLY = 0.5  # of the mean square that is left: a formula that takes more is the first thing to be told
NO_MORE = 1.1  # times the sensor noise, the accuracy of its estimate
SMALL = 0.1  # N*m, RMS below which torques are told in mN*m


def spoken(name: str) -> str:
    """An effect's name as words; the parameters may be wrong, too, where they are not all that is."""
    return "wrong parameters alone" if name == PARAMETER_ERROR else name.replace("_", " ")


def listed(names: Sequence[str], last: str = "and") -> str:
    """Names as a person lists them: a, b and c."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"


def told_torque(value: float | None) -> str:
    """A torque in the unit that people read easily; text, tables and pictures have the same digits."""
    if value is None:
        return "unknown"
    return f"{value * 1e3:.3g} mN·m" if abs(value) < SMALL else f"{value:.3g} N·m"


def torque_scale(rms: Rms) -> tuple[float, str]:
    """Factor and unit in which the pictures of a diagnosis draw errors."""
    return (1e3, "mN·m") if (rms.recalibrated or 0.0) < SMALL else (1.0, "N·m")


def recalibration_is_worse(rms: Rms) -> bool:
    """Whether the model as given does better than recalibrated on data that nothing was fitted on."""
    return rms.as_given is not None and rms.recalibrated is not None and rms.recalibrated > rms.as_given


def sentence(result: Diagnosis) -> str:
    """The first line: what is wrong, by how much, the cause, what it gained; as full as MOST_WORDS leave room for."""
    rms = result.rms
    best = rms.as_given if recalibration_is_worse(rms) else rms.recalibrated
    how = "as given" if recalibration_is_worse(rms) else "recalibrated"
    off = f"the simulation is off by {told_torque(best)} RMS on held-out data"
    if result.verdict is Verdict.CONSISTENT:
        return f"Nothing is wrong with the model beyond its parameters: {how}, {off}; noise is {noise_of(result)}."
    if result.verdict is Verdict.UNEXPLAINED:
        noise = f"{how.capitalize()}, {off} where noise is {noise_of(result)}, and no effect explains it"
        if result.formula and result.formula.gain > MOSTLY:
            follows = f"{noise}; a formula takes {result.formula.gain:.0%} of it"
            return _short(f"{follows}: {result.formula.expression}.", f"{follows}.")
        return _short(f"{noise}: {result.unexplained.split(';')[0]}.", f"{noise}.")
    if not result.of_torque and result.stretch is not None:
        return _of_the_stretch(result)
    factor, unit = torque_scale(rms)
    before, after, floor = (factor * (each or 0.0) for each in (best, rms.extended, rms.noise_floor))
    gained = (
        f"the error on held-out data falls from {before:.3g} to {after:.3g} {unit} RMS, noise is {floor:.3g} {unit}"
    )
    left = "; more is left" if result.verdict is Verdict.PARTLY_EXPLAINED else ""
    return _with_causes(result, f"{gained}{left}")


def four_lines(result: Diagnosis) -> dict[str, str]:
    """Return the error, the causes with their intervals, the remaining error, and the next step, one line each."""
    if result.verdict is Verdict.INSUFFICIENT:
        return {"Error": "not known", "Cause": "not known", "Rest": "not known", "Next": result.experiment.text}
    errors = result.errors
    given = told_torque(result.rms.simulated)
    now = ", ".join(
        f"{told_torque(value)} {where}"
        for where, value in (("while sliding", errors.sliding), ("in reversals", errors.reversals))
        if value is not None
    )
    written = "with extended.toml" if result.causes else "recalibrated"
    causes = "; ".join(_with_intervals(cause) for cause in result.causes)
    return {
        "Error": f"{given} RMS as given; {written} {now}; the sensor noise is {told_torque(errors.sensor_noise)}",
        "Cause": causes or ("none" if result.verdict is Verdict.CONSISTENT else "none in the catalogue"),
        "Rest": _rest(result),
        "Next": _next(result),
    }


def _with_intervals(cause: Cause) -> str:
    """Return the name, the alternatives, and each parameter with its 95 % interval."""
    return ", ".join([_named(cause), *_numbers(cause)])


def _rest(result: Diagnosis) -> str:
    if not result.unexplained:
        return "noise"
    sliding, noise = result.errors.sliding, result.errors.sensor_noise
    first = result.unexplained.split(";")[0].removeprefix("the residual ")
    if sliding is not None and noise is not None and sliding < MORE_THAN_NOISE * noise:
        if sliding <= NO_MORE * noise:
            return "in reversals alone; while sliding it is noise"
        return f"mostly in reversals; while sliding it is {sliding / noise:.2g} times the sensor noise and {first}"
    return f"more than noise: it {first}"


def _next(result: Diagnosis) -> str:
    if any(cause.alternatives for cause in result.causes):
        return result.experiment.text
    if result.causes:
        return f"use extended.toml in place of the model file; then {result.experiment.text}"
    return result.experiment.text


def noise_of(result: Diagnosis) -> str:
    """The noise of the sensor, as text, table and picture have it."""
    return told_torque(result.rms.noise_floor)


def _of_the_stretch(result: Diagnosis) -> str:
    """The first line where the torque shows nothing that has a name."""
    assert result.stretch is not None
    without, extended = (f"{1e6 * each:.3g}" for each in (result.stretch.without, result.stretch.extended))
    left = "; the torque has more" if result.verdict is Verdict.PARTLY_EXPLAINED else ""
    return _with_causes(
        result, f"the residual of the tendon elongation falls from {without} to {extended} µm RMS{left}"
    )


def _with_causes(result: Diagnosis, gained: str) -> str:
    """The causes and what they gained, as full as MOST_WORDS leave room for."""
    fullness = [listed([phrase(cause) for cause in result.causes]) for phrase in (cause_phrase, _named, _counted)]
    first, more = result.causes[0], len(result.causes) - 1
    fullness += [f"{phrase(first)}{f' with {more} more' if more else ''}" for phrase in (_named, _counted)]
    return _short(*(f"{causes[0].upper()}{causes[1:]}: {gained}." for causes in fullness))


def of_the_written_model(errors: ThreeErrors) -> str:
    """Return the three errors of a model that was calibrated or extended, as one sentence."""
    return (
        f"With the written model, on all samples: error while sliding {told_torque(errors.sliding)}, in reversals "
        f"{told_torque(errors.reversals)}, sensor noise {told_torque(errors.sensor_noise)}."
    )


def remarks(result: Diagnosis) -> tuple[str, ...]:
    """What follows the first line: what would have been seen, what is left, which names are excluded."""
    out = []
    if recalibration_is_worse(result.rms):
        kept = "" if result.causes else ": the file's parameters are kept"
        figures = f"{told_torque(result.rms.recalibrated)} RMS instead of {told_torque(result.rms.as_given)}"
        out.append(f"Recalibration alone makes it worse on held-out data, {figures}{kept}.")
    if result.errors.sensor_noise is not None:
        out.append(of_the_written_model(result.errors))
    if result.verdict is Verdict.CONSISTENT and result.detection_limit:
        out.append(_visible(result))
    if result.of_torque:
        out.append(
            f"The causes gain {result.gain:.0%} of the explainable error above the sensor noise while the joint "
            f"slides, {result.gain_all:.0%} with reversals; extended.toml has them."
        )
    if result.unexplained:
        out.append(f"{result.unexplained[0].upper()}{result.unexplained[1:]}.")
    for name, (value, low, high, unit) in result.at_bounds.items():
        unit = "" if unit == "1" else f" {unit}"
        out.append(
            f"The {spoken(name)} of the model that is written, {value:.4g}{unit}, is at its bound: the file's "
            f"[uncertainty] allows {low:.4g} to {high:.4g}{unit}; it is not a measurement."
        )
    if result.formula:
        found = result.formula
        out.append(
            f"The residual follows the formula {found.expression}, which explains {found.gain:.0%} of it on held-out "
            f"data ({found.better} of {found.logs} log{'s' if found.logs > 1 else ''} better)."
        )
        if found.ranges:
            told = (f"{name} {low:.3g} to {high:.3g}" for name, (low, high) in found.ranges.items())
            out.append(f"It was learned for {listed(list(told))}; formula.toml fades it out beyond that range.")
        if found.tells_when:
            out.append("The formula contains the time t of these logs: a controller cannot use it.")
    ruled_out = [spoken(name) for name in result.details.excluded[:EXCLUDED]] if result.details else []
    if ruled_out:
        out.append(f"Excluded: {listed(ruled_out)}.")
    return tuple(out)


def _short(*sentences: str) -> str:
    """The first of them that is short enough, else the last."""
    return next((each for each in sentences if len(each.split()) <= MOST_WORDS), sentences[-1])


def _visible(result: Diagnosis) -> str:
    """The smallest effects that would have been seen: the smallest of all, and that of the effect that hides best."""
    limits = result.detection_limit
    least, most = min(limits, key=lambda name: limits[name]), max(limits, key=lambda name: limits[name])
    if limits[most] < ALIKE * limits[least]:
        return f"Any effect of {told_torque(limits[most])} or more would have been seen."
    return (
        f"An effect of {told_torque(limits[least])} ({spoken(least)}) to {told_torque(limits[most])} ({spoken(most)}) "
        "or more would have been seen."
    )


def cause_phrase(cause: Cause) -> str:
    """Name, alternatives and main parameter of a cause."""
    return ", ".join([_named(cause), *_numbers(cause)[:1]])


def _numbers(cause: Cause) -> list[str]:
    """Return each parameter that the logs identify, with its interval."""
    return [
        f"{spoken(key)} {quantity}"
        for key, quantity in cause.parameters.items()
        if isinstance(quantity, Quantity) and quantity.told and quantity.low < quantity.high
    ]


def _named(cause: Cause) -> str:
    """Return the name with its alternatives."""
    return listed([spoken(name) for name in (cause.effect, *cause.alternatives)], "or")


def _counted(cause: Cause) -> str:
    """Return the name with the number of its alternatives."""
    count = len(cause.alternatives)
    return spoken(cause.effect) + (f" (or {count} other{'s' if count > 1 else ''})" if count else "")


def insufficient_sentence(reason: str) -> str:
    """The first sentences of a report that cannot say anything else; a long reason goes on in the next."""
    text = f"These logs cannot determine: {reason.rstrip('.?')}{'?' if reason.endswith('?') else '.'}"
    first, _, rest = text.partition("; ")
    return f"{first}. {rest[0].upper()}{rest[1:]}" if rest and len(text.split()) > MOST_WORDS else text


def summary_of(name: str) -> str:
    """What an effect is, from the catalogue; `parameter_error` is not one of its effects."""
    return (
        CATALOGUE[name].summary
        if name in CATALOGUE
        else "the file's friction angle or pretension is further off than its [uncertainty]"
    )


def what_is_left(left: Sequence[Finding], suspicions: Sequence[str]) -> str:
    """The largest findings first; `suspicions` of the data, for what nothing else explains."""
    if not left:
        return ""
    first, *others = left[:3]
    share = f"({first.share:.0%} of its mean square)"
    told = [
        f"the residual depends on {first.what} {share}" if _drives(first) else f"the residual is {first.what} {share}"
    ]
    depends = [finding.what for finding in others if _drives(finding)]
    are = [finding.what for finding in others if not _drives(finding)]
    told += [f"it also depends on {listed(depends)}"] if depends else []
    told += (
        [f"in addition there {'are' if len(are) > 1 or are[0].startswith('bursts') else 'is'} {listed(are)}"]
        if are
        else []
    )
    return "; ".join([*told, *suspicions])


def _drives(finding: Finding) -> bool:
    """Whether a finding names a signal on which the rest depends; else it names the rest itself."""
    return not finding.what.startswith(("a ", "bursts"))


def captions(result: Diagnosis) -> dict[str, str]:
    """Return the caption of each picture by its name, in the order of the report; none for insufficient logs."""
    if result.details is None:
        return {}
    return {
        "load.png": f"Error against load, by direction of motion: {_fallen(result)}",
        "worst.png": "Measured and simulated torque in the segments with the largest error",
        "staircase.png": _fall(result),
        "ranking.png": _ranked(result),
        "residual.png": "Residual against velocity, angle, time and temperature",
        "reversals.png": "Residual after friction reversals, against time and displacement",
        "autocorrelation.png": "Autocorrelation of the whitened residual",
        "occupancy.png": "Operating range of the logs: share of the samples by velocity and torque",
    }


def _fallen(result: Diagnosis) -> str:
    """Return the errors of the nominal and of the written model while sliding."""
    name = "extended" if result.causes else "recalibrated"
    return f"{told_torque(result.rms.as_given)} nominal, {told_torque(result.errors.sliding)} {name} while sliding"


def _fall(result: Diagnosis) -> str:
    """Return the caption of the errors on held-out data."""
    rms = result.rms
    last = rms.recalibrated if not result.of_torque else rms.extended
    if result.formula is not None:
        last = result.formula.rms[1]
    noise = "" if rms.noise_floor is None else f"; the sensor noise is {told_torque(rms.noise_floor)}"
    return f"Error on held-out data: {told_torque(rms.as_given)} nominal, {told_torque(last)} at the end{noise}"


def _ranked(result: Diagnosis) -> str:
    """Return the caption of the ranking."""
    if result.of_torque:
        return "Share of the gain that each cause explains, and each competing hypothesis instead of it"
    return "Share that each effect of the catalogue would explain alone"
