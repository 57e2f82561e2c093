"""Run plant and daemon on a vcan for a long time, and detect growing processes and lost cycles or records.

Usage: tools/run bench/soak [--seconds 1200] [--axes 1] [--json]

A client continuously requests the status and sets a value. Memory and descriptors of plant, daemon, log writer and
socket server are sampled, and the slope of the memory is fitted after the first quarter. The exit code is 1 if the
memory of a process grows, descriptors stay open, cycles or records are missing, or the run had a fault.

Without a vcan the command runs itself under tools/vcan.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.fuzz.part import Holdings
from tools import command
from tools.bench.loop.rig import controller_text, plant_text
from tools.command import Row
from tsa_ctrl.errors import BusError, TsaError
from tsa_ctrl.ipc.client import Client
from tsa_ctrl.ipc.protocol import Set, Status
from tsa_ctrl.system.process_supervisor import end_process, plant, tsa

START = 120.0  # s for the daemon to start
EVERY = 5.0  # s between two samples
WARM_UP = 0.25  # share of the run that is excluded from the slope
ALLOWED = 256.0  # KiB/min; the index of the log alone grows by 82 KiB/min in the log writer
ALLOWED_IN_ALL = 1024.0  # KiB over the run; smaller growth is not significant in a short run
NAMES = {"plant": "plant", "run": "daemon", "tsa_ctrl.log.writer": "log writer", "tsa_ctrl.ipc.server": "socket server"}
KEYS = ("process", "samples", "first_kib", "last_kib", "kib_per_min", "descriptors_first", "descriptors_last")

Samples = dict[str, list[tuple[float, float, int]]]  # of each process: s, KiB, open descriptors


def soak(folder: Path, seconds: float) -> tuple[Samples, Row]:
    """Run the daemon in `folder`, and return the samples of each process and the summary of the run."""
    line = tsa("run", "controller.toml", "--seconds", f"{seconds:g}", "--json")
    daemon = subprocess.Popen(line, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    samples: Samples = {}
    begin = due = time.monotonic()
    asked = 0
    try:
        while daemon.poll() is None:
            now = time.monotonic()
            asked += ask(str(folder / "tsa.sock"), asked)
            if asked and now >= due:
                due = now + EVERY
                for pid in command.family(os.getpid()):
                    words = Path(f"/proc/{pid}/cmdline")
                    name = next((NAMES[word] for word in words.read_text().split("\0") if word in NAMES), "")
                    if name:
                        held = Holdings.of(pid)
                        samples.setdefault(name, []).append((now - begin, held.memory / 1024, held.descriptors))
            if not asked and now > begin + START:
                raise BusError("the daemon does not answer")
            time.sleep(0.1)
    except FileNotFoundError:
        daemon.communicate(timeout=60)  # a process ended between two samples, so the run is over
    finally:
        end_process(daemon)
    out, err = daemon.communicate()
    if not out:
        raise BusError(f"the daemon ended with {daemon.returncode}: {err.strip()}")
    return samples, json.loads(out)


def ask(path: str, number: int) -> bool:
    """Request the status, and every tenth time set a value. Return False while no daemon answers."""
    try:
        with Client(path, timeout=1.0) as client:
            status = client.ask(Status())
            if number % 10 == 9:
                client.ask(Set(f"{status['axes'][0]['name']}.compensation", 0.9 if number % 20 == 9 else 0.95))
    except TsaError:
        return False
    return True


def row_of(name: str, samples: list[tuple[float, float, int]]) -> Row:
    """Return memory and descriptors of a process after the first quarter and at the end, and the memory's slope."""
    kept = samples[round(WARM_UP * len(samples)) :]
    t, memory, _ = zip(*kept, strict=True)
    slope = 60.0 * float(np.polyfit(t, memory, 1)[0]) if len(kept) > 1 else 0.0
    return dict(zip(KEYS, (name, len(samples), memory[0], memory[-1], slope, kept[0][2], kept[-1][2]), strict=True))


def problems(rows: list[Row], summary: Row, axes: int) -> list[str]:
    """Return the problems of the run, one line each."""
    found = [f"{name}: not seen" for name in sorted(set(NAMES.values()) - {row["process"] for row in rows})]
    for row in rows:
        if row["kib_per_min"] > ALLOWED and row["last_kib"] - row["first_kib"] > ALLOWED_IN_ALL:
            found.append(f"{row['process']}: memory grows by {row['kib_per_min']:.0f} KiB/min")
        if row["descriptors_last"] > row["descriptors_first"] + 1:  # one may be the present connection of the client
            found.append(f"{row['process']}: descriptors {row['descriptors_first']} -> {row['descriptors_last']}")
    cycles, records = summary["cycles"], summary["log_records"]
    if cycles["planned"] != cycles["sent"] + cycles["skipped"]:
        found.append(f"cycles: {cycles['planned']} planned, {cycles['sent']} sent, {cycles['skipped']} skipped")
    if records["written"] != axes * cycles["sent"]:
        found.append(f"records: {records['written']} written of {axes * cycles['sent']}, {records['lost']} lost")
    return found + [f"fault: {event['text']}" for event in summary["events"] if event["fault"]]


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--seconds", type=float, default=1200.0)
    parser.add_argument("--axes", type=int, default=1, choices=(1, 2, 4, 8))
    command.share(parser, "json")
    options = parser.parse_args()
    interface = command.vcan(__name__)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "controller.toml").write_text(controller_text(folder, interface, options.axes, patient=True))
        (folder / "plant.toml").write_text(plant_text(interface, options.axes))
        with plant(folder):
            samples, summary = soak(folder, options.seconds)
    rows = [row_of(*each) for each in samples.items()]
    wrong = problems(rows, summary, options.axes)
    command.show(rows, KEYS, options.json)
    print(f"cycles {summary['cycles']}, records {summary['log_records']}")
    print("\n".join(wrong) or f"{options.seconds:g} s: nothing grows, nothing is lost")
    return int(bool(wrong))
