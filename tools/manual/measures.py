"""What the manual quotes: each figure with the command that prints it and how it is read from what that prints.

A figure that is not `deterministic` depends on the machine; those that are `long` take minutes, and are measured when
they are named or asked for.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

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


def _json(*path: str | int, factor: float = 1.0) -> Callable[[str], float]:
    def read(text: str) -> float:
        found: Any = json.loads(text)
        for key in path:
            found = found[key]
        return factor * float(found)

    return read


def _on_vcan(text: str) -> float:
    """The demo's reduction in %, of a run that was one on a vcan."""
    bus = json.loads(text)["bus"]
    if not str(bus).startswith("vcan"):
        raise ValueError(f"the demo ran on {bus}: this machine has no vcan, or is too slow for it")
    return _json("reduction_percent")(text)


def _found(pattern: str, factor: float = 1.0) -> Callable[[str], float]:
    def read(text: str) -> float:
        match = re.search(pattern, text)
        if match is None:
            raise ValueError(f"'{pattern}' is not in what was printed")
        return factor * float(match[1].replace(",", ""))

    return read


def _rms(joint: str, law: str) -> Callable[[str], float]:
    """The error in mN*m of one joint under one law, from the rows of bench/control."""

    def read(text: str) -> float:
        for line in text.splitlines():
            row = json.loads(line)
            if (row.get("joint"), row["law"]) == (joint, law) and "rms" in row:
                return 1e3 * float(row["rms"])
        raise ValueError(f"no row of joint {joint} and law {law} is in what was printed")

    return read


def _of_floor(text: str) -> float:
    """The median cycle of `tsa run` over that of the raw socket, from bench/cycle."""
    ways = json.loads(text)["ways"]
    return float(ways["ours"]["cycle_p50"]) / float(ways["raw socket"]["cycle_p50"])


def _demo(load: str) -> tuple[str, ...]:
    return (TSA, "demo", "--virtual", "--load", load, "--json", "--out", "{out}")


OUT = ("--out", "{out}")
CONTROL_LAWS = ("none", "(3.55)", "true")
LOADS = ("imposed", "held", "spring", "weight", "free", "limb", "wearer")


def _drawn(name: str, words: str, families: tuple[str, ...], pattern: str, unit: str, seed: str = "8000") -> Measure:
    """A line of the blind benchmark on short logs of these families."""
    line = ("{root}/tools/run", "bench/diagnose", "--short", "--families", *families, "--seed", seed, *OUT)
    return Measure(name, words, line, _found(pattern), unit, deterministic=True, long=True)


