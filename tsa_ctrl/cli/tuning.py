"""Display while `tsa tune` moves a rig: phase, progress, and a note that Ctrl-C is safe."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator
from types import FrameType

import click
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from tsa_ctrl.outputs import terminal


@contextlib.contextmanager
def shown() -> Iterator[tuple[Callable[[str, float], None], Callable[[str], None]]]:
    """Show a progress line on stderr if it is a terminal.

    Yield a function that shows phase and completed share, and one that prints a line and waits for Enter.
    """
    console = terminal(stderr=True)
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(20),
        TimeElapsedColumn(),
        TextColumn("Ctrl-C stops safely"),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("tune", total=1.0)

        def say(what: str, share: float) -> None:
            progress.update(task, description=what, completed=share)

        def ask(what: str) -> None:
            progress.stop()
            click.prompt(f"{what}; then press Enter", default="", show_default=False, prompt_suffix=" ", err=True)
            progress.start()

        yield say, ask


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
