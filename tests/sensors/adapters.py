"""Simulate two serial CAN adapters ("slcan", the LAWICEL language) on one bus with pseudo-terminals.

A frame (t or T) that a program sends to one adapter arrives at the other one. Any other line is answered with a bell or
a carriage return, as real adapters do. Incomplete lines wait for their end, and invalid lines are answered with a bell
and discarded.
"""

from __future__ import annotations

import contextlib
import os
import select
import threading
import tty
from types import TracebackType

FRAMES = {ord("t"): 5, ord("T"): 10, ord("r"): 5, ord("R"): 10}  # shortest line by kind
LONGEST = 32  # bytes of a line


class Adapter:
    """One adapter. A program opens `path`."""

    def __init__(self) -> None:
        self.ours, self._theirs = os.openpty()
        tty.setraw(self.ours)
        tty.setraw(self._theirs)
        os.set_blocking(self.ours, False)
        self.path = os.ttyname(self._theirs)
        self.open = False
        self._rest = b""

    def read(self) -> list[bytes]:
        """Return the frames in the complete lines that the program has sent."""
        try:
            *lines, self._rest = (self._rest + os.read(self.ours, 65536)).split(b"\r")
        except BlockingIOError:
            return []
        self._rest = self._rest[-LONGEST:]
        return [line for line in lines if self._obey(line)]

    def write(self, line: bytes) -> None:
        if self.open:
            with contextlib.suppress(BlockingIOError):  # an adapter with a full buffer loses the frame
                os.write(self.ours, line + b"\r")

    def close(self) -> None:
        os.close(self.ours)
        os.close(self._theirs)

    def _obey(self, line: bytes) -> bool:
        """Return True if this is a frame for the bus."""
        if line in (b"O", b"L"):
            self.open = True
        elif line == b"C":
            self.open = False
        return bool(line) and len(line) >= FRAMES.get(line[0], LONGEST)


class AdapterPair:
    """Two adapters on one bus. A thread transfers the frames while the context is open."""

    def __enter__(self) -> tuple[str, str]:
        self._adapters = Adapter(), Adapter()
        self._end_read, self._end_write = os.pipe()
        self._thread = threading.Thread(target=self._carry, name="slcan")
        self._thread.start()
        return self._adapters[0].path, self._adapters[1].path

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._end_write)
        self._thread.join()
        os.close(self._end_read)
        for adapter in self._adapters:
            adapter.close()

    def _carry(self) -> None:
        one, two = self._adapters
        while True:
            ready, _, _ = select.select([one.ours, two.ours, self._end_read], [], [])
            if self._end_read in ready:
                return
            for source, target in ((one, two), (two, one)):
                if source.ours in ready:
                    for line in source.read():
                        target.write(line)
