"""Inputs of a fuzz target: its seeds, a file of inputs that once covered a new line, and changed copies."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hypothesis import strategies as st

FOLDER = Path(__file__).parent / "corpus"
INTERESTING = (b"\0", b"\xff", b"\x7f", b"\x80", b"-1", b"nan", b"1e999", b"9" * 25, b"\r\n", b",", b'"', b"[" * 200)


@dataclass(frozen=True)
class Target:
    """A fuzz target. `call` accepts any bytes and catches the permitted errors. `tokens` are words of the format."""

    name: str
    call: Callable[[bytes], None]
    seeds: tuple[bytes, ...]
    tokens: tuple[bytes, ...]

    @property
    def inputs(self) -> list[bytes]:
        """Return the seeds and the corpus."""
        path = FOLDER / f"{self.name}.txt"
        lines = path.read_text(encoding="ascii").split() if path.is_file() else []
        return [*self.seeds, *(zlib.decompress(base64.b85decode(line)) for line in lines)]

    def changed(self) -> st.SearchStrategy[bytes]:
        """Return a strategy for copies in which pieces are replaced by tokens, by bytes, or by nothing."""
        piece = st.sampled_from((*self.tokens, *INTERESTING)) | st.binary(max_size=4)
        edits = st.lists(st.tuples(st.floats(0.0, 1.0), st.sampled_from((0, 1, 2, 16, 64)), piece), max_size=4)
        return st.builds(_edited, st.sampled_from(self.inputs), edits)


def _edited(data: bytes, edits: list[tuple[float, int, bytes]]) -> bytes:
    for place, removed, piece in edits:
        at = round(place * len(data))
        data = data[:at] + piece + data[at + removed :]
    return data
