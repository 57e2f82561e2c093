"""Send invalid frames to loop and bring-up, and detect crashes, torque and leaks.

Usage: tools/run campaign/fuzz [PART...] [--frames 1000000] [--seed 1] [--json]

  loop      corrupted, random and false frames to the daemon's loop on a bus in memory; an independent check of the
            frames decides when torque is permitted
  bring-up  startup on a bus that corrupts SDO answers; it must succeed, or fail with one line

The part loop receives --frames, and bring-up a smaller share. Memory and descriptors after the first quarter are
compared with those at the end. Exit code 1: a problem was found. The same seed reproduces it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

from tests.fuzz import configuring, master
from tests.fuzz.part import Part
from tools import command
from tools.command import Row

PARTS: dict[str, Callable[[int, int], Part]] = {  # frames, seed
    "loop": master.run,
    "bring-up": lambda frames, seed: configuring.run(max(4, frames // 5000), seed),
}
MOST_GROWTH = 16 << 20  # bytes; larger growth is a leak


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--frames", type=int, default=1_000_000)
    command.share(parser, "seed json", seed=1)
    options = parser.parse_args()
    if unknown := sorted({*options.parts} - {*PARTS}):
        parser.error(f"no part {', '.join(unknown)}; there are {', '.join(PARTS)}")
    rows: list[Row] = []
    for name in options.parts or PARTS:
        rows.append(row_of(PARTS[name](options.frames, options.seed)))
        print(f"{name}: {rows[-1]['inputs']} inputs, {rows[-1]['counts']}", file=sys.stderr, flush=True)
    lines = ((row["part"], row["inputs"], row["growth_mib"], row["left_open"], len(row["problems"])) for row in rows)
    heads = ("part", "inputs", "growth (MiB)", "left open", "problems")
    command.print_tables(rows, options, lambda: [command.table(heads, lines)])
    problems = [f"{row['part']}: {text}" for row in rows for text in row["problems"]]
    print("\n".join([*problems, f"{sum(row['inputs'] for row in rows)} inputs, {len(problems)} problems"]))
    return 1 if problems else 0


def row_of(part: Part) -> Row:
    """Return inputs, memory growth, open descriptors and problems of a part."""
    growth = part.after.memory - part.before.memory
    opened = part.after.descriptors - part.before.descriptors
    problems = list(part.problems)
    if growth > MOST_GROWTH:
        problems.append(f"memory grew by {growth / 2**20:.1f} MiB")
    if opened > 0:
        problems.append(f"{opened} descriptors were left open")
    row: Row = {"part": part.name, "inputs": part.inputs, "growth_mib": growth / 2**20, "left_open": max(opened, 0)}
    return {**row, "counts": dict(part.counts), "problems": problems}
