"""Findings of one part of the fuzzing, and its memory and open descriptors."""

from __future__ import annotations

import os
import threading
import traceback
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

MOST = 20  # problems kept for each part
PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True)
class Holdings:
    """Resident memory (bytes) and open descriptors of a process."""

    memory: int
    descriptors: int

    @classmethod
    def of(cls, pid: int | str = "self") -> Holdings:
        resident = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
        return cls(resident * PAGE, len(list(Path(f"/proc/{pid}/fd").iterdir())))


@dataclass
class Part:
    """The result of one part of the fuzzing.

    `inputs` is the number of inputs. `counts` shows that the inputs had an effect.
    """

    name: str
    inputs: int = 0
    counts: Counter[str] = field(default_factory=Counter)
    problems: list[str] = field(default_factory=list)
    before: Holdings = Holdings(0, 0)
    after: Holdings = Holdings(0, 0)

    def blame(self, text: str) -> None:
        self.counts["problems"] += 1
        if len(self.problems) < MOST:
            self.problems.append(text)

    @contextmanager
    def surviving(self, what: str) -> Iterator[None]:
        """Record an exception in the block as a problem with its source line."""
        try:
            yield
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            self.blame(f"{what}: {type(error).__name__}: {error} ({Path(where.filename).name}:{where.lineno})")

    @contextmanager
    def quiet_threads(self) -> Iterator[None]:
        """Record an exception that ends a thread as a problem."""
        kept = threading.excepthook
        threading.excepthook = lambda hook: self.blame(f"thread: {hook.exc_type.__name__}: {hook.exc_value}")
        try:
            yield
        finally:
            threading.excepthook = kept
