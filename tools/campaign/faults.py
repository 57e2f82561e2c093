"""Every fault, one after the other, on a real vcan: is the motor's torque zero in time, and does it stay so?

Usage: tools/run campaign/faults [--tolerant] [--only TEXT]... [--json] [--list]

Plant and daemon are processes; the daemon has config/controller.toml as it is shipped (1 kHz, its time-outs), but for a
constant set-point that fades in within 0.2 s. --tolerant: half the rate and longer time-outs, for a crowded machine.

Each fault is injected while the daemon delivers torque; what the motor did is read from the plant's own record, not
from the controller. A fault is met safely when

  the torque is zero within [safety] zero_torque_within of the configuration (0.25 s; lies that show only with motion:
  2 s), and stays so after the cause is gone, and the daemon's log names the cause; or, where a fault takes nothing
  away that control needs, when the loop goes on within its limits and what was lost is counted and said.

A trial during which the machine stood still (a hole of 1.6 periods in the plant's record) is discarded, whatever came
of it, and done again, five times in all; the verdicts on those that were discarded are told. Where it stood still each
time the last one counts, and a loop that stops in time and names that is safe, and is listed as stopped. Ends with the
line `N faults, N safe`; exit code 1 unless all are. Needs a vcan: is run under tools/vcan where there is none; and the
right to switch it, which is there in that guest.
"""

from __future__ import annotations

import json
import re
import sys
import tempfile
from pathlib import Path

from tools import command
from tools.campaign.fault.campaign import ATTEMPTS, BOUND, Campaign, Result, check_free
from tools.campaign.fault.catalogue import FAULTS
from tsa_ctrl.errors import UsageError

HEAD = ("fault", "detected as", "torque zero after", "cause in the log", "latched")


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--tolerant", action="store_true", help="500 Hz and longer time-outs, for a crowded machine")
    parser.add_argument("--only", action="append", default=[], metavar="TEXT", help="faults whose name has TEXT")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    parser.add_argument("--list", action="store_true", help="the names of all faults")
    options = parser.parse_args()
    chosen = tuple(f for f in FAULTS if not options.only or any(text in f.name for text in options.only))
    if options.list:
        print("\n".join(fault.name for fault in FAULTS))
        return 0
    if not chosen:
        raise UsageError(f"no fault has '{', '.join(options.only)}' in its name; see --list")
    channel = command.vcan(__name__)
    with tempfile.TemporaryDirectory() as folder:
        check_free(channel)
        trials = Campaign(Path(folder), channel, options.tolerant, say).run(chosen)
    results = [result for result in trials if not result.trial.discarded]
    discarded = [result for result in trials if result.trial.discarded]
    if options.json:
        found = {"faults": [as_dict(each) for each in results], "discarded": [as_dict(each) for each in discarded]}
        print(json.dumps({"schema": 1, "bound": BOUND, **found}))
    else:
        show(results, discarded)
    return 0 if all(result.verdict.safe for result in results) else 1


def say(name: str) -> None:
    print(f"  {name}", file=sys.stderr, flush=True)


def as_dict(result: Result) -> dict[str, object]:
    trial, verdict = result.trial, result.verdict
    return {
        "name": trial.fault.name,
        "safe": verdict.safe,
        "wrong": list(verdict.wrong),
        "detected": verdict.detected,
        "zero_after": None if verdict.latched is None else trial.zero,
        "cause_in_log": verdict.cause_in_log,
        "latched": verdict.latched,
        "stalled": verdict.stalled,
        "repeated": trial.repeated,
        "longest_gap": trial.gap,
    }


def show(results: list[Result], discarded: list[Result]) -> None:
    """The table as Markdown, what was discarded and what it would have said, and the last line."""
    print(f"| {' | '.join(HEAD)} |\n|{' --- |' * len(HEAD)}")
    for result in results:
        print(f"| {' | '.join(cells(result))} |")
    if discarded:
        print(f"\n{counted(len(results), discarded)}")
        for result in discarded:
            for line in result.verdict.wrong:
                print(f"discarded, unsafe: {result.trial.fault.name}: {line}")
    stalled = sum(result.verdict.stalled for result in results)
    if stalled:
        print(f"{stalled} that should go on stopped safely: the machine stood still in each of {ATTEMPTS} trials")
    for result in results:
        for line in result.verdict.wrong:
            print(f"unsafe: {result.trial.fault.name}: {line}")
    print(f"\n{len(results)} faults, {sum(result.verdict.safe for result in results)} safe")


def counted(kept: int, discarded: list[Result]) -> str:
    """How many trials there were, how many of them were discarded, and what those would have said."""
    safe = sum(result.verdict.safe for result in discarded)
    return (
        f"{kept} of {kept + len(discarded)} trials, {len(discarded)} discarded for holes: {safe} safe, "
        f"{len(discarded) - safe} unsafe"
    )


def cells(result: Result) -> tuple[str, ...]:
    trial, verdict, expected = result.trial, result.verdict, result.trial.fault.expected
    detected = re.split(r" \(|; |, | since ", verdict.detected.removeprefix("tripped by the controller: "))[0]
    if verdict.latched is None:
        log = "yes" if verdict.cause_in_log else "nothing is lost"
        return trial.fault.name, detected, f"goes on: {expected.harmless}", log, "-"
    if verdict.stalled:
        return (
            trial.fault.name,
            detected,
            f"{1e3 * (trial.stopped or 0.0):.0f} ms (the machine stood still)",
            "yes",
            "yes",
        )
    zero = (
        "never" if trial.zero is None else f"{1e3 * trial.zero:.0f} ms" + (f" ({expected.why})" if expected.why else "")
    )
    latched, named = ("yes" if found else "NO" for found in (verdict.latched, verdict.cause_in_log))
    return trial.fault.name, detected, zero, named, latched
