"""Compare one axis with several lean axes at 1 kHz on one bus or two: skipped periods, missed answers, faults.

Usage: tools/run bench/axes [--seconds 10] [--rate 1000] [--rounds 3] [--interface NAME] [--virtual]

The first rig has one axis with standard PDOs. The next two have two axes with lean drives and encoders, without and
with torque sensors. The last one has four such axes without torque sensors on two buses. Plant and daemon run as two
processes on a bus of local sockets ("datagram") or on UDP multicast. Each round runs all rigs one after another, so
that the load of the machine affects them equally. With --virtual they run in virtual time on a bus with its real bit
rate.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from tools import command
from tsa_ctrl import simulate_loop
from tsa_ctrl.demo import rig
from tsa_ctrl.demo.rig import gait

RIGS = {  # axes, pdo, torque sensors, buses
    "1 axis, standard": (1, "standard", True, 1),
    "2 axes, lean, encoders": (2, "lean", False, 1),
    "2 axes, lean, encoders and torque sensors": (2, "lean", True, 1),
    "4 axes, lean, encoders, on 2 buses": (4, "lean", False, 2),
}
READY = "plant: ready"
Files = tuple[Path, Path]


def write(folder: Path, rate: float, interface: str, axes: int, pdo: str, torque_sensors: bool, buses: int) -> Files:
    """Write the files of one rig, and return the paths of controller and plant."""
    bus = rig.BusChoice(interface, _channel(interface))
    plant, controller = rig.plant(bus, "full"), rig.controller(bus, "axes", rate, "nominal.toml", 0.95)
    controller["socket"] = {"path": str(folder / "axes.sock")}
    (body,), (axis,) = plant["axis"], controller["axis"]
    plant["axis"] = [body | {"name": f"joint{number}"} for number in range(axes)]
    controller["axis"] = [_axis(axis, number, pdo, torque_sensors) for number in range(axes)]
    if buses > 1:
        channels = [_channel(interface, number) for number in range(buses)]
        for tables in (plant, controller):
            tables["bus"] = [tables["bus"] | {"name": f"bus{n}", "channel": name} for n, name in enumerate(channels)]
            for number, each in enumerate(tables["axis"]):
                each["bus"] = f"bus{number % buses}"
    rig.write(folder, gait(), plant, {"axes": controller})
    return folder / "controller-axes.toml", folder / "plant.toml"


def _channel(interface: str, number: int = 0) -> str:
    """Return a bus channel that is unlikely to collide with another run."""
    return "239.255.{}.{}".format(*os.urandom(2)) if interface == "udp_multicast" else f"axes-{os.getpid()}-{number}"


def _axis(axis: dict[str, Any], number: int, pdo: str, torque_sensors: bool) -> dict[str, Any]:
    nodes = {"drive": 1, "encoder": 32, "torque_sensor": 64}
    found = axis | {name: axis[name] | {"node_id": first + number} for name, first in nodes.items()}
    found["name"] = f"joint{number}"
    found["drive"] |= {"pdo": pdo, "serial_number": 1 + number}
    if not torque_sensors:
        del found["torque_sensor"]
    return found


def natively(files: Files, seconds: float) -> dict[str, Any]:
    """Run plant and daemon as processes, and return the daemon's summary."""
    tsa = [sys.executable, "-m", "tsa_ctrl"]
    nodes = [*tsa, "plant", str(files[1])]
    with subprocess.Popen(nodes, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as plant:
        try:
            assert plant.stdout is not None
            if not any(line.startswith(READY) for line in plant.stdout):
                raise RuntimeError(f"{files[1]}: the plant did not start")
            run = [*tsa, "run", str(files[0]), "--seconds", str(seconds), "--json"]
            done = subprocess.run(run, capture_output=True, text=True, check=False)
            if not done.stdout:
                raise RuntimeError(done.stderr.strip())
            found: dict[str, Any] = json.loads(done.stdout)
            return found
        finally:
            plant.terminate()


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--interface", choices=("datagram", "udp_multicast"), default="datagram")
    parser.add_argument("--virtual", action="store_true")
    options = parser.parse_args()
    lines: list[tuple[object, ...]] = []
    for number in range(1 if options.virtual else options.rounds):
        for name, shape in RIGS.items():
            with tempfile.TemporaryDirectory() as folder:
                files = write(Path(folder), options.rate, options.interface, *shape)
                if options.virtual:
                    found = simulate_loop(*files, options.seconds).summary.as_dict()
                else:
                    found = natively(files, options.seconds)
            cycles = found["cycles"]
            faults = sum(1 for event in found["events"] if event["fault"])
            planned = cycles["planned"]
            share = f"{cycles['skipped']} ({100 * cycles['skipped'] / max(1, planned):.2f} %)"
            work = found["work"]["p50"]
            lines.append((name, number + 1, planned, share, cycles["missed_pdo"], faults, work))
    command.print_table(("rig", "round", "planned", "skipped", "missed", "faults", "work"), lines)
    return 0
