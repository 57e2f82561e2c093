"""`tsa status`."""

from __future__ import annotations

import json
import sys
import time

import click

from tsa_ctrl.ipc import protocol
from tsa_ctrl.ipc.client import Client

PERIOD = 0.1  # s between two statuses of --follow, as often as the daemon writes one


@click.command(
    "status",
    epilog="Example: tsa status --json",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@click.option("--once", is_flag=True, help="Print the page once, even on a terminal.")
@click.option("--follow", is_flag=True, help="Print a status every 0.1 s until Ctrl-C; with --json an object per line.")
@click.option("--socket", "path", default=protocol.default_path, show_default="this user's", help="Its socket.")
def command(as_json: bool, once: bool, follow: bool, path: str) -> None:
    """Show the state of a running daemon: a live page on a terminal, else once."""
    from rich.console import Console

    from tsa_ctrl.ipc.page import Page, watch  # rich's layouts are not needed for --json

    with Client(path) as client:
        if as_json:
            click.echo(json.dumps(client.ask(protocol.Status())))
            while follow:
                time.sleep(PERIOD)
                click.echo(json.dumps(client.ask(protocol.Status())))
        elif once or not (sys.stdout.isatty() and sys.stdin.isatty()):
            page, console = Page(), Console()
            page.take(client.ask(protocol.Status()))
            console.print(page.render())
            while follow:
                time.sleep(PERIOD)
                page.take(client.ask(protocol.Status()))
                console.print(page.render())
        else:
            watch(client)
