"""`tsa bench`: find the highest rate."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tsa_ctrl.cli.options import Finite, progress_bar
from tsa_ctrl.outputs import json_types, terminal

if TYPE_CHECKING:
    from tsa_ctrl.bench.run import Found, Measured, Times


@click.command("bench", epilog="Example: tsa bench config/controller.toml")
@click.argument("controller", type=click.Path(path_type=Path))
@click.option("--seconds", default=5.0, show_default=True, type=Finite(0.1, 600.0), help="Duration at each rate, s.")
@click.option(
    "--margin", default=0.3, show_default=True, type=Finite(0.0, 0.9), help="Share of the period that must stay free."
)
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
def command(controller: Path, seconds: float, margin: float, as_json: bool) -> int:
    """Find the highest rate that this machine, this adapter and this CONTROLLER.toml carry with margin.

    The loop's own cycle runs at the configured rate: waking up, SYNC, answers, law, limiter, command, record. With
    drives on the bus they are brought up and answer, but are never enabled. On a virtual bus without nodes a process
    simulates them, and a run at the highest rate confirms it. Exit code 1: a drive did not confirm that it is off.
    """
    from tsa_ctrl.config import load_configuration

    configuration = load_configuration(controller)
    from tsa_ctrl.bench.run import bench  # imports the loop; not needed for a wrong file

    unconfirmed: list[str] = []
    try:
        with progress_bar("bench") as say:
            found = bench(configuration, seconds, margin, say, unconfirmed.append)
    finally:
        for line in unconfirmed:
            click.echo(line, err=True)
    if as_json:
        click.echo(json.dumps(_as_dict(found, configuration.load.bitrate), allow_nan=False))
    else:
        _show(found)
    return int(bool(unconfirmed))


def _show(found: Found) -> None:
    from rich.table import Table

    console = terminal()
    nodes = "a process simulates the nodes" if found.simulated else "the nodes answer with their drives disabled"
    console.print(f"{found.bus}: {nodes}; {found.rights}")
    for line in found.missing:
        console.print(f"missing: {line}", soft_wrap=True)
    table = Table("us", "p50", "p99", "p99.9", "worst")
    for measured in (found.configured, found.confirmed):
        if measured is None:
            continue
        table.add_section()
        table.add_row(f"{measured.rate:g} Hz, {measured.cycles} cycles, {measured.lost} lost, {measured.late} late")
        for name in ("lateness", "command", "busy"):
            table.add_row(f"  {NAMES[name]}", *_micros(getattr(measured, name)))
    console.print(table)
    limits = Table("bound", "Hz", "found")
    for bound in found.bounds:
        limits.add_row(bound.name, f"{bound.rate:.0f}", bound.found)
    console.print(limits)
    fits = "within that" if found.fits else "above that: lower [controller] rate"
    console.print(
        f"highest rate with {100 * found.margin:.0f} % margin: {found.highest:g} Hz, limited by: {found.limited_by}; "
        f"configured: {found.configured.rate:g} Hz, {fits}",
        soft_wrap=True,
    )


NAMES = {"lateness": "wake-up latency", "command": "SYNC to the last command", "busy": "deadline to end of cycle"}


def _micros(times: Times) -> list[str]:
    return ["-" if math.isnan(t) else f"{1e6 * t:.0f}" for t in (times.p50, times.p99, times.p999, times.worst)]


def _as_dict(found: Found, bitrate: int) -> dict[str, Any]:
    return {
        "schema": 1,
        "bus": found.bus,
        "bitrate": bitrate,
        "rights": found.rights,
        "missing_rights": list(found.missing),
        "nodes": "simulated" if found.simulated else "real",
        "margin": found.margin,
        "rate": {
            "configured": found.configured.rate,
            "highest": found.highest,
            "limited_by": found.limited_by,
            "fits": found.fits,
        },
        "bounds": json_types(found.bounds),
        "measured": [_measured(m) for m in (found.configured, found.confirmed) if m is not None],
    }


def _measured(measured: Measured) -> dict[str, Any]:
    counts = {key: getattr(measured, key) for key in ("rate", "cycles", "lost", "late", "enabled")}
    return {**counts, **{name: json_types(getattr(measured, name)) for name in NAMES}}
