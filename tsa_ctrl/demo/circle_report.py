"""A full circle for the terminal: what was hidden and found, and the error of each stage."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Table

from tsa_ctrl.demo.circle import STAGES, Circle

WORDS = {
    "none": "without compensation",
    "nominal": "nominal model",
    "calibrated": "calibrated on the nominal run",
    "extended": "extended by the diagnosis of that run",
    "true": "true parameters: the limit",
}


def show(circle: Circle, folder: Path) -> None:
    """Print table and names; `folder` is where everything was left."""
    console = Console()
    table = Table("run", "RMS error (mN·m)", title=f"full circle on {circle.bus}", title_justify="left")
    for stage in STAGES:
        table.add_row(WORDS[stage], f"{1e3 * circle.rms(stage):.1f}")
    console.print(table)
    for line in (
        f"hidden: {circle.hidden.name}",
        f"found: {circle.found} ({circle.diagnosis.verdict.value})",
        circle.diagnosis.sentence,
        *(f"note: {note}" for note in circle.notes),
        f"everything: {folder}",
    ):
        console.print(line, soft_wrap=True, markup=False, highlight=False)
    console.print(f"share of the reachable reduction: {100.0 * circle.share('none'):.1f} %", highlight=False)