MEASURES: tuple[Measure, ...] = (
    *(
        Measure(
            f"demo-{load}",
            f"demo, joint {load}: error of the joint torque less than without compensation",
            _demo(load),
            _json("reduction_percent"),
            "%",
            deterministic=True,
        )
        for load in LOADS
    ),
    *(
        Measure(
            f"first-{name}",
            f"first ten minutes, a bare Python 3.11 and the wheel alone: {words}",
            ("{root}/tools/run", "package/check", "--python", "python3.11"),
            _found(rf"{pattern}\s+0\s+([0-9.]+) s"),
            "s",
        )
        for name, words, pattern in (
            ("install", "pip install", "pip install"),
            ("picture", "first picture, functions compiled in it", r"tsa demo --virtual\b.*?"),
            ("example", "an example log made and diagnosed", r"tsa diagnose --example\b.*?"),
        )
    ),
    Measure(
        "first-size",
        "the environment after that, on disk",
        ("{root}/tools/run", "package/check", "--python", "python3.11"),
        _found(r"environment after it all .*\b(\d+)\s+bare"),
        "MB",
        deterministic=True,
    ),
    Measure(
        "virtual-speed",
        "virtual time of `tsa simulate-loop` with the example files, over real time",
        (TSA, "simulate-loop", "{config}/controller.toml", "{config}/plant.toml", "--seconds", "20", "--json"),
        lambda text: 20.0,
        "times",
        per_second=True,
    ),
    Measure(
        "demo-vcan",
        "demo on a real vcan, at the rate that the machine keeps: error less than without compensation",
        ("{root}/tools/demo", "--json", "--out", "{out}"),
        _on_vcan,
        "%",
    ),
    *(
        Measure(
            f"control-{joint}-{name}",
            f"evenly bent, joint {joint}, {words}: RMS error of the joint torque",
            ("{root}/tools/run", "bench/control", "--shapes", "uniform", "--laws", *CONTROL_LAWS, "--json"),
            _rms(joint, law),
            "mN·m",
            deterministic=True,
            long=True,
        )
        for joint in LOADS
        for law, name, words in (
            ("none", "none", "no compensation"),
            ("(3.55)", "nominal", "(3.55) with the nominal file"),
            ("true", "true", "true parameters"),
        )
    ),
    *(
        Measure(
            f"tendons-{name}",
            words,
            ("{root}/tools/run", "bench/tendons", "--out", "{out}"),
            _found(pattern),
            "mN·m",
            deterministic=True,
            long=True,
        )
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
            ("elements-10", "distributed plant, 10 elements against 160", r"│ 10\s*│\s*([\d.]+)"),
            ("elements-40", "the same, 40 elements", r"│ 40\s*│\s*([\d.]+)"),
        )
    ),
    Measure(
        "drives",
        "variations of drives that are brought up, or refused with the reason",
        ("{root}/tools/run", "campaign/drives"),
        _found(r"variations, (\d+) as they must be"),
        "as they must be",
        deterministic=True,
        long=True,
    ),
    Measure(
        "runaway",
        "combinations of joint, friction, pretension, shape and gain that swing nowhere or are stopped in time",
        ("{root}/tools/run", "campaign/runaway", "changes", "--sensors", "sensor"),
        _found(r"runs, (\d+) as they must be"),
        "as they must be",
        deterministic=True,
        long=True,
    ),
    Measure(
        "diagnose-speed",
        "60 s at 1 kHz diagnosed, from the command to the report",
        ("{root}/tools/run", "bench/diagnose", "--speed"),
        _found(r": ([\d.]+) s, of which"),
        "s",
        long=True,
    ),
    *(
        Measure(
            f"ten-minutes-{name}",
            f"600 s at 1 kHz diagnosed, {words}",
            ("{root}/tools/run", "bench/hour", "--seconds", "600", "--kinds", "csv"),
            _found(pattern),
            "s",
            long=True,
        )
        for name, words, pattern in (
            ("wall", "from the command to the report", r"MB, ([\d.]+) s, of which"),
            ("processor", "seconds of one processor", r"of which ([\d.]+) s"),
        )
    ),
    *(
        Measure(
            f"hour-{kind}",
            f"an hour at 1 kHz diagnosed, {words}: peak of memory, all processes",
            ("{root}/tools/run", "bench/hour"),
            _found(rf"{kind}: .*: peak ([\d.]+) MB"),
            "MB",
            long=True,
        )
        for kind, words in (("csv", "a table of 6 columns"), ("mcap", "the daemon's own log"))
    ),
    _drawn(
        "pairs-both",
        "two effects hidden, 60 draws: both named, nothing else",
        ("pair",),
        r"two effects: both named, nothing else\s+>= \d+%\s+(\d+)/60 ",
        "of 60",
    ),
    *(
        _drawn(
            f"outside-{name}",
            f"causes outside the catalogue, of {of} draws: {words}",
            ("outside:3",),
            rf"{pattern}\s+[<>]= \d+%\s+(\d+)/{of} ",
            f"of {of}",
            seed="9600",
        )
        for name, words, pattern, of in (
            ("noticed", "noticed", "outside the catalogue: noticed", 42),
            ("wrong", "a single wrong name beside it", "outside the catalogue: a confident name", 42),
            ("formula", "a formula takes 70 % of what is left", "a formula takes 70 % of what is left", 42),
            ("instant", "the same of a function of an instant", "a function of an instant: the same", 18),
            ("filter", "the same of what has a filter's memory", "a filter's memory of the load: the same", 9),
            ("clock", "the same of what a clock tells", "by a clock: the same", 6),
        )
    ),
    _drawn(
        "plain-unique",
        "plain drives, one effect hidden, of 137 draws: named uniquely",
        ("rigid",),
        r"plain drive, one effect: named uniquely\s+>= \d+%\s+(\d+)/137 ",
        "of 137",
    ),
    Measure(
        "cycle",
        "cycle of one axis to that of a raw socket, medians",
        ("{root}/tools/vcan", "tools/run", "bench/cycle", "--json"),
        _of_floor,
        "of the floor",
        long=True,
    ),
)
