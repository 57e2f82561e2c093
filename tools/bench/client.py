"""How long a set-point takes from its client to the drive's RPDO, in periods of the loop.

Usage: tools/run bench/client [--bus INTERFACE:CHANNEL] [--rate 0] [--client-rate 500] [--seconds 20] [--json]

Plant, daemon, a client that streams set-points (`tsa_ctrl.Client`), and a witness on the bus are processes of this
machine; the bus is the best that `tsa demo` would find. The client changes the sign of its torque at random times; the
witness takes the time of the first RPDO that shows it. What the witness is late itself is in the figure. Three times:
alone, beside a client that asks for the status and sets a parameter without end, and beside four of them.

A value that just misses a cycle's RPDO goes with the next one: half a period in the mean, one at most. Beyond that
there is the time of a cycle from its begin to its RPDO, printed as "cycle" (its p99 by the daemon's own histogram), and
what client, socket, its server and witness wait for a processor. Exit code 1 when the p99 alone is more than one period
beyond the cycle.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tools import command
from tsa_ctrl import Client
from tsa_ctrl.bus.settings import BusSettings
from tsa_ctrl.bus.wire.link import open_bus
from tsa_ctrl.cli.init import with_values
from tsa_ctrl.demo.rig import BusChoice, choose
from tsa_ctrl.errors import BusError
from tsa_ctrl.ipc import protocol
from tsa_ctrl.system.process_supervisor import plant, tsa

COMMANDS = 0x201  # RPDO 1 of node 1: controlword, target torque
TORQUE = 0.1  # N*m at the joint, either way
APART = (10.0, 15.0)  # periods between two changes
FLOODS = (0, 1, 4)
SLOW, FAST = 250.0, 1000.0  # Hz of the loop, over UDP multicast and on a CAN interface
STARTED = 120.0  # s: the first start of a machine compiles
ABOVE = 90  # priority of the witness, above the loop's
SETTLED = 2.0  # s of torque before anything counts


@dataclass(frozen=True)
class Figures:
    """Latencies in periods."""

    floods: int
    changes: int
    p50: float
    p99: float
    worst: float


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--bus", help="a CAN interface, or INTERFACE:CHANNEL of python-can")
    parser.add_argument("--rate", type=float, default=0.0, help=f"Hz of the loop; 0: {FAST:g}, without CAN {SLOW:g}")
    parser.add_argument("--client-rate", type=float, default=500.0, help="Hz of set-points (default 500)")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each of the three (default 20)")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--stream", help=argparse.SUPPRESS)  # this process is the client: its socket
    parser.add_argument("--flood", help=argparse.SUPPRESS)  # this process is one that floods
    options = parser.parse_args()
    if options.stream:
        return stream(options.stream, options.client_rate, options.rate, options.seconds)
    if options.flood:
        return flood(options.flood)
    bus = choose(options.bus)
    rate = options.rate or (FAST if bus.interface == "socketcan" else SLOW)
    with tempfile.TemporaryDirectory(prefix="bench-client-") as name:
        cycle, figures = measure(Path(name), bus, rate, options.client_rate, options.seconds)
    if options.json:
        found = {"schema": 1, "rate": rate, "client_rate": options.client_rate, "cycle": cycle}
        print(json.dumps({**found, "latency": [vars(each) for each in figures]}))
    else:
        print(f"{bus.name}, loop {rate:g} Hz, client {options.client_rate:g} Hz, cycle {cycle:.2f}; in periods:")
        print("\n".join(table(figures)))
    return 0 if figures[0].p99 <= 1.0 + cycle else 1


def table(figures: Sequence[Figures]) -> list[str]:
    """A line for each, below a head."""
    lines = [f"{'beside':22}{'p50':>8}{'p99':>8}{'worst':>8}{'changes':>9}"]
    for each in figures:
        words = f"{each.floods} that flood{'s' if each.floods == 1 else ''}" if each.floods else "nobody"
        lines.append(f"{words:22}{each.p50:8.2f}{each.p99:8.2f}{each.worst:8.2f}{each.changes:9}")
    return lines


def measure(
    folder: Path, bus: BusChoice, rate: float, client_rate: float, seconds: float
) -> tuple[float, list[Figures]]:
    """A cycle's time to its RPDO, and latencies beside each number of floods; all in periods."""
    write(folder, bus, rate)
    path = str(folder / "tsa.sock")
    with plant(folder), daemon(folder, path):
        figures = [beside(number, path, bus, rate, client_rate, seconds) for number in FLOODS]
        with Client(path) as client:
            work = client.ask(protocol.Status())["work"]["p99"]
    return (work or 0.0) * rate, figures


