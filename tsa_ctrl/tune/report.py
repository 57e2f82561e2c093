"""A tuning for the terminal and as one JSON object."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tsa_ctrl.tune.page import headline, parameter_rows, run_rows
from tsa_ctrl.tune.procedure import Outcome


def show(outcome: Outcome, difference: str, page: Path | None) -> None:
    """Print the diff, and below it tables and notes: what a person reads before the question."""
    console = Console()
    console.print(difference or "the file would not change", markup=False, highlight=False, soft_wrap=True)
    table = Table("quantity", "given", "new", "95 % interval", "unit", title="estimated", title_justify="left")
    for row in parameter_rows(outcome):
        table.add_row(*row)
    console.print(table)
    if outcome.verification is not None:
        runs = Table("compensation", "RMS error (mN·m)", "reduction", title="on a motion not used for the fit")
        for cells in run_rows(outcome):
            runs.add_row(*cells)
        console.print(runs)
    for note in (*(outcome.design.reasons if outcome.design else ()), *outcome.estimate.notes):
        console.print(f"note: {note}", soft_wrap=True, markup=False, highlight=False)
    console.print(headline(outcome), soft_wrap=True, markup=False)
    if page is not None:
        console.print(f"page: {page}", soft_wrap=True, markup=False, highlight=False)


def to_dict(outcome: Outcome, axis: str, page: Path | None, written: Path | None) -> dict[str, Any]:
    """Return the tuning JSON-ready; null for unknown.

    `written`: where the model file before is kept, or the new file of a simulated plant; null when none was written.
    """
    found, verified = outcome.estimate, outcome.verification
    rms = reduction = None
    if verified is not None:
        rms = {
            "without": verified.without.rms,
            "before": verified.before.rms,
            "after": verified.after.rms,
            "unit": "N*m",
        }
        reduction = {
            "before": verified.reduction(verified.before),
            "after": verified.reduction(verified.after),
        }
    return {
        "schema": 1,
        "axis": axis,
        "form": found.form.name.lower(),
        "effects": list(found.effects),
        "parameters": {name: quantity.to_dict() for name, quantity in found.parameters.items()},
        "calibration": found.calibration.to_dict(),
        "law": None if outcome.law is None else outcome.law.to_dict(),
        "verification": {"rms": rms, "reduction_percent": reduction} if verified is not None else None,
        "design": list(outcome.design.reasons) if outcome.design is not None else None,
        "notes": list(found.notes),
        "page": None if page is None else str(page),
        "written": None if written is None else str(written),
    }
