"""Measure the latency of a set-point from its client to the RPDO of the drive, in periods of the loop.

Usage: tools/run bench/client [--bus INTERFACE:CHANNEL] [--seconds 20] [--json]

Plant, daemon, a client that streams set-points (`tsa_ctrl.Client`), and a bus listener ("witness") run as processes of
this machine, on the bus that `tsa demo` would choose. The client changes the sign of its torque at random times. The
witness records the time of the first RPDO with the new sign. There are three runs: without other clients, with one
client that continuously requests the status and sets a parameter, and with four such clients.

A value that just misses the RPDO of a cycle is sent with the next one, which adds half a period on average and at most
one. The latency also contains the scheduling latency of client, socket server and witness, and the time from the start
of a cycle to its RPDO. This time is printed as "cycle" (p99 of the daemon's histogram). The exit code is 1 if the p99
without other clients exceeds the cycle by more than one period.
"""

from __future__ import annotations

import contextlib
import itertools
import multiprocessing
import os
import random
import subprocess
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from pathlib import Path

import numpy as np

from tools import command
from tools.command import Row
from tsa_ctrl import Client
from tsa_ctrl.bus.settings import BusSettings
from tsa_ctrl.bus.wire.link import open_bus
from tsa_ctrl.cli.init import with_values
from tsa_ctrl.demo.rig import BusChoice, choose
from tsa_ctrl.errors import BusError
from tsa_ctrl.ipc import protocol
from tsa_ctrl.system.process_supervisor import end_process, plant, tsa

COMMANDS = 0x201  # RPDO 1 of node 1: controlword, target torque
TORQUE = 0.1  # N*m at the joint, with both signs
APART = (10.0, 15.0)  # range of the number of periods between two changes of the sign
FLOODS = (0, 1, 4)  # numbers of other clients
SLOW, FAST = 250.0, 1000.0  # Hz of the loop, over UDP multicast and on a CAN interface
CLIENT = 500.0  # Hz of the set-points
STARTED = 120.0  # s for the daemon to start, because the first start on a machine compiles
ABOVE = 90  # priority of the witness, higher than the loop's priority
SETTLED = 2.0  # s of torque before the measurement
SPAWN = multiprocessing.get_context("spawn")  # a fork would share the sockets

Changes = list[tuple[float, int]]  # s, sign


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--bus", help="a CAN interface, or INTERFACE:CHANNEL of python-can")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each of the three (default 20)")
    command.share(parser, "json")
    options = parser.parse_args()
    bus = choose(options.bus)
    rate = FAST if bus.interface == "socketcan" else SLOW
    with tempfile.TemporaryDirectory(prefix="bench-client-") as name:
        folder = Path(name)
        write(folder, bus, rate)
        path = str(folder / "tsa.sock")
        with plant(folder), daemon(folder, path):
            rows = [beside(number, path, bus, rate, options.seconds) for number in FLOODS]
            with Client(path) as client:
                cycle = (client.ask(protocol.Status())["work"]["p99"] or 0.0) * rate
    if not options.json:
        print(f"{bus.name}, loop {rate:g} Hz, client {CLIENT:g} Hz, cycle {cycle:.2f}; in periods:")
    keys = ("beside", "p50", "p99", "worst", "changes")
    lines = ([row[key] for key in keys] for row in rows)
    command.print_tables(rows, options, lambda: [command.table(("other clients", *keys[1:]), lines)])
    return 0 if rows[0]["p99"] <= 1.0 + cycle else 1


def write(folder: Path, bus: BusChoice, rate: float) -> None:
    """Write the example files without smoothing, so that the RPDO of the same cycle has the sign of a set-point."""
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
    """Run `tsa run` with torque as a process.

    Raises:
        BusError: The daemon does not reach the phase "running". The message has its last line.
    """
    with (folder / "errors.txt").open("w+") as errors:
        process = subprocess.Popen(tsa("run", "controller.toml"), cwd=folder, stdout=subprocess.DEVNULL, stderr=errors)
        try:
            end = time.monotonic() + STARTED
            while not running(path):
                if process.poll() is not None or time.monotonic() > end:
                    errors.seek(0)
                    raise BusError(f"the daemon did not come up: {(errors.read().splitlines() or [''])[-1]}")
                time.sleep(0.1)
            time.sleep(SETTLED)
            yield
        finally:
            end_process(process, 30.0)


def running(path: str) -> bool:
    """Return True if the daemon is in the phase "running"."""
    try:
        with Client(path) as client:
            return client.measure().phase == "running"
    except BusError:
        return False


def beside(floods: int, path: str, bus: BusChoice, rate: float, seconds: float) -> Row:
    """Return the latency quantiles of one run, in periods, while `floods` other clients send requests."""
    flooding = [SPAWN.Process(target=flood, args=(path,), daemon=True) for _ in range(floods)]
    for process in flooding:
        process.start()
    with ProcessPoolExecutor(1, SPAWN) as pool:
        client = pool.submit(stream, path, rate, seconds)
        seen = witness(bus, client)
    for process in flooding:
        process.kill()
    latencies = [found * rate for found in matched(client.result(), seen)]
    if not latencies:
        raise BusError("no change of the set-point was seen on the bus; is there torque?")
    p50, p99, worst = np.quantile(latencies, (0.5, 0.99, 1.0), method="inverted_cdf").tolist()
    words = f"{floods} that flood{'s' if floods == 1 else ''}" if floods else "nobody"
    return {"beside": words, "p50": p50, "p99": p99, "worst": worst, "changes": len(latencies)}


def witness(bus: BusChoice, client: Future[Changes]) -> Changes:
    """Return time (s) and sign of every torque command on the bus until the client has ended."""
    listening = open_bus(BusSettings(interface=bus.interface, channel=bus.channel))
    seen = []
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(ABOVE))
        listening.accept((COMMANDS,))
        while not client.done():
            frame = listening.recv(0.05)
            if frame is not None and frame[0] == COMMANDS and len(frame[1]) == 4:
                torque = int.from_bytes(frame[1][2:4], "little", signed=True)
                seen.append((time.monotonic(), (torque > 0) - (torque < 0)))
    finally:
        os.sched_setscheduler(0, *before)
        listening.close()
    return seen


def matched(changes: Changes, seen: Changes) -> Iterator[float]:
    """Yield the time from each change to the first command with its sign, s, or inf if the next change comes first."""
    times = np.array([at for at, _ in seen])
    for (at, sign), (following, _) in itertools.pairwise(changes):
        later = seen[int(np.searchsorted(times, at)) :]
        shown = next((when for when, found in later if found == sign), None)
        yield float("inf") if shown is None or shown > following else shown - at


def stream(path: str, rate: float, seconds: float) -> Changes:
    """Send set-points whose sign changes at random times, and return the times and signs of the changes."""
    draw = random.Random(1)
    changes: Changes = []
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
            due = max(due + 1.0 / CLIENT, now)
            time.sleep(max(0.0, min(due, change) - time.monotonic()))
    return changes


def flood(path: str) -> None:
    """Request the status and set a parameter in an endless loop."""
    with Client(path) as client:
        while True:
            client.ask(protocol.Status())
            client.ask(protocol.Set("knee.compensation", 0.0))
