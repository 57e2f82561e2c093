"""`tsa live`."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import click

from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc import protocol
from tsa_ctrl.ipc.client import MOST_RATE


@click.command("live", epilog="Example: tsa live --port 8765")
@click.option("--socket", "path", default=protocol.default_path, show_default="this user's", help="The daemon's.")
@click.option(
    "--port",
    default=8765,
    show_default=True,
    type=click.IntRange(0, 65535),
    help="Port of 127.0.0.1; 0 takes a free one.",
)
@click.option(
    "--rate", default=1000.0, show_default=True, type=click.FloatRange(1.0, MOST_RATE), help="Rate of the signals, Hz."
)
@click.option("--settable", is_flag=True, help="Let every client on this computer change live parameters as this user.")
@click.option("--layouts", "folder", type=click.Path(path_type=Path), help="Write layouts for both programs there.")
def command(path: str, port: int, rate: float, settable: bool, folder: Path | None) -> None:
    """Publish a running daemon on a WebSocket that Foxglove and PlotJuggler can read, until Ctrl-C.

    Foxglove: open a connection to ws://localhost:8765. PlotJuggler: start the Foxglove Bridge streaming plugin.
    Topics: /AXIS/signals (each cycle), /AXIS/status, /joint_states, /events. Bound to the loopback address.
    """
    if importlib.util.find_spec("foxglove") is None:
        raise UsageError("foxglove-sdk not installed; pip install '.[live]'")
    from tsa_ctrl.live.server import Publisher, write_layouts

    publisher = Publisher(path, port, settable)
    try:
        for written in [] if folder is None else write_layouts(folder, publisher.axes):
            click.echo(f"written: {written}")
        click.echo(f"live: ws://127.0.0.1:{publisher.port}")
        publisher.run(rate)
    except KeyboardInterrupt:
        pass
    finally:
        publisher.close()
