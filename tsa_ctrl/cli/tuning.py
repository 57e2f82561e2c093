"""Display while `tsa tune` moves a rig: phase, progress, torque, angle, and a note that Ctrl-C is safe."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator
from types import FrameType

import click
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.ipc.client import AxisMeasured, Client
from tsa_ctrl.outputs import terminal

PATIENCE = 0.05  # s for an answer, because requests are sent between two polls of the run


@contextlib.contextmanager
def shown(axis: str, socket: str | None) -> Iterator[tuple[Callable[[str, float], None], Callable[[str], None]]]:
    """Show a progress line on stderr if it is a terminal.

    Yield a function that shows phase and completed share, and one that prints a line and waits for Enter. `socket` is
    the socket of the daemon of each run, or None in virtual time.
    """
    console = terminal(stderr=True)
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(20),
        TimeElapsedColumn(),
        TextColumn("{task.fields[live]}", markup=False),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("tune", total=1.0, live="")
        live = None if socket is None or not console.is_terminal else Live(axis, socket)

        def say(what: str, share: float) -> None:
            words = "" if live is None else live.words()
            progress.update(task, description=what, completed=share, live=f"{words}Ctrl-C stops safely")

        def ask(what: str) -> None:
            progress.stop()
            click.prompt(f"{what}; then press Enter", default="", show_default=False, prompt_suffix=" ", err=True)
            progress.start()

        try:
            yield say, ask
        finally:
            if live is not None:
                live.close()


class Live:
    """Torque and angle of one axis, read from the daemon that currently answers on a socket."""

    def __init__(self, axis: str, path: str) -> None:
        self._axis = axis
        self._path = path
        self._client: Client | None = None

    def words(self) -> str:
        """Return the measurement, for example "0.31 N*m, 0.12 rad; ", or an empty text without an answer."""
        try:
            if self._client is None:
                self._client = Client(self._path, timeout=PATIENCE)
            return told(self._client.measure()[self._axis])
        except (BusError, UsageError, KeyError, OSError):
            self.close()
            return ""

    def close(self) -> None:
        """Close the connection, because the daemon ends with each run."""
        if self._client is not None:
            self._client.close()
            self._client = None


def told(axis: AxisMeasured) -> str:
    """Return the torque at the joint (at the motor without a sensor) and the joint angle as text."""
    torque, where = (axis.tau_m, "motor") if axis.tau_j is None else (axis.tau_j, "joint")
    shown = "no torque yet" if torque is None else f"{torque:+.2f} N*m at the {where}"
    return f"{shown}, {axis.q_j:+.2f} rad; "


@contextlib.contextmanager
def interrupted_once() -> Iterator[None]:
    """Raise KeyboardInterrupt at the first SIGINT or SIGTERM, and ignore later ones."""

    def handle(number: int, frame: FrameType | None) -> None:
        for each in (signal.SIGINT, signal.SIGTERM):
            signal.signal(each, signal.SIG_IGN)
        raise KeyboardInterrupt

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
