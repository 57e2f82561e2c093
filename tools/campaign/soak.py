"""A long run on a vcan: does anything grow, does anything get lost.

Usage: tools/run campaign/soak [--seconds 1200] [--axes 1] [--every 5] [--json]

The plant, the daemon with its log writer and socket server, and a client that asks and sets all the time. Memory and
descriptors of each process are sampled; after the first quarter their slope is a straight line through all samples.
Exit code 1: a process' memory grows by more than what its table allows, descriptors were left open, cycles or records
are not accounted for, or the run had a fault.

Needs a vcan: is run under tools/vcan where there is none.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz.part import Holdings
from tools import command
from tools.bench.loop.rig import controller_text, plant_text
from tsa_ctrl.errors import BusError, TsaError
from tsa_ctrl.ipc.client import Client
from tsa_ctrl.ipc.protocol import Set, Status
from tsa_ctrl.system.processes import plant, tsa

START = 120.0  # s until the daemon runs
WARM_UP = 0.25  # share of the run that does not count for the slope
LEAST = 8  # samples for a slope
ALLOWED = 256.0  # KiB/min; the index of the log that its writer keeps takes 82
ALLOWED_IN_ALL = 1024.0  # KiB: less than this over the run is no growth that a short run could tell
NAMES = {"plant": "plant", "run": "daemon", "tsa_ctrl.log.writer": "log writer", "tsa_ctrl.ipc.server": "socket server"}


@dataclass
class Process:
    """What one process held, over time."""

    pid: int
    name: str
    t: list[float] = field(default_factory=list)  # s
    memory: list[float] = field(default_factory=list)  # KiB
    descriptors: list[int] = field(default_factory=list)

    def sample(self, t: float) -> None:
        try:
            found = Holdings.of(self.pid)
        except OSError:
            return
        self.t.append(t)
        self.memory.append(found.memory / 1024)
        self.descriptors.append(found.descriptors)

    def row(self) -> dict[str, Any]:
        first = round(WARM_UP * len(self.t))
        slope = float("nan")
        if len(self.t) - first >= LEAST:
            slope = 60.0 * float(np.polyfit(self.t[first:], self.memory[first:], 1)[0])
        return {
            "process": self.name,
            "samples": len(self.t),
            "memory_first_kib": round(self.memory[first]),
            "memory_last_kib": round(self.memory[-1]),
            "memory_slope_kib_per_min": round(slope, 2),
            "descriptors_first": self.descriptors[first],
            "descriptors_last": self.descriptors[-1],
        }


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--seconds", type=float, default=1200.0)
    parser.add_argument("--axes", type=int, default=1, choices=(1, 2, 4, 8))
    parser.add_argument("--every", type=float, default=5.0, help="s between two samples")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    interface = command.vcan(__name__)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        text = controller_text(folder, interface, options.axes, patient=True)
        (folder / "controller.toml").write_text(text, encoding="utf-8")
        (folder / "plant.toml").write_text(plant_text(interface, options.axes), encoding="utf-8")
        with plant(folder):
            rows, summary, asked = soak(folder, options.seconds, options.every)
    problems = judge(rows, summary)
    if options.json:
        cycles = {**summary["cycles"], "records": summary["log_records"]}
        print(json.dumps({"schema": 1, "processes": rows, "cycles": cycles, "asked": asked, "problems": problems}))
    else:
        show(rows, summary, asked)
        print("\n".join(problems) if problems else f"{options.seconds:g} s: nothing grows, nothing is lost")
    return 1 if problems else 0


def soak(folder: Path, seconds: float, every: float) -> tuple[list[dict[str, Any]], dict[str, Any], int]:
    """Run the daemon in `folder`; rows of the table, its summary, and how often a client asked."""
    verb = tsa("run", "controller.toml", "--seconds", f"{seconds:g}", "--json")
    daemon = subprocess.Popen(verb, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    processes: dict[int, Process] = {}
    begin = due = time.monotonic()
    asked = 0
    try:
        while daemon.poll() is None:
            now = time.monotonic()
            if ask(str(folder / "tsa.sock"), asked):
                asked += 1
            if asked and now >= due:
                due = now + every
                for pid in (*family(os.getpid()), *family(daemon.pid)):
                    name = name_of(pid)
                    if name:
                        processes.setdefault(pid, Process(pid, name)).sample(now - begin)
            if not asked and now > begin + START:
                raise BusError("the daemon does not answer")
            time.sleep(0.1)
    finally:
        daemon.terminate()
        out, err = daemon.communicate(timeout=60)
    if not out:
        raise BusError(f"the daemon ended with {daemon.returncode}: {err.strip()}")
    return [process.row() for process in processes.values()], json.loads(out), asked


def ask(path: str, number: int) -> bool:
    """A status, and every tenth time a value set; False while nobody answers."""
    try:
        with Client(path, timeout=1.0) as client:
            status = client.ask(Status())
            if number % 10 == 9:
                name = status["axes"][0]["name"]
                client.ask(Set(f"{name}.compensation", 0.9 if number % 20 == 9 else 0.95))
    except TsaError:
        return False
    return True


def family(pid: int) -> Sequence[int]:
    """A process' children, by /proc."""
    found = []
    for task in Path(f"/proc/{pid}/task").glob("*"):
        try:
            found += [int(child) for child in (task / "children").read_text(encoding="ascii").split()]
        except OSError:
            continue
    return found


