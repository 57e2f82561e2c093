"""Pictures drawn by processes of their own, which load what draws while the logs are still being searched for causes.

matplotlib takes about as long to load and to draw as a tenth of the search; on a second core it costs nobody's time.
"""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator
from concurrent.futures import Executor
from functools import partial
from pathlib import Path

from tsa_ctrl.identify.diagnosis.report.page import Plot, drawn_here
from tsa_ctrl.identify.diagnosis.report.result import Diagnosis
from tsa_ctrl.identify.diagnosis.report.words import captions
from tsa_ctrl.identify.fleet.executors import local

PICTURES = "tsa_ctrl.identify.diagnosis.report.pictures"
PROCESSES = 2  # beside the search, which is done when they draw: seven pictures of which three take most of the time


@contextlib.contextmanager
def drawing() -> Iterator[Plot]:
    """Pictures as `pictures.plot` draws them, by other processes; by this one where it may use one core only."""
    if len(os.sched_getaffinity(0)) < 2:
        yield drawn_here
        return
    with local(PROCESSES, PICTURES) as workers:
        # A first job starts what loads the pictures' code, and is taken only once that is loaded: a thread waits for it
        threading.Thread(target=_begin, args=(workers.executor,), daemon=True).start()
        yield partial(_plot_by, workers.executor)


def _begin(executor: Executor) -> None:
    with contextlib.suppress(RuntimeError, OSError):  # the pictures will meet it again, and are drawn here then
        executor.submit(os.getpid)


def _plot_by(executor: Executor, result: Diagnosis, folder: Path) -> dict[str, Path]:
    try:
        made = {caption: executor.submit(_draw, result, name, folder) for name, caption in captions(result).items()}
        return {caption: path.result() for caption, path in made.items()}
    except (RuntimeError, OSError):  # they are gone, for want of memory maybe: it only takes longer
        return drawn_here(result, folder)


def _draw(result: Diagnosis, name: str, folder: Path) -> Path:
    from tsa_ctrl.identify.diagnosis.report.pictures import draw

    return draw(result, name, folder)
