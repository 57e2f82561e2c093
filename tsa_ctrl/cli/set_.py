"""`tsa set`."""

from __future__ import annotations

import click

from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc import protocol
from tsa_ctrl.ipc.client import Client


@click.command(
    "set",
    context_settings={"ignore_unknown_options": True},  # a negative VALUE is no option
    epilog="Example: tsa set knee.compensation 0.9",
)
@click.argument("name")
@click.argument("value", type=float)
@click.option("--socket", "path", default=protocol.default_path, show_default="that of the user", help="Its socket.")
def command(name: str, value: float, path: str) -> None:
    """Change a parameter of a running daemon within its bounds; it moves there smoothly.

    NAME is a parameter as `tsa status` lists them, with its axis before a dot where there are several axes: KNEE.slew.
    "recover 1" asks for a new start after a latched fault.
    """
    with Client(path) as client:
        if name == "recover":
            if value != 1.0:
                raise UsageError(f"recover {value:g}: only 1 is possible, it asks for a new start after a fault")
            client.ask(protocol.Recover())
            click.echo("recovery asked for")
            return
        answer = client.ask(protocol.Set(name, value))
    click.echo(f"{answer['axis']}.{answer['name']}: {answer['before']:g} -> {answer['value']:g} {answer['unit']}")
