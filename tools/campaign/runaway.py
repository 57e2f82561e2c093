"""Detect motion that the controller sustains in five campaigns with the real loop on distributed tendons.

Usage: tools/run campaign/runaway scan      less friction than the file's from the start, one nudge
       tools/run campaign/runaway changes   friction, pretension, bending or the motor change while the loop runs
       tools/run campaign/runaway loss      a sudden loss or a wrong drive, compared with compensation 0
       tools/run campaign/runaway tracking  the torque error of healthy rigs, with --against also of another revision
       tools/run campaign/runaway healthy   an hour without a fault

Each campaign has three sensor configurations: no joint sensor, a joint encoder, or a joint encoder and a torque sensor.
`tools/run campaign/runaway MODE --help` lists the measures, goals and options of a mode.
"""

from __future__ import annotations

import argparse
import functools
from collections.abc import Callable
from types import ModuleType

from tools import command
from tools.campaign.passive import changes, healthy, scan, tracking

Options = Callable[[argparse.ArgumentParser], None]
MODES: dict[str, tuple[ModuleType, Options]] = {
    "scan": (scan, scan.options),
    "changes": (changes, changes.options),
    "loss": (changes, functools.partial(changes.options, loss=True)),
    "tracking": (tracking, tracking.options),
    "healthy": (healthy, healthy.options),
}


def main() -> int:
    parser = command.parser(__name__, __doc__)
    modes = parser.add_subparsers(dest="mode", required=True, metavar="MODE")
    for name, (module, options) in MODES.items():
        mode = modes.add_parser(name, description=module.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
        options(mode)
    chosen = parser.parse_args()
    return int(MODES[chosen.mode][0].run(chosen))
