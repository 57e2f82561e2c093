"""`tsa data`: measured data published by others."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click


@click.group("data", epilog="Example: tsa data fetch davinci", context_settings={"help_option_names": ["-h", "--help"]})
def command() -> None:
    """Measured data that others published, from its public home."""


@command.command("list", epilog="Example: tsa data list")
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout and nothing else.")
def list_(as_json: bool) -> None:
    """List the sets, their licences, and the sets already here."""
    from tsa_ctrl.published.catalogue import SETS, folder

    place = folder()
    rows = {
        one.name: {"what": one.what, "licence": one.licence, "cite": one.cite, "here": (place / one.name).is_dir()}
        for one in SETS.values()
    }
    if as_json:
        click.echo(json.dumps({"schema": 1, "folder": str(place), "sets": rows}))
        return
    for name, row in rows.items():
        click.echo(f"{name:8s} {row['what']} ({row['licence']}){'; already fetched' if row['here'] else ''}")
    click.echo(f"tsa data fetch NAME writes to {place}")


@command.command("fetch", epilog="Example: tsa data fetch davinci --out measured")
@click.argument("name")
@click.option(
    "--out", type=click.Path(path_type=Path), help="Folder of the data sets; default: $TSA_DATA, or the user's cache."
)
@click.option("--from", "address", help="Alternative address of the same files.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout and nothing else.")
def fetch(name: str, out: Path | None, address: str | None, as_json: bool) -> None:
    """Fetch the set NAME, check it byte for byte, and convert its columns to SI."""
    from tsa_ctrl.published import catalogue
    from tsa_ctrl.published.fetch import fetch as fetched

    wanted = catalogue.find(name)
    place = out or catalogue.folder()

    def progress(number: int, of: int) -> None:
        if sys.stderr.isatty() and not as_json:
            click.echo(f"\r{wanted.name}: {number} of {of} logs\r", nl=number == of, err=True)

    done = fetched(wanted, place, address.rstrip("/") if address else None, progress)
    if as_json:
        result = {
            "schema": 1,
            "set": wanted.name,
            "folder": str(done.folder),
            "written": done.written,
            "kept": done.kept,
        }
        click.echo(json.dumps({**result, "licence": wanted.licence, "cite": wanted.cite, "source": wanted.address}))
        return
    click.echo(f"{done.folder}: {done.written} logs fetched, {done.kept} already present")
    click.echo(f"licence: {wanted.licence}")
    click.echo(f"cite: {wanted.cite}")
    first = done.folder / wanted.files[0].name
    click.echo(f"next: tsa diagnose {first} --model {done.folder / wanted.model} --out {wanted.name}-diagnosis")
