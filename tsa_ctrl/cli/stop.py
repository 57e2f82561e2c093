"""`tsa stop`."""

from __future__ import annotations

import time

import click

from tsa_ctrl.cli.finite import Finite
from tsa_ctrl.errors import BusError
from tsa_ctrl.ipc import pid_file, protocol
from tsa_ctrl.ipc.client import Client

POLL = 0.05  # s


@click.command(
    "stop",
    epilog="Example: tsa stop",
)
@click.option("--socket", "path", default=protocol.default_path, show_default="that of the user", help="Its socket.")
@click.option("--wait", default=15.0, show_default=True, type=Finite(0.0), help="Seconds for its end; 0: do not wait.")
def command(path: str, wait: float) -> None:
    """Ramp a running daemon's torque to zero, disable its drives, and end it; one that still starts gives that up.

    When nobody answers at its socket, its process gets SIGTERM, which does the same.
    """
    process = pid_file.running(path)
    stage = None
    try:
        with Client(path) as client:
            stage = client.ask(protocol.Stop()).get("waiting_for")
    except BusError as error:
        if pid_file.terminate(path) is None:
            raise
        click.echo(f"{error}\nstop: process {process} got SIGTERM instead", err=True)
    end = time.monotonic() + wait
    while wait > 0.0 and (protocol.is_socket(path) if process is None else pid_file.running(path) == process):
        if time.monotonic() > end:
            raise BusError(
                f"{path}: the daemon was told to stop and is still there after {wait:g} s; look at what it printed"
            )
        time.sleep(POLL)
    starting = f"; it was {stage}" if stage else ""
    click.echo(("stop asked for" if wait == 0.0 else "stopped: the daemon has ended") + starting)
