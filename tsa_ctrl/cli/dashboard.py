"""`tsa dashboard`."""

from __future__ import annotations

import importlib.util

import click

from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc import protocol

NEEDED = ("starlette", "uvicorn")


@click.command("dashboard", epilog="Example: tsa dashboard --port 8402")
@click.option("--socket", "path", default=protocol.default_path, show_default="this user's", help="The daemon's.")
@click.option("--port", default=0, type=click.IntRange(0, 65535), show_default="a free one", help="Of 127.0.0.1.")
def command(path: str, port: int) -> None:
    """A local page to watch and tune a running daemon: torques and lateness live, state, faults, live parameters.

    Prints the address to open, with its token, and serves until Ctrl-C. Bound to the loopback address; it talks to the
    daemon over the local socket as `tsa status` and `tsa set` do. A change asks for a confirmation and can be undone.
    """
    missing = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        raise UsageError(f"{', '.join(missing)} not installed; pip install '.[dashboard]'")
    from tsa_ctrl.dashboard.server import serve

    serve(path, port, lambda address: click.echo(f"dashboard: {address}"))
