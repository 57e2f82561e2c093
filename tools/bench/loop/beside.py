"""A command of this folder as a process beside the one that measures."""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Iterator

from tools import command

END = 60.0  # s that it may take to write down what it saw


@contextlib.contextmanager
def beside(module: str, *arguments: str) -> Iterator[None]:
    """A process from its word on stdout that it is ready to its end, which follows that of its stdin."""
    process = subprocess.Popen(command.process(module, *arguments), stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    try:
        yield
    finally:
        process.communicate(timeout=END)