def write(folder: Path, bus: BusChoice, rate: float) -> None:
    """The example files without anything that would smooth a step: its sign is in the RPDO of its cycle."""
    where = {"interface": f'"{bus.interface}"', "channel": f'"{bus.channel}"'}
    changes: dict[str, dict[str, dict[str, str]]] = {
        "controller.toml": {
            "controller": {"rate": str(rate)},
            "bus": where,
            "bus.supervision": {"tolerated_misses": "50", "tolerated_drops": "50", "lost_share": "0.5"},
            "realtime": {"allow_without": "true"},
            "log": {"enabled": "false"},
            "socket": {"path": f'"{folder / "tsa.sock"}"'},
            "axis.drive": {"host_timeout": "1.0", "rpdo_timeout": "0.5", "heartbeat_timeout": "1.0"},
            "axis.setpoint": {"kind": '"socket"', "rate": "10000.0"},
            "axis.law": {"compensation": "0.0", "fade_in": "0.2"},
            "axis.limits": {"rate": "10000.0"},
        },
        "plant.toml": {"bus": where, "axis.joint": {"load": '"held"'}},
    }
    for name, tables in changes.items():
        text = with_values((command.CONFIG / name).read_text(encoding="utf-8"), tables)
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "actuator.toml").write_bytes((command.CONFIG / "actuator.toml").read_bytes())


@contextlib.contextmanager
def daemon(folder: Path, path: str) -> Iterator[None]:
    """`tsa run`, with torque, as a process.

    Raises:
        BusError: it did not come up, or what was asked of it failed: with what it said last.
    """
    said = folder / "errors.txt"
    errors = said.open("w")
    process = subprocess.Popen(tsa("run", "controller.toml"), cwd=folder, stdout=subprocess.DEVNULL, stderr=errors)
    try:
        end = time.monotonic() + STARTED
        while not running(path):
            if process.poll() is not None or time.monotonic() > end:
                raise BusError("it did not come up")
            time.sleep(0.1)
        time.sleep(SETTLED)
        yield
    except BusError as error:
        lines = said.read_text(encoding="utf-8", errors="replace").splitlines()
        raise BusError(f"{error}; the daemon said last: {lines[-1] if lines else 'nothing'}") from None
    finally:
        process.terminate()
        process.wait(30.0)
        errors.close()


def running(path: str) -> bool:
    try:
        with Client(path) as client:
            return client.measure().phase == "running"
    except BusError:
        return False


def beside(floods: int, path: str, bus: BusChoice, rate: float, client_rate: float, seconds: float) -> Figures:
    """Changes of a client's sign, and when the bus shows them."""
    own = [sys.executable, str(command.ROOT / "tools"), command.name_of(__name__)]
    with contextlib.ExitStack() as stack:
        for _ in range(floods):
            process = subprocess.Popen([*own, "--flood", path])
            stack.callback(process.wait)
            stack.callback(process.kill)
        asked = ["--rate", str(rate), "--client-rate", str(client_rate), "--seconds", str(seconds)]
        client = subprocess.Popen([*own, "--stream", path, *asked], stdout=subprocess.PIPE, text=True)
        seen = witness(bus, client)
        assert client.stdout is not None
        changes = json.loads(client.stdout.read() or "[]")
    latencies = [found * rate for found in matched(changes, seen)]
    if not latencies:
        raise BusError("no change of the set-point was seen on the bus; is there torque?")
    p50, p99, worst = np.quantile(latencies, (0.5, 0.99, 1.0), method="inverted_cdf").tolist()
    return Figures(floods, len(latencies), p50, p99, worst)


def witness(bus: BusChoice, client: subprocess.Popen[str]) -> list[tuple[float, int]]:
    """Time (s) and sign of every command on the bus, until the client has ended."""
    listening = open_bus(BusSettings(interface=bus.interface, channel=bus.channel))
    seen = []
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(ABOVE))
        listening.accept((COMMANDS,))
        while client.poll() is None:
            frame = listening.recv(0.05)
            if frame is not None and frame[0] == COMMANDS and len(frame[1]) == 4:
                torque = int.from_bytes(frame[1][2:4], "little", signed=True)
                seen.append((time.monotonic(), (torque > 0) - (torque < 0)))
    finally:
        os.sched_setscheduler(0, *before)
        listening.close()
    return seen


def matched(changes: list[tuple[float, int]], seen: list[tuple[float, int]]) -> Iterator[float]:
    """s from each change to the first command that shows it before the next change; one that is not shown is inf."""
    times = np.array([at for at, _ in seen])
    for (at, sign), (following, _) in itertools.pairwise(changes):
        later = seen[int(np.searchsorted(times, at)) :]
        shown = next((when for when, found in later if found == sign), None)
        yield float("inf") if shown is None or shown > following else shown - at


def stream(path: str, client_rate: float, rate: float, seconds: float) -> int:
    """The client: set-points at its rate, whose sign changes at random; prints when, and to what."""
    draw = random.Random(1)
    changes: list[Any] = []
    with Client(path) as client, client.lease(1.0) as lease:
        begin = due = change = time.monotonic()
        sign = 1
        while due - begin < seconds:
            now = time.monotonic()
            if now >= change:
                sign = -sign
                change = now + draw.uniform(*APART) / rate
                changes.append((now, sign))
            lease.send({"knee": TORQUE * sign}, now)
            due = max(due + 1.0 / client_rate, now)
            time.sleep(max(0.0, min(due, change) - time.monotonic()))
    print(json.dumps(changes))
    return 0


def flood(path: str) -> int:
    """A client without manners."""
    with Client(path) as client:
        while True:
            client.ask(protocol.Status())
            client.ask(protocol.Set("knee.compensation", 0.0))
