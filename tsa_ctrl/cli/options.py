"""Options that several commands share, a number type that rejects nan and infinity, and a progress bar."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from typing import Any

import click

from tsa_ctrl.outputs import terminal


class Finite(click.FloatRange):
    """A click.FloatRange that rejects nan and inf."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        try:
            float(value)
        except ValueError:
            self.fail(f"'{value}' is not a number; write it as 0.5 or 1e-3", param, ctx)
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{number} is not a finite number", param, ctx)
        return number

    def _describe_range(self) -> str:
        """Omit the range from the help without a bound, because click would print `x<=None`."""
        return "" if self.min is None and self.max is None else super()._describe_range()


CUTOFF = click.option(
    "--cutoff",
    type=Finite(0.01, 25e3),  # up to half of the highest rate of a log
    metavar="HZ",
    help="Low-pass for derived velocities and accelerations (default: as high as the noise permits).",
)


STRICT = click.option(
    "--strict",
    is_flag=True,
    help="Reject late rows, lost samples, duplicate time stamps, gaps and spikes instead of repairing them.",
)


@contextlib.contextmanager
def progress_bar(step: str) -> Iterator[Callable[[str, float], None]]:
    """Show the current step and its share on stderr if it is a terminal; yield the function that updates both."""
    from rich import progress as bars

    console = terminal(stderr=True)
    columns = (bars.TextColumn("{task.description}", markup=False), bars.BarColumn(), bars.TimeElapsedColumn())
    with bars.Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(step, total=1.0)
        yield lambda what, share: progress.update(task, description=what, completed=share)
