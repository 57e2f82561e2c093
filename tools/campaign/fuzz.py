"""Throws nonsense at everything that listens: no crash, no torque, no leak.

Usage: tools/run campaign/fuzz [PART...] [--frames 1000000] [--seed 1] [--json]
       tools/run campaign/fuzz --coverage [TARGET...] [--minutes 24] [--save] [--seed 1] [--json]

  loop      spoiled, random and lying frames to the daemon's loop on a bus in memory; a judge that reads only the frames
            says when there may be torque
  plant     random frames and SDO requests to the simulated nodes; after each batch a reset must bring them back
  bring-up  the start over a bus that spoils SDO answers: it succeeds, or says in one line why not
  socket    spoiled requests to the local socket's process
  files     spoiled configuration files to every reader

--coverage: led by what an input reaches, each target with a corpus that is kept (tests/fuzz/corpus) and a goal;
--minutes of processor time are shared by the targets, --save adds to the corpus what reached something anew:

  frames, sdo (answers), requests (socket), http (dashboard), toml, csv, set-point, mcap, eds, serial

--frames is shared by loop and plant; the other parts take their share of it. Memory and descriptors are those after the
first quarter and at the end. Exit code 1: a problem was found; its seed repeats it.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any

from tests.fuzz import configuring, files, guided, master, nodes, requests
from tests.fuzz.part import Part
from tests.fuzz.targets import targets
from tools import command

PARTS: dict[str, Callable[[int, int], Part]] = {  # frames, seed
    "loop": lambda frames, seed: master.run(frames // 2, seed),
    "plant": lambda frames, seed: nodes.run(frames // 2, seed),
    "bring-up": lambda frames, seed: configuring.run(max(4, frames // 5000), seed),
    "socket": lambda frames, seed: requests.run(max(100, frames // 10), seed),
    "files": lambda frames, seed: files.run(max(100, frames // 100), seed),
}
MOST_GROWTH = 16 << 20  # bytes; more is a leak


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--coverage", action="store_true", help="led by coverage")
    parser.add_argument("--minutes", type=float, default=24.0, help="of processor time, with --coverage")
    parser.add_argument("--save", action="store_true", help="keep what reached something anew, with --coverage")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    parts = PARTS
    if options.coverage:
        seconds = 60.0 * options.minutes / len(options.parts or targets())
        parts = {
            target.name: lambda frames, seed, target=target: guided.run(target, seconds, seed, save=options.save)  # type: ignore[misc]
            for target in targets()
        }
    unknown = [name for name in options.parts if name not in parts]
    if unknown:
        parser.error(f"no part {', '.join(unknown)}; there are {', '.join(parts)}")
    rows: list[dict[str, Any]] = []
    problems: list[str] = []
    for name in options.parts or parts:
        begin = time.monotonic()
        part = parts[name](options.frames, options.seed)
        row, found = describe(part, time.monotonic() - begin)
        rows.append(row)
        problems += found
        if not options.json:
            show(row)
    if options.json:
        print(json.dumps({"schema": 1, "parts": rows, "problems": problems}))
    else:
        print("\n".join(problems), end="\n" if problems else "")
        print(f"{sum(row['inputs'] for row in rows)} inputs, {len(problems)} problems")
    return 1 if problems else 0


def describe(part: Part, seconds: float) -> tuple[dict[str, Any], list[str]]:
    """A line of the table, and what is wrong."""
    growth = part.after.memory - part.before.memory
    opened = part.after.descriptors - part.before.descriptors
    problems = [f"{part.name}: {text}" for text in part.problems]
    if growth > MOST_GROWTH:
        problems.append(f"{part.name}: memory grew by {growth / 2**20:.1f} MiB")
    if opened > 0:
        problems.append(f"{part.name}: {opened} descriptors were left open")
    row: dict[str, Any] = {
        "part": part.name,
        "inputs": part.inputs,
        "seconds": round(seconds, 1),
        "memory_before": part.before.memory,
        "memory_after": part.after.memory,
        "descriptors_before": part.before.descriptors,
        "descriptors_after": part.after.descriptors,
        "counts": dict(part.counts),
    }
    return row, problems


def show(row: dict[str, Any]) -> None:
    before, after = (row[key] / 2**20 for key in ("memory_before", "memory_after"))
    counts = row["counts"]
    print(
        f"{row['part']:9}{row['inputs']:>9} inputs in {row['seconds']:>6} s, memory {before:.1f} -> {after:.1f} MiB, "
        f"descriptors {row['descriptors_before']} -> {row['descriptors_after']}; "
        + ", ".join(f"{key} {value}" for key, value in counts.items()),
        flush=True,
    )
