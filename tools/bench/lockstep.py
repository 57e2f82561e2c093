"""How much faster than real time the loop and the plant run in virtual time.

Usage: tools/run bench/lockstep [--seconds 20] [--rate 1000]
Processor time of this process (not of others on the machine) for the demo's actuator, per cycle and as a multiple of
real time, with the full plant and with distributed tendons of 40 elements; bring-up and shut-down are in it.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from tools import command
from tsa_ctrl.demo import rig
from tsa_ctrl.demo.bus_choice import VIRTUAL
from tsa_ctrl.demo.motion import gait
from tsa_ctrl.virtual.simulation import simulate_loop


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="of torque (default 20)")
    parser.add_argument("--rate", type=float, default=1000.0, help="of the loop, Hz (default 1000)")
    arguments = parser.parse_args()
    table = Table("plant", "load", "us of processor time per cycle", "times real time")
    with tempfile.TemporaryDirectory(prefix="bench-lockstep-") as name:
        folder = Path(name)
        controller = rig.controller(VIRTUAL, "run", arguments.rate, "nominal.toml", 0.95)
        for tendon in ("full", "distributed"):
            for load in ("imposed", "limb"):
                rig.write(folder, gait(), rig.plant(VIRTUAL, tendon, load=load), {"run": controller})
                files = folder / "controller-run.toml", folder / "plant.toml"
                simulate_loop(*files, 0.5)  # compiles, or loads what was compiled before
                begin = time.process_time()
                cycles = simulate_loop(*files, arguments.seconds).summary.sent
                taken = time.process_time() - begin
                table.add_row(tendon, load, f"{1e6 * taken / cycles:.0f}", f"{cycles / arguments.rate / taken:.1f}")
    Console(width=100).print(table)
    return 0
