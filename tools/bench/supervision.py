"""What supervision, guard and read-back cost a cycle, beside everything else that the loop does in it.

Usage: tools/run bench/supervision [--seconds 10] [--rate 1000] [--load limb] [--json]

The daemon's loop on the full plant in virtual time, with time stamps around what watches: supervisor, limiter,
plausibility with what motor and joint are apart by, sense of the torque, energy guard, commands that were not heard,
and the read-back (questions and answers). Bus and plant are taken off, and so is what the stamps cost. Each figure is
the mean of all cycles with torque but for the slowest hundredth (stalls of the machine). Two shares: of all that the
loop computes in a cycle, both from the same run, and of the period.
"""

from __future__ import annotations

import contextlib
import json
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from tools import command
from tsa_ctrl.bus.live.read_back import ReadBack
from tsa_ctrl.control import cycle
from tsa_ctrl.daemon import loop
from tsa_ctrl.demo import rig
from tsa_ctrl.demo.motion import gait
from tsa_ctrl.demo.rig import VIRTUAL
from tsa_ctrl.safety.guard import Guard
from tsa_ctrl.safety.limiter import Limiter
from tsa_ctrl.safety.plausibility import Plausibility
from tsa_ctrl.safety.sense import Sense
from tsa_ctrl.safety.supervisor import Supervisor
from tsa_ctrl.safety.unheard import Unheard
from tsa_ctrl.virtual.lockstep import End, HostEnd
from tsa_ctrl.virtual.simulation import simulate_loop

BUS = "bus and plant"
PARTS: dict[str, tuple[tuple[type, str], ...]] = {
    "supervisor": ((Supervisor, "update"),),
    "limiter": ((Limiter, "update"),),
    "plausibility": ((Plausibility, "update"),),
    "sense": ((Sense, "update"),),
    "guard": ((Guard, "update"), (Guard, "pass_over")),
    "commands unheard": ((Unheard, "update"),),
    "read-back": ((ReadBack, "update"), (ReadBack, "answer")),
    BUS: ((End, "send"), (HostEnd, "recv"), (HostEnd, "gather"), (HostEnd, "answers")),
}
KEPT = 0.99  # of the cycles: the slowest are the machine's


class Stamps:
    """Time in each part, us, a row a cycle; what a part calls of another part counts there."""

    def __init__(self) -> None:
        self.rows: list[dict[str, float]] = []
        self._inside: list[float] = []  # s of the parts inside of each that runs, and of what their stamps cost
        self._row: dict[str, float] = {}
        self._cost = statistics.median(-(time.perf_counter() - time.perf_counter()) for _ in range(1000))

    def timed(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def stamped(*arguments: Any) -> Any:
            self._inside.append(self._cost)
            begin = time.perf_counter()
            try:
                return function(*arguments)
            finally:
                taken = time.perf_counter() - begin
                self._row[name] = self._row.get(name, 0.0) + 1e6 * (taken - self._inside.pop())
                if self._inside:
                    self._inside[-1] += taken + self._cost

        return stamped

    def cycle(self, first: Callable[..., Any]) -> Callable[..., Any]:
        """`first` begins a new row."""
        inner = self.timed("the rest", first)

        def begun(*arguments: Any) -> Any:
            self._row = {}
            self.rows.append(self._row)
            return inner(*arguments)

        return begun


@contextlib.contextmanager
def stamped() -> Iterator[Stamps]:
    """Stamps around all parts, taken away afterwards."""
    stamps = Stamps()
    with contextlib.ExitStack() as stack:

        def put(owner: Any, name: str, value: Any) -> None:
            stack.callback(setattr, owner, name, getattr(owner, name))
            setattr(owner, name, value)

        for part, places in PARTS.items():
            for owner, name in places:
                put(owner, name, stamps.timed(part, getattr(owner, name)))
        put(loop, "run_cycle", stamps.cycle(cycle.run_cycle))
        put(loop, "follow_up", stamps.timed("the rest", cycle.follow_up))
        yield stamps


def measured(seconds: float, rate: float, load: str) -> tuple[dict[str, float], int]:
    """us of a cycle by part, and how many cycles are behind it."""
    with tempfile.TemporaryDirectory(prefix="bench-supervision-") as name:
        folder = Path(name)
        controller = rig.controller(VIRTUAL, "run", rate, "nominal.toml", 0.95)
        rig.write(folder, gait(), rig.plant(VIRTUAL, "full", load=load), {"run": controller})
        files = folder / "controller-run.toml", folder / "plant.toml"
        simulate_loop(*files, 0.5)  # compiles, or loads what was compiled before
        with stamped() as stamps:
            simulate_loop(*files, seconds)
    rows = [row for row in stamps.rows if "plausibility" in row]  # of cycles with torque
    rows.sort(key=lambda row: sum(value for part, value in row.items() if part != BUS))
    rows = rows[: round(KEPT * len(rows))]
    names = [*(part for part in PARTS if part != BUS), "the rest"]
    return {part: statistics.fmean(row.get(part, 0.0) for row in rows) for part in names}, len(rows)


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="of torque (default 10)")
    parser.add_argument("--rate", type=float, default=1000.0, help="of the loop, Hz (default 1000)")
    parser.add_argument("--load", default="limb", help="of the joint (default limb)")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found, cycles = measured(options.seconds, options.rate, options.load)
    whole, period = sum(found.values()), 1e6 / options.rate
    watch = whole - found["the rest"]
    if options.json:
        print(json.dumps({"schema": 1, "unit": "us", "cycles": cycles, "parts": found, "watch_of_loop": watch / whole,
                          "watch_of_period": watch / period, "read_back_of_loop": found["read-back"] / whole,
                          "read_back_of_period": found["read-back"] / period}))  # fmt: skip
        return 0
    print(f"{'part':20}{'us a cycle':>12}{'of the loop':>14}{'of the period':>16}")
    for name, value in (*found.items(), ("all that watches", watch), ("the loop", whole)):
        print(f"{name:20}{value:>12.1f}{value / whole:>13.1%}{value / period:>15.2%}")
    print(f"mean of {cycles} cycles with torque")
    return 0
