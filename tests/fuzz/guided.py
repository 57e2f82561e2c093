"""Fuzzing that is led by coverage: inputs that reach what none reached before are kept, and spoiled further.

What counts as reached is a step from one line of a target's modules to another, seen by `sys.settrace`; the measure
that is printed is the share of the lines inside functions that were run. A corpus is a text file, an input a line.
"""

from __future__ import annotations

import base64
import importlib
import inspect
import random
import sys
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import CodeType, FrameType, ModuleType
from typing import Any

from tests.fuzz.part import Part

CORPUS = Path(__file__).parent / "corpus"
MOST_KEPT = 4096  # bytes of an input in a corpus: more is slow, and no reader is clearer by it
RECENT = 4  # inputs of a corpus that are taken as often as all
STACK = 6  # changes of one input at most
INTERESTING = (b"\0", b"\xff", b"\x7f", b"\x80", b"-1", b"nan", b"1e999", b"9" * 25, b"\r\n", b",", b'"', b"[" * 200)

Line = tuple[str, int]


@dataclass(frozen=True)
class Target:
    """`call` takes any bytes, and catches the errors that it may raise. `goal`: share of the lines of `modules`.

    An entry of `modules` is "MODULE", or "MODULE:NAME NAME ..." for some functions and classes of it.
    """

    name: str
    call: Callable[[bytes], None]
    modules: tuple[str, ...]
    seeds: tuple[bytes, ...]
    tokens: tuple[bytes, ...]
    goal: float


@dataclass
class Reached:
    """Of one target."""

    lines: set[Line] = field(default_factory=set)
    steps: set[tuple[str, int, int]] = field(default_factory=set)


def lines_of(modules: Sequence[str]) -> set[Line]:
    """Return every line inside a function of these modules, or of the names that an entry gives."""
    found: set[Line] = set()
    for entry in modules:
        names = entry.partition(":")[2].split()
        path = Path(inspect.getfile(module_of(entry)))
        code = compile(path.read_text(encoding="utf-8"), str(path), "exec")
        for inner in _functions(code):
            if names and inner.co_qualname.partition(".")[0] not in names:
                continue
            first = inner.co_firstlineno
            found |= {(str(path), line) for _, _, line in inner.co_lines() if line is not None and line != first}
    return found


def module_of(entry: str) -> ModuleType:
    """Return the module of an entry of `Target.modules`."""
    return importlib.import_module(entry.partition(":")[0])


def _functions(code: CodeType) -> Iterator[CodeType]:
    """Those inside of it; a class' own body runs with the import."""
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            if constant.co_flags & inspect.CO_NEWLOCALS:
                yield constant
            yield from _functions(constant)


class Tracer:
    """Notes what runs in some files, while it is on."""

    def __init__(self, files: frozenset[str]) -> None:
        self._files = files
        self.lines: set[Line] = set()
        self.steps: set[tuple[str, int, int]] = set()

    def run(self, call: Callable[[bytes], None], data: bytes) -> None:
        """Afterwards `lines` and `steps` are those of this call."""
        self.lines, self.steps = set(), set()
        before = sys.gettrace()
        sys.settrace(self._enter)
        try:
            call(data)
        finally:
            sys.settrace(before)

    def _enter(self, frame: FrameType, event: str, argument: Any) -> Callable[..., Any] | None:
        name = frame.f_code.co_filename
        if name not in self._files:
            return None
        last = frame.f_lineno

        def local(inner: FrameType, event: str, argument: Any) -> Callable[..., Any]:
            nonlocal last
            if event == "line":
                line = inner.f_lineno
                self.lines.add((name, line))
                self.steps.add((name, last, line))
                last = line
            return local

        return local


def spoiled(data: bytes, others: Sequence[bytes], tokens: Sequence[bytes], draw: random.Random) -> bytes:
    """A changed copy: bytes, pieces, tokens of the target's language, halves of another input."""
    made = bytearray(data)
    for _ in range(draw.choice((1, 1, 2, 3, STACK))):
        at = draw.randrange(len(made) + 1)
        kind = draw.randrange(8)
        if kind == 0 and made:
            made[min(at, len(made) - 1)] = draw.randrange(256)
        elif kind == 1 and made:
            made[min(at, len(made) - 1)] ^= 1 << draw.randrange(8)
        elif kind == 2:
            del made[at : at + draw.choice((1, 1, 2, 4, 16, 64))]
        elif kind == 3:
            made[at:at] = draw.choice((*tokens, *INTERESTING))
        elif kind == 4:
            token = draw.choice((*tokens, *INTERESTING))
            made[at : at + len(token)] = token
        elif kind == 5:
            piece = made[at : at + draw.choice((1, 4, 16, 64))]
            place = draw.randrange(len(made) + 1)
            made[place:place] = piece
        elif kind == 6 and others:
            other = draw.choice(others)
            cut = draw.randrange(len(other) + 1)
            made = made[:at] + other[cut:]
        else:
            made = made[:at]
    return bytes(made[:MOST_KEPT])


def kept(name: str) -> list[bytes]:
    """The corpus of a target; none when there is no file."""
    path = CORPUS / f"{name}.txt"
    if not path.is_file():
        return []
    return [zlib.decompress(base64.b85decode(line)) for line in path.read_text(encoding="ascii").split()]


def keep(name: str, inputs: Sequence[bytes]) -> None:
    CORPUS.mkdir(exist_ok=True)
    lines = [base64.b85encode(zlib.compress(data, 9)).decode("ascii") for data in inputs]
    (CORPUS / f"{name}.txt").write_text("".join(f"{line}\n" for line in lines), encoding="ascii")


def run(target: Target, seconds: float, seed: int, most: int | None = None, save: bool = False) -> Part:
    """Fuzz it for so many s of processor time, or `most` inputs; `save`: write what reached something anew."""
    part, draw = Part(target.name), random.Random(seed)
    everything = lines_of(target.modules)
    modules: list[ModuleType] = [module_of(entry) for entry in target.modules]
    tracer = Tracer(frozenset(inspect.getfile(module) for module in modules))
    reached = Reached()
    corpus: list[bytes] = []

    def try_one(data: bytes) -> None:
        part.inputs += 1
        with part.surviving(f"{data!r:.300}"):
            tracer.run(target.call, data)
        if not tracer.steps <= reached.steps:
            reached.steps |= tracer.steps
            reached.lines |= tracer.lines
            corpus.append(data)

    end = time.process_time() + seconds
    for data in (*target.seeds, *kept(target.name)):
        try_one(data)
    part.counts["corpus"] = len(corpus)
    while time.process_time() < end and (most is None or part.inputs < most):
        recent = corpus[-RECENT:] if draw.random() < 0.5 else corpus  # who came furthest leads further
        try_one(spoiled(draw.choice(recent), corpus, target.tokens, draw))
    part.counts["found"] = len(corpus) - part.counts["corpus"]
    part.counts["lines"], part.counts["of"] = len(reached.lines & everything), len(everything)
    if part.counts["lines"] < target.goal * len(everything):
        part.blame(f"{part.counts['lines']} of {len(everything)} lines, the goal is {target.goal:.0%}")
    if save:
        keep(target.name, corpus[len(target.seeds) :])
    return part
