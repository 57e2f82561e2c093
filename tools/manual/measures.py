"""What the manual quotes: each figure with the command that prints it and how it is read from what that prints.

A figure that is not `deterministic` depends on the machine; those that are `long` take minutes, and are measured when
they are named or asked for.
"""

from __future__ import annotations

import json
import re
import shlex
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

TSA = str(Path(sys.executable).with_name("tsa"))


@dataclass(frozen=True)
class Measure:
    """A figure: what it is, the command that prints it, and how it is read from what that prints."""

    name: str
    words: str
    line: tuple[str, ...]
    read: Callable[[str], float]
    unit: str
    deterministic: bool = False  # in virtual time: the same command gives the same figure
    long: bool = False  # takes minutes
    per_second: bool = False  # what is read, over the time that the command took


def _reduction(text: str) -> float:
    """Return the demo's reduction in %."""
    return float(json.loads(text)["reduction_percent"])


def _on_vcan(text: str) -> float:
    """Return the demo's reduction in %, of a run on a vcan."""
    bus = json.loads(text)["bus"]
    if not str(bus).startswith("vcan"):
        raise ValueError(f"the demo ran on {bus}: this machine has no vcan, or is too slow for it")
    return _reduction(text)


def _found(pattern: str) -> Callable[[str], float]:
    def read(text: str) -> float:
        match = re.search(pattern, text)
        if match is None:
            raise ValueError(f"'{pattern}' is not in what was printed")
        return float(match[1].replace(",", ""))

    return read


def _of_floor(text: str) -> float:
    """The median cycle of `tsa run` over that of the raw socket, from bench/cycle."""
    ways = json.loads(text)["ways"]
    return float(ways["ours"]["cycle_p50"]) / float(ways["raw socket"]["cycle_p50"])


def _tool(words: str) -> tuple[str, ...]:
    return ("{root}/tools/run", *shlex.split(words))


LOADS = ("imposed", "held", "spring", "weight", "free", "limb", "wearer")
_FIRST = "first ten minutes, a bare Python 3.11 and the wheel alone"
_SHORT = "bench/diagnose --short --families {} --seed {} --out {{out}}"
_OUTSIDE = "causes outside the catalogue, of {} draws: {}"


def _quick() -> Iterator[Measure]:
    """Yield the figures that take seconds."""
    for load in LOADS:
        words = f"demo, joint {load}: error of the joint torque less than without compensation"
        line: tuple[str, ...] = (TSA, "demo", "--virtual", "--load", load, "--json", "--out", "{out}")
        yield Measure(f"demo-{load}", words, line, _reduction, "%", deterministic=True)
    check = _tool("package/check --python python3.11")
    for name, words, pattern in (
        ("install", "pip install", "pip install"),
        ("picture", "first picture, functions compiled in it", r"tsa demo --virtual\b.*?"),
        ("example", "an example log made and diagnosed", r"tsa diagnose --example\b.*?"),
    ):
        yield Measure(f"first-{name}", f"{_FIRST}: {words}", check, _found(rf"{pattern}\s+0\s+([0-9.]+) s"), "s")
    size = _found(r"environment after it all .*\b(\d+)\s+bare")
    yield Measure("first-size", "the environment after that, on disk", check, size, "MB", deterministic=True)
    words = "virtual time of `tsa simulate-loop` with the example files, over real time"
    line = (TSA, "simulate-loop", "{config}/controller.toml", "{config}/plant.toml", "--seconds", "20", "--json")
    yield Measure("virtual-speed", words, line, lambda text: 20.0, "times", per_second=True)
    words = "demo on a real vcan, at the rate that the machine keeps: error less than without compensation"
    yield Measure("demo-vcan", words, ("{root}/tools/demo", "--json", "--out", "{out}"), _on_vcan, "%")


def _same() -> Iterator[tuple[str, str, str, Callable[[str], float], str]]:
    """Yield the figures that take minutes and are the same at each run: name, words, tool, reader and unit."""
    for name, words, pattern in (
        (
            "simplified",
            "(3.55) against distributed tendons while sliding, of 761 mN·m",
            r"simplified \(3\.55\)\s*│\s*[\d.]+\s*│\s*([\d.]+)",
        ),
        (
            "full",
            "(3.53) against distributed tendons while sliding",
            r"full \(3\.53\), sliding\s*│\s*[\d.]+\s*│\s*([\d.]+)",
        ),
    ):
        yield f"tendons-{name}", words, "figures/models --out {out}", _found(pattern), "mN·m"
    words = "combinations of joint, friction, pretension, shape and gain that swing nowhere or are stopped in time"
    line = "campaign/runaway changes --sensors sensor"
    yield "runaway", words, line, _found(r"runs, (\d+) as they must be"), "as they must be"
    both = _found(r"two effects: both named, nothing else\s+>= \d+%\s+(\d+)/60 ")
    words = "two effects hidden, 60 draws: both named, nothing else"
    yield "pairs-both", words, _SHORT.format("pair", 8000), both, "of 60"
    for name, words, pattern, of in (
        ("noticed", "noticed", "outside the catalogue: noticed", 42),
        ("wrong", "a single wrong name beside it", "outside the catalogue: a confident name", 42),
        ("formula", "a formula takes 70 % of what is left", "a formula takes 70 % of what is left", 42),
        ("instant", "the same of a function of an instant", "a function of an instant: the same", 18),
        ("filter", "the same of what has a filter's memory", "a filter's memory of the load: the same", 9),
        ("clock", "the same of what a clock tells", "by a clock: the same", 6),
    ):
        read = _found(rf"{pattern}\s+[<>]= \d+%\s+(\d+)/{of} ")
        yield f"outside-{name}", _OUTSIDE.format(of, words), _SHORT.format("outside:3", 9600), read, f"of {of}"
    unique = _found(r"plain drive, one effect: named uniquely\s+>= \d+%\s+(\d+)/137 ")
    words = "plain drives, one effect hidden, of 137 draws: named uniquely"
    yield "plain-unique", words, _SHORT.format("rigid", 8000), unique, "of 137"


def _long() -> Iterator[Measure]:
    """Yield the figures that take minutes and depend on the machine."""
    words = "60 s at 1 kHz diagnosed, from the command to the report"
    read = _found(r": ([\d.]+) s, of which")
    yield Measure("diagnose-speed", words, _tool("bench/diagnose --speed"), read, "s", long=True)
    line = _tool("bench/hour --seconds 600 --kinds csv")
    for name, words, pattern in (
        ("wall", "from the command to the report", r"MB, ([\d.]+) s, of which"),
        ("processor", "seconds of one processor", r"of which ([\d.]+) s"),
    ):
        said = f"600 s at 1 kHz diagnosed, {words}"
        yield Measure(f"ten-minutes-{name}", said, line, _found(pattern), "s", long=True)
    for kind, words in (("csv", "a table of 6 columns"), ("mcap", "the daemon's own log")):
        said = f"an hour at 1 kHz diagnosed, {words}: peak of memory, all processes"
        yield Measure(
            f"hour-{kind}", said, _tool("bench/hour"), _found(rf"{kind}: .*: peak ([\d.]+) MB"), "MB", long=True
        )
    line = ("{root}/tools/vcan", "tools/run", "bench/cycle", "--json")
    words = "cycle of one axis to that of a raw socket, medians"
    yield Measure("cycle", words, line, _of_floor, "of the floor", long=True)


MEASURES: tuple[Measure, ...] = (
    *_quick(),
    *(Measure(name, words, _tool(line), read, unit, True, True) for name, words, line, read, unit in _same()),
    *_long(),
)
