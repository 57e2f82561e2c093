"""Every way in which drives of others differ from the standard, tried in virtual time: the matrix.

Usage: tools/run campaign/drives [--only TEXT]... [--json] [--list] [--diff]

Each variation is a set of keys of the simulated drive ([axis.drive] of plant.toml) and, where one is needed, of lines
of its profile or of the controller's file. The daemon's own loop brings it up, enables it, pulls, meets a fault of
the drive and a power cycle, recovers from both, stops, and starts again two seconds later. What comes up must do all
of that; what is refused must be refused before a command was sent, with a message that names the line that mends it.

Prints a table (variation, outcome, message) and ends with the line `N variations, N as they must be`; exit code 1
unless all are. No bus, no rights: nothing waits for real time. With --diff: what tsa drive diff shows of each make at
power-on, under the profile that is shipped.
"""

from __future__ import annotations

import json
import sys

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tools import command
from tools.campaign.drive.makes import makes
from tools.campaign.drive.trial import Outcome, run_trial
from tools.campaign.drive.variations import VARIATIONS
from tsa_ctrl.errors import UsageError


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--only", action="append", default=[], metavar="TEXT", help="variations whose name has TEXT")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    parser.add_argument("--list", action="store_true", help="the names of all variations")
    parser.add_argument("--diff", action="store_true", help="what tsa drive diff shows of each make, and nothing else")
    options = parser.parse_args()
    if options.diff:
        for make in makes():
            print(f"{make.name}: {make.short}")
            for difference in make.differences or ():
                print(f"  {difference}")
        return 0
    chosen = [v for v in VARIATIONS if not options.only or any(text in v.name for text in options.only)]
    if options.list:
        print("\n".join(variation.name for variation in VARIATIONS))
        return 0
    if not chosen:
        raise UsageError(f"no variation has '{', '.join(options.only)}' in its name; see --list")
    outcomes = []
    for number, variation in enumerate(chosen, 1):
        if sys.stderr.isatty():
            print(f"\r{number}/{len(chosen)} {variation.name:60.60}", end="\r", file=sys.stderr)
        outcomes.append(run_trial(variation))
    if options.json:
        print(json.dumps({"schema": 1, "variations": [as_dict(outcome) for outcome in outcomes]}))
    else:
        show(outcomes)
    return 0 if all(outcome.good for outcome in outcomes) else 1


def as_dict(outcome: Outcome) -> dict[str, object]:
    variation = outcome.variation
    return {
        "variation": variation.name,
        "quirks": variation.quirks,
        "profile": variation.kind or variation.profile,
        "drive": variation.drive,
        "supervision": variation.supervision,
        "outcome": "runs" if outcome.started else "refused",
        "message": outcome.message,
        "wrong": list(outcome.wrong),
        "good": outcome.good,
    }


def show(outcomes: list[Outcome]) -> None:
    console = Console(width=None if sys.stdout.isatty() else 200)
    table = Table("variation", "lines that mend it", "outcome", "message", show_lines=True)
    for outcome in outcomes:
        word = "runs" if outcome.started else "refused"
        verdict = word if outcome.good else f"[red]{word}: {escape('; '.join(outcome.wrong) or 'not as it must be')}[/]"
        table.add_row(escape(outcome.variation.name), escape(lines(outcome)), verdict, escape(outcome.message))
    console.print(table)
    print(f"{len(outcomes)} variations, {sum(outcome.good for outcome in outcomes)} as they must be")


def lines(outcome: Outcome) -> str:
    """The lines that the variation needs, with the file that they go to."""
    variation = outcome.variation
    parts = [f"profile {variation.kind}"] if variation.kind else []
    for name, keys in (
        ("profile", variation.profile),
        ("drive", variation.drive),
        ("supervision", variation.supervision),
    ):
        parts += [f"{name}: {key} = {json.dumps(value)}" for key, value in keys.items()]
    return "\n".join(parts)


if __name__ == "__main__":
    sys.exit(main())