def name_of(pid: int) -> str:
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace").split("\0")
    except OSError:
        return ""
    return next((name for word, name in NAMES.items() if word in words), "")


def judge(rows: Sequence[dict[str, Any]], summary: dict[str, Any]) -> list[str]:
    """What is wrong, one line each."""
    found = []
    missing = set(NAMES.values()) - {row["process"] for row in rows}
    found += [f"{name}: not seen" for name in sorted(missing)]
    for row in rows:
        growth = row["memory_last_kib"] - row["memory_first_kib"]
        if row["memory_slope_kib_per_min"] > ALLOWED and growth > ALLOWED_IN_ALL:
            found.append(f"{row['process']}: memory grows by {row['memory_slope_kib_per_min']:.0f} KiB/min")
        if row["descriptors_last"] > row["descriptors_first"] + 1:  # one may be the client's connection of the moment
            found.append(f"{row['process']}: descriptors {row['descriptors_first']} -> {row['descriptors_last']}")
    cycles, records = summary["cycles"], summary["log_records"]
    if cycles["planned"] != cycles["sent"] + cycles["skipped"]:
        found.append(f"cycles: {cycles['planned']} planned, {cycles['sent']} sent, {cycles['skipped']} skipped")
    axes = len({node["axis"] for node in summary["nodes"]}) if summary["nodes"] else 1
    if records["written"] != axes * cycles["sent"]:
        found.append(f"records: {records['written']} written of {axes * cycles['sent']}, {records['lost']} lost")
    found += [f"fault: {event['text']}" for event in summary["events"] if event["fault"]]
    return found


def show(rows: Sequence[dict[str, Any]], summary: dict[str, Any], asked: int) -> None:
    print(f"{'process':15}{'samples':>8}{'memory, first and last KiB':>30}{'KiB/min':>10}{'descriptors':>16}")
    for row in rows:
        memory = f"{row['memory_first_kib']} -> {row['memory_last_kib']}"
        descriptors = f"{row['descriptors_first']} -> {row['descriptors_last']}"
        slope = f"{row['memory_slope_kib_per_min']:.1f}"
        print(f"{row['process']:15}{row['samples']:8}{memory:>30}{slope:>10}{descriptors:>16}")
    cycles, records = summary["cycles"], summary["log_records"]
    print(
        f"cycles at {summary['rate']:g} Hz: {cycles['planned']} planned, {cycles['sent']} sent, {cycles['skipped']} "
        f"skipped; records {records['written']} written, {records['lost']} lost; {asked} questions of a client"
    )
