"""`tsa stop`."""

from __future__ import annotations

import contextlib
import time

import click

from tsa_ctrl.cli.options import Finite
from tsa_ctrl.errors import BusError
from tsa_ctrl.ipc import pid_file, protocol
from tsa_ctrl.ipc.client import stop_daemon

POLL = 0.05  # s
PATIENCE = 0.5  # of the wait, after which the process gets SIGTERM as well


@click.command(
    "stop",
    epilog="Example: tsa stop",
)
@click.option("--socket", "path", default=protocol.default_path, show_default="this user's", help="Its socket.")
@click.option("--wait", default=15.0, show_default=True, type=Finite(0.0), help="Seconds for its end; 0: do not wait.")
def command(path: str, wait: float) -> None:
    """Ramp a running daemon's torque to zero, disable its drives, and end it; this also ends one that is starting.

    If the request fails for any reason, the daemon's process gets SIGTERM, which has the same effect.
    """
    process = pid_file.running(path)
    answer = stop_daemon(path)
    if "signalled" in answer:
        click.echo(f"{answer['reason']}\nstop: process {answer['signalled']} got SIGTERM instead", err=True)
    begun, signalled = time.monotonic(), "signalled" in answer
    while wait > 0.0 and (protocol.is_socket(path) if process is None else pid_file.running(path) == process):
        waited = time.monotonic() - begun
        if waited > wait:
            raise BusError(
                f"{path}: the daemon got the stop request and is still there after {wait:g} s; look at its output"
            )
        if not signalled and waited > PATIENCE * wait:
            signalled = True
            with contextlib.suppress(BusError):
                pid_file.terminate(path)
        time.sleep(POLL)
    stage = answer.get("waiting_for")
    starting = f"; it was {stage}" if stage else ""
    click.echo(("stop asked for" if wait == 0.0 else "stopped: the daemon has ended") + starting)
