"""One self-contained page about a tuning: numbers, pictures, and the diff of the model file."""

from __future__ import annotations

import base64
import datetime
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

from jinja2 import Environment, StrictUndefined

from tsa_ctrl.identify.quantity import Quantity, spelled
from tsa_ctrl.tune.procedure import Outcome
from tsa_ctrl.version import __version__

TEMPLATE = "page.html.j2"


def write_page(
    outcome: Outcome, axis: str, path: Path, difference: str, pictures: Sequence[tuple[str, Path]], page: Path
) -> None:
    """Write `page`; `path` is the model file, `pictures` are (title, PNG file)."""
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    template = environment.from_string(files("tsa_ctrl.tune").joinpath(TEMPLATE).read_text(encoding="utf-8"))
    encoded = [(title, base64.b64encode(file.read_bytes()).decode("ascii")) for title, file in pictures]
    text = template.render(
        axis=axis,
        headline=headline(outcome),
        parameters=parameter_rows(outcome),
        runs=run_rows(outcome),
        notes=[*(outcome.design.reasons if outcome.design else ()), *outcome.estimate.notes],
        pictures=encoded,
        file=path.name if outcome.law is None else f"{path.name} and the controller's file",
        diff=difference or "nothing",
        logs=", ".join(log.name for log in outcome.logs),
        version=__version__,
        date=datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"),
    )
    page.write_text(text, encoding="utf-8")


def headline(outcome: Outcome) -> str:
    """One sentence that a person can act on."""
    verified, result = outcome.verification, outcome.estimate.calibration
    if verified is None:
        return (
            f"On held-out data the prediction error is {1e3 * result.rms_before:.0f} mN·m with the given file and "
            f"{1e3 * result.rms_after:.0f} mN·m with the new one"
        )
    return (
        f"Compensation reduces the joint torque error by {verified.reduction(verified.before):.1f} % with the given "
        f"file and by {verified.reduction(verified.after):.1f} % with the new one"
    )


def parameter_rows(outcome: Outcome) -> list[tuple[str, str, str, str, str]]:
    """Quantity, given, new, interval and unit."""
    nominal, result = outcome.nominal, outcome.estimate.calibration
    rows: list[tuple[str, float | None, Quantity]] = [
        ("friction angle", nominal.friction_angle, result.friction_angle),
        ("pretension", nominal.pretension, result.pretension),
        ("half loop torque", None, result.half_loop_torque),
        ("slope", None, result.slope),
        *((name.replace("_", " "), None, found) for name, found in outcome.estimate.parameters.items()),
    ]
    if outcome.law is not None:
        rows += [(name.replace("_", " "), None, found) for name, found in outcome.law.quantities.items()]
    return [
        (
            name,
            "" if given is None else f"{given:.4g}",
            f"{found.value:.4g}",
            f"{found.low:.4g} to {found.high:.4g}",
            "" if found.unit == "1" else spelled(found.unit),
        )
        for name, given, found in rows
    ]


def run_rows(outcome: Outcome) -> list[tuple[str, str, str]]:
    """Compensation, RMS error and reduction of each verification run."""
    verified = outcome.verification
    if verified is None:
        return []
    named = (("none", verified.without), ("given file", verified.before), ("new file", verified.after))
    return [(name, f"{1e3 * run.rms:.1f}", f"{verified.reduction(run):.1f} %") for name, run in named]
