"""Report a tuning as a self-contained page (numbers, pictures, diff), in the terminal and as one JSON object."""

from __future__ import annotations

import base64
import datetime
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined
from rich.table import Table

from tsa_ctrl.identify.diagnosis.report.words import of_the_written_model
from tsa_ctrl.identify.quantity import Quantity, spelled
from tsa_ctrl.outputs import json_types, terminal
from tsa_ctrl.tune.procedure import Outcome
from tsa_ctrl.version import __version__

TEMPLATE = "page.html.j2"


def write_page(
    outcome: Outcome, axis: str, path: Path, difference: str, pictures: Sequence[tuple[str, Path]], page: Path
) -> None:
    """Write the page of a tuning.

    Args:
        outcome: results.
        axis: name of the axis.
        path: model file.
        difference: diff of the written files.
        pictures: caption and PNG file of each picture.
        page: file to write.
    """
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    template = environment.from_string(files("tsa_ctrl.tune").joinpath(TEMPLATE).read_text(encoding="utf-8"))
    encoded = [(title, base64.b64encode(file.read_bytes()).decode("ascii")) for title, file in pictures]
    text = template.render(
        axis=axis,
        headline=headline(outcome),
        parameters=parameter_rows(outcome),
        runs=run_rows(outcome),
        notes=notes(outcome),
        pictures=encoded,
        file=path.name if outcome.law is None else f"{path.name} and the controller file",
        diff=difference or "none",
        logs=", ".join(log.name for log in outcome.logs),
        version=__version__,
        date=datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"),
    )
    page.write_text(text, encoding="utf-8")


def headline(outcome: Outcome) -> str:
    """Return one sentence with the errors of the given file and of the new file."""
    verified, result = outcome.verification, outcome.estimate.calibration
    if verified is None:
        return (
            f"On held-out data the error while sliding is {1e3 * result.sliding_before:.0f} mN·m with the given file, "
            f"{1e3 * result.sliding_after:.0f} mN·m with the new one"
        )
    if verified.before is None:
        return (
            f"Compensation reduces the joint torque error by {verified.reduction(verified.after):.1f} % with the new "
            f"file; with the given file a fault ended the run: {verified.fault}"
        )
    return (
        f"Compensation reduces the joint torque error by {verified.reduction(verified.before):.1f} % with the given "
        f"file and by {verified.reduction(verified.after):.1f} % with the new one"
    )


def parameter_rows(outcome: Outcome) -> list[tuple[str, str, str, str, str]]:
    """Return a row for each parameter: quantity, given value, new value, interval and unit."""
    nominal, result = outcome.nominal, outcome.estimate.calibration
    of_file = {
        "axial_stiffness": nominal.axial_stiffness,
        "radius_ratio": nominal.joint_pulley_radius / nominal.motor_pulley_radius,
        "centre of the bending": nominal.bending_centre,
    }
    rows: list[tuple[str, float | None, Quantity]] = [
        ("friction angle", nominal.friction_angle, result.friction_angle),
        ("pretension", nominal.pretension, result.pretension),
        ("friction torque", None, result.half_loop_torque),
        ("slope", None, result.slope),
        *((name.replace("_", " "), None, found) for name, found in result.routing.items()),
        *((name.replace("_", " "), of_file.get(name), found) for name, found in outcome.estimate.parameters.items()),
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
    """Return a row for each verification run: compensation, RMS error (mN*m) and reduction."""
    verified = outcome.verification
    if verified is None:
        return []
    named = (("none", verified.without), ("given file", verified.before), ("new file", verified.after))
    return [
        (name, "-", "ended by a fault")
        if run is None
        else (name, f"{1e3 * run.rms:.1f}", f"{verified.reduction(run):.1f} %")
        for name, run in named
    ]


def notes(outcome: Outcome) -> list[str]:
    """Return the reasons of the design, the notes of the estimate, and the three errors of the new model."""
    reasons = outcome.design.reasons if outcome.design else ()
    errors = outcome.errors
    stated = [] if errors.sensor_noise is None else [of_the_written_model(errors)]
    return [*reasons, *outcome.estimate.notes, *stated]


def show(outcome: Outcome, difference: str, page: Path | None) -> None:
    """Print the diff, then tables and notes, before the user accepts or rejects the result."""
    console = terminal()
    console.print(difference or "the file would not change", soft_wrap=True)
    table = Table("quantity", "given", "new", "95 % interval", "unit", title="estimated", title_justify="left")
    for row in parameter_rows(outcome):
        table.add_row(*row)
    console.print(table)
    if outcome.verification is not None:
        runs = Table("compensation", "RMS error (mN·m)", "reduction", title="on a motion not used for the fit")
        for cells in run_rows(outcome):
            runs.add_row(*cells)
        console.print(runs)
    for note in notes(outcome):
        console.print(f"note: {note}", soft_wrap=True)
    console.print(headline(outcome), soft_wrap=True)
    if page is not None:
        console.print(f"page: {page}", soft_wrap=True)


def to_dict(outcome: Outcome, axis: str, page: Path | None, written: Path | None) -> dict[str, Any]:
    """Return the tuning in JSON types, with null for unknown values.

    Args:
        outcome: results.
        axis: name of the axis.
        page: page of the tuning.
        written: backup of the old model file, or the new file of a simulated plant; None if no file was written.
    """
    found, verified = outcome.estimate, outcome.verification
    rms = reduction = None
    if verified is not None:
        rms = {
            "without": verified.without.rms,
            "before": None if verified.before is None else verified.before.rms,
            "after": verified.after.rms,
            "unit": "N*m",
        }
        reduction = {
            "before": None if verified.before is None else verified.reduction(verified.before),
            "after": verified.reduction(verified.after),
        }
    law = outcome.law
    data: dict[str, Any] = json_types(
        {
            "schema": 1,
            "axis": axis,
            "form": found.form.name.lower(),
            "effects": found.effects,
            "parameters": found.parameters,
            "calibration": found.calibration.to_dict(),
            "law": law and {"keys": law.values, "quantities": law.quantities, "gain_margin": law.margin},
            "errors": outcome.errors.to_dict(),
            "verification": {"rms": rms, "reduction_percent": reduction} if verified is not None else None,
            "design": outcome.design and outcome.design.reasons,
            "notes": found.notes,
            "page": page,
            "written": written,
        }
    )
    return data
