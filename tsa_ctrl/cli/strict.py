"""The option of every verb that reads tables of others."""

from __future__ import annotations

import click

STRICT = click.option(
    "--strict", is_flag=True, help="Refuse late rows, lost samples, doubled stamps and holes instead of mending them."
)
