"""Every cycle of a run accounted for, beside a witness that only sleeps to absolute deadlines.

Usage: tools/run bench/accounts [--axes 1] [--seconds 30] [--rate 0] [--plant] [--json]

The nodes, the daemon's loop with its log writer and socket server, and the witness are processes on one vcan. The
nodes are those of `tsa bench`, or those of the plant (--plant), whose mechanics need most of a period. A cycle is sent
(its SYNC went out), skipped (an overrun took its period), late (it began after half of its period), and it has lost
TPDOs or not. The witness wakes twice per period at a higher priority than all others; it is late in a cycle when it
woke more than a fifth of the period after a deadline in it. TPDOs may be lost only in cycles in which the witness was
late: exit code 1 when that does not hold.

Needs a vcan: is run under tools/vcan where there is none. --rate 0: 1000 Hz, or as much as the bit rate carries.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tools import command
from tools.bench.loop.blocks import nodes
from tools.bench.loop.rig import controller_text, plant_text
from tsa_ctrl.config import load_configuration
from tsa_ctrl.daemon.run import run
from tsa_ctrl.log.reader import LogFile
from tsa_ctrl.system.processes import plant

PER_PERIOD = 2  # wake-ups of the witness in a cycle
WRITTEN = 60.0  # s in which the witness writes down what it saw
LATE = 0.2  # of the period: a wake-up later than this is late


@contextlib.contextmanager
def beside(*arguments: str) -> Iterator[None]:
    """The witness as a process, from its word that it is ready to its end, which follows that of its stdin."""
    verb = command.process("tools.bench.loop.witness", *arguments)
    process = subprocess.Popen(verb, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    try:
        yield
    finally:
        process.communicate(timeout=WRITTEN)


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--axes", type=int, default=1, choices=(1, 2, 4, 8))
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--rate", type=float, default=0.0, help="Hz; 0: as much of 1000 as the bit rate carries")
    parser.add_argument("--plant", action="store_true", help="nodes with mechanics, brought up by SDO")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    interface = command.vcan(__name__)
    with tempfile.TemporaryDirectory() as folder:
        found = account(Path(folder), interface, options)
    if options.json:
        print(json.dumps({"schema": 1, "axes": options.axes, **found}))
    else:
        for key, value in found.items():
            print(f"{key.replace('_', ' '):44} {value}")
    return 0 if found["lost_while_the_witness_was_in_time"] == 0 and not found["unaccounted"] else 1


def account(folder: Path, interface: str, options: argparse.Namespace) -> dict[str, Any]:
    """Run for some seconds of torque and count."""
    controller = folder / "controller.toml"
    controller.write_text(controller_text(folder, interface, options.axes, options.rate, patient=True), "utf-8")
    (folder / "plant.toml").write_text(plant_text(interface, options.axes), encoding="utf-8")
    configuration = load_configuration(controller)
    rate = configuration.file.controller.rate
    witness = beside(str(PER_PERIOD * rate), str(folder / "witness.npy"))
    if options.plant:
        with plant(folder), witness:
            summary = run(configuration, options.seconds).as_dict()
    else:
        with nodes(configuration), witness:
            summary = run(configuration, options.seconds, configured=True).as_dict()
    log = LogFile(Path(summary["log"]))
    tables = [log.columns(axis, ("cycle", "missed", "lateness")) for axis in log.axes]
    return judge(summary, tables, np.load(folder / "witness.npy"), 1.0 / rate)


def judge(summary: dict[str, Any], axes: list[dict[str, Any]], witnessed: Any, period: float) -> dict[str, Any]:
    """Match the cycles of the log with the witness' wake-ups."""
    first = axes[0]
    cycle = first["cycle"].astype(int)
    missed = sum(np.diff(axis["missed"], prepend=0.0) > 0.0 for axis in axes)
    late = first["lateness"] > 0.5 * period
    deadline, lateness = witnessed
    number = np.floor((deadline - summary["start"]) / period).astype(int)
    count = int(cycle[-1]) + 1
    stalled = np.zeros(count, dtype=bool)
    for at in np.flatnonzero((lateness > LATE * period) & (number < count)):
        end = int(np.floor((deadline[at] + lateness[at] - summary["start"]) / period))
        stalled[max(0, number[at]) : max(0, end + 1)] = True
    lost = cycle[missed > 0]
    cycles = summary["cycles"]
    return {
        "rate": summary["rate"],
        "planned": cycles["planned"],
        "sent": cycles["sent"],
        "skipped": cycles["skipped"],
        "unaccounted": cycles["planned"] - cycles["sent"] - cycles["skipped"],
        "recorded": len(cycle),
        "begun_late": int(np.count_nonzero(late)),
        "with_lost_tpdos": len(lost),
        "in_which_the_witness_was_late": int(np.count_nonzero(stalled)),
        "lost_while_the_witness_was_late": int(np.count_nonzero(stalled[lost])),
        "lost_while_the_witness_was_in_time": int(np.count_nonzero(~stalled[lost])),
        "witness_lateness_p50_us": round(float(np.median(lateness)) * 1e6, 1),
        "witness_lateness_p99_us": round(float(np.quantile(lateness, 0.99)) * 1e6, 1),
        "lateness_p50_us": round(float(np.median(first["lateness"])) * 1e6, 1),
        "lateness_p99_us": round(float(np.quantile(first["lateness"], 0.99)) * 1e6, 1),
        "faults": [event["text"] for event in summary["events"] if event["fault"]],
    }
