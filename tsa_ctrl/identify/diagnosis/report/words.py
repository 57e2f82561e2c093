"""Write the sentences of the report: the first line, the remarks that follow, and their parts."""

from __future__ import annotations

from collections.abc import Sequence

from tsa_ctrl.identify.diagnosis.report.result import Cause, Diagnosis, Rms, Verdict
from tsa_ctrl.identify.diagnosis.residual.dependence import Finding
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.identify.three_errors import MORE_THAN_NOISE, ThreeErrors
from tsa_ctrl.model.catalogue import CATALOGUE, PARAMETER_ERROR, SENSOR_ERROR

MOST_WORDS = 35  # largest number of words in the first sentence: a longer one needs a second reading
# Ratio of the largest to the smallest detection limit: below it, a single number describes both
ALIKE = 1.5
EXCLUDED = 3  # largest number of excluded effects in the remarks; the report lists all of them
MOSTLY = 0.5  # share of the mean square of the residual: the first sentence mentions a formula that explains more
NO_MORE = 1.1  # ratio to the sensor noise up to which an error counts as noise: the accuracy of the noise estimate
SMALL = 0.1  # N*m, RMS below which torques are printed in mN*m


def spoken(name: str) -> str:
    """Return the name of an effect as words.

    `parameter_error` becomes "wrong parameters alone", because the parameters may also be wrong in addition to an
    effect.
    """
    return "wrong parameters alone" if name == PARAMETER_ERROR else name.replace("_", " ")


