"""Options that several verbs share, and numbers within bounds that are never nan or infinite."""

from __future__ import annotations

import math
from typing import Any

import click


class Finite(click.FloatRange):
    """As click.FloatRange, without nan and inf."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{number} is not a finite number", param, ctx)
        return number

    def _describe_range(self) -> str:
        """Leave the range out of the help if there is no bound: click would write `x<=None`."""
        return "" if self.min is None and self.max is None else super()._describe_range()


CUTOFF = click.option(
    "--cutoff",
    type=Finite(min=0.0, min_open=True),
    metavar="HZ",
    help="Low-pass for derived velocities and accelerations (default: as high as the noise permits).",
)


STRICT = click.option(
    "--strict",
    is_flag=True,
    help="Reject late rows, lost samples, duplicate time stamps and holes instead of repairing them.",
)
