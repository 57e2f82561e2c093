"""Investigate rigs with hidden causes, and print the hypotheses after each motion and the answer.

Usage: tools/run bench/investigate [--seed N] [--only TEXT] [--processes 1|2]

The tests draw the rigs by the seed; the loop and the plant run in virtual time. The table has a row for
each rig, and the last line counts the right answers.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from click.testing import CliRunner

from tests.investigate.rigs import Rig, rigs, write
from tsa_ctrl.cli.investigate import command


def investigated(hidden: Rig, seed: int) -> dict[str, Any]:
    """The JSON object of one rig; an error is its text."""
    with tempfile.TemporaryDirectory() as folder:
        controller, plant = write(Path(folder) / "rig", hidden, seed)
        call = [str(controller), "--virtual", str(plant), "--out", str(Path(folder) / "out"), "--json"]
        done = CliRunner().invoke(command, call)
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            return {"answer": "error", "statement": str(done.exception), "causes": [], "steps": []}
        found: dict[str, Any] = json.loads(done.stdout)
        return found


def row(hidden: Rig, found: dict[str, Any]) -> str:
    """One line of the table."""
    steps = "; ".join(
        ", ".join(" or ".join(names) for names in step["hypotheses"]) or step["verdict"] for step in found["steps"]
    )
    right = "right" if hidden.judged(found["answer"], found["causes"]) else "WRONG"
    seconds = sum(step["seconds"] for step in found["steps"])
    return f"| {hidden.name} | {steps} | {len(found['steps'])} | {seconds:.0f} | {found['answer']} | {right} |"


def main() -> int:
    """Run the rigs and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="rigs with this text in their name")
    parser.add_argument("--processes", type=int, choices=(1, 2), default=2)
    options = parser.parse_args()
    chosen = [hidden for hidden in rigs(options.seed) if options.only in hidden.name]
    print("| hidden | after each motion | motions | s | answer | |\n| --- | --- | --- | --- | --- | --- |", flush=True)
    right = 0
    with ProcessPoolExecutor(options.processes) as pool:
        for hidden, found in zip(chosen, pool.map(investigated, chosen, [options.seed] * len(chosen)), strict=True):
            right += hidden.judged(found["answer"], found["causes"])
            print(row(hidden, found), flush=True)
            if found["answer"] == "error":
                print(found["statement"], file=sys.stderr)
    print(f"{right} of {len(chosen)} right")
    return 0