def listed(names: Sequence[str], last: str = "and") -> str:
    """Return the names as a list in a sentence, such as "a, b and c"."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"


def told_torque(value: float | None) -> str:
    """Return a torque, N*m, as text with three digits: in mN*m below SMALL, in N*m otherwise, or "unknown" for None.

    All texts, tables and pictures use this function, so that they show the same digits.
    """
    if value is None:
        return "unknown"
    return f"{value * 1e3:.3g} mN·m" if abs(value) < SMALL else f"{value:.3g} N·m"


def torque_scale(rms: Rms) -> tuple[float, str]:
    """Return the factor and the unit for errors in the pictures of a diagnosis."""
    return (1e3, "mN·m") if (rms.recalibrated or 0.0) < SMALL else (1.0, "N·m")


def recalibration_is_worse(rms: Rms) -> bool:
    """Return True if the nominal model has a smaller error than the recalibrated model on held-out data."""
    return rms.as_given is not None and rms.recalibrated is not None and rms.recalibrated > rms.as_given


def sentence(result: Diagnosis) -> str:
    """Return the first line of the report: the error, its size, the causes and the improvement.

    The line contains as many details as fit into MOST_WORDS.
    """
    rms = result.rms
    best = rms.as_given if recalibration_is_worse(rms) else rms.recalibrated
    how = "with the parameters of the model file" if recalibration_is_worse(rms) else "recalibrated"
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
    return _with_causes(result, f"{_change(result)}, the sensor noise is {noise_of(result)}")


def _change(result: Diagnosis) -> str:
    """Return the change of the error on held-out data by the causes, from the samples that the gain counts.

    If the causes do not reduce the error while sliding, all samples count: a delay acts only in reversals.
    """
    rms = result.rms
    best = rms.as_given if recalibration_is_worse(rms) else rms.recalibrated
    pairs = [("the error while sliding", *(rms.sliding or (0.0, 0.0))), ("the error", best or 0.0, rms.extended or 0.0)]
    factor, unit = torque_scale(rms)
    for what, before, after in pairs:
        if after < before:
            return f"{what} falls from {factor * before:.3g} to {factor * after:.3g} {unit} RMS on held-out data"
    what, before, after = pairs[-1]
    return f"{what} does not fall on held-out data, {factor * before:.3g} and {factor * after:.3g} {unit} RMS"


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
        "Error": f"{given} RMS with the model file; {written} {now}; the sensor noise is "
        f"{told_torque(errors.sensor_noise)}",
        "Cause": causes or ("none" if result.verdict is Verdict.CONSISTENT else "none in the catalogue"),
        "Rest": _rest(result),
        "Next": _next(result),
    }


def _with_intervals(cause: Cause) -> str:
    """Return the name, the alternatives, and each parameter with its 95 % interval."""
    return ", ".join([_named(cause), *_numbers(cause)])


def _rest(result: Diagnosis) -> str:
    if not result.unexplained:
        held = listed([f"the {spoken(name)}" for name in result.at_bounds])
        return f"noise, but {held} reached the limit of [uncertainty] and may hide an error" if held else "noise"
    sliding, noise = result.errors.sliding, result.errors.sensor_noise
    first = result.unexplained.split(";")[0].removeprefix("the residual ")
    if sliding is not None and noise is not None and sliding < MORE_THAN_NOISE * noise:
        if sliding <= NO_MORE * noise:
            return "in reversals alone; while sliding it is noise"
        return f"mostly in reversals; while sliding it is {sliding / noise:.2g} times the sensor noise and {first}"
    return f"more than noise: it {first}"


def improves(result: Diagnosis) -> bool:
    """Return True if the causes reduce the error on held-out data, or explain the tendon elongation alone."""
    return max(result.gain, result.gain_all) > 0.0 or not result.of_torque


def _next(result: Diagnosis) -> str:
    if any(cause.alternatives for cause in result.causes):
        return result.experiment.text
    if result.causes and improves(result):
        return f"use extended.toml in place of the model file; then {result.experiment.text}"
    return result.experiment.text


def _gained(result: Diagnosis) -> str:
    """Return the gain of the causes; a gain below 0 is stated as such and not as a share."""
    places = (("while the joint slides", result.gain), ("with reversals", result.gain_all))
    removed = [f"{gain:.0%} {where}" for where, gain in places if gain > 0.0]
    none = [where for where, gain in places if gain <= 0.0]
    if not removed:
        return "The causes do not reduce the error on held-out data."
    less = f" They do not reduce the error {none[0]}." if none else ""
    return (
        f"Of the mean square error above the sensor noise on held-out data, the causes in extended.toml remove "
        f"{listed(removed)}.{less}"
    )


def noise_of(result: Diagnosis) -> str:
    """Return the sensor noise as text, with the same digits as in tables and pictures."""
    return told_torque(result.rms.noise_floor)


def _of_the_stretch(result: Diagnosis) -> str:
    """Return the first line if only the tendon elongation shows the causes."""
    assert result.stretch is not None
    without, extended = (f"{1e6 * each:.3g}" for each in (result.stretch.without, result.stretch.extended))
    return _with_causes(result, f"the residual of the tendon elongation falls from {without} to {extended} µm RMS")


def _with_causes(result: Diagnosis, gained: str) -> str:
    """Return the causes and the improvement `gained`, with as many details as fit into MOST_WORDS."""
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
    """Return the sentences that follow the first line.

    Where applicable, they state the errors, the detection limits, the gain, the residual, parameters at a bound, the
    formula and the excluded effects.
    """
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
        out.append(_gained(result))
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
    """Return the first sentence of at most MOST_WORDS words, or the last one if all are longer."""
    return next((each for each in sentences if len(each.split()) <= MOST_WORDS), sentences[-1])


def _visible(result: Diagnosis) -> str:
    """Return a sentence with the smallest and the largest detection limit.

    If both are nearly equal, the sentence states only the largest one.
    """
    limits = result.detection_limit
    least, most = min(limits, key=lambda name: limits[name]), max(limits, key=lambda name: limits[name])
    if limits[most] < ALIKE * limits[least]:
        return f"Any effect of {told_torque(limits[most])} or more would have been seen."
    return (
        f"An effect of {told_torque(limits[least])} ({spoken(least)}) to {told_torque(limits[most])} ({spoken(most)}) "
        "or more would have been seen."
    )


def cause_phrase(cause: Cause) -> str:
    """Return the name, the alternatives and the main parameter of a cause."""
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
    """Return the first line for insufficient logs; a long reason is split into two sentences."""
    text = f"These logs cannot determine: {reason.rstrip('.?')}{'?' if reason.endswith('?') else '.'}"
    first, _, rest = text.partition("; ")
    return f"{first}. {rest[0].upper()}{rest[1:]}" if rest and len(text.split()) > MOST_WORDS else text


def summary_of(name: str) -> str:
    """Return the summary of an effect of the catalogue or of another hypothesis."""
    others = {
        PARAMETER_ERROR: "the file's friction angle or pretension is further off than its [uncertainty]",
        SENSOR_ERROR: "the joint torque sensor is not linear, or it also measures the sum of the tendon forces",
    }
    return others[name] if name in others else CATALOGUE[name].summary


def what_is_left(left: Sequence[Finding], suspicions: Sequence[str]) -> str:
    """Return the description of the residual from the three largest findings; empty without a finding.

    Args:
        left: findings, largest first.
        suspicions: possible faults of the data, which are appended.
    """
    if not left:
        return ""
    first, *others = left[:3]
    share = f"({first.shown:.0%} of its mean square)"
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
    """Return True if a finding names a signal on which the residual depends.

    The other findings describe the residual itself, such as a step or bursts.
    """
    return not finding.what.startswith(("a ", "bursts"))


PICTURE_FILES = (
    "load.png",
    "worst.png",
    "staircase.png",
    "ranking.png",
    "residual.png",
    "reversals.png",
    "autocorrelation.png",
    "occupancy.png",
)


def captions(result: Diagnosis) -> dict[str, str]:
    """Return the caption of each picture by its name, in the order of the report; none for insufficient logs."""
    if result.details is None:
        return {}
    texts = (
        f"Error against load, by direction of motion: {_fallen(result)}",
        "Measured and simulated torque in the segments with the largest error",
        _fall(result),
        _ranked(result),
        "Residual against velocity, angle, time and temperature",
        "Residual after friction reversals, against time and displacement",
        "Autocorrelation of the whitened residual",
        "Operating range of the logs: share of the samples by velocity and torque",
    )
    return dict(zip(PICTURE_FILES, texts, strict=True))


def _fallen(result: Diagnosis) -> str:
    """Return the errors of the nominal and of the written model while sliding."""
    name = "extended" if result.causes else "recalibrated"
    before, after = (told_torque(errors.sliding) for errors in (result.nominal_errors, result.errors))
    return f"while sliding {before} nominal, {after} {name}"


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
