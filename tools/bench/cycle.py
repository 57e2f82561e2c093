"""Compare execution time and wake-up latency of a control cycle with those of a raw socket.

Usage: tools/run bench/cycle [--axes 1] [--rate 0] [--rounds 6] [--cycles 250] [--json]

All variants run alternately in blocks, on one bus with one process that answers each SYNC (as in `tsa bench`):

  raw socket        SYNC out, TPDOs in, RPDOs out: the minimum in Python
  raw socket, C     the same in C; this row is omitted without a C compiler
  ours              the cycle of `tsa run`: SYNC, image, supervision, law, limiter, RPDO
  ours, all         the same with the work after the RPDO: estimate, log record, a command from the local socket

"cycle" is the wall time from the wake-up to the end of the cycle. "user" and "kernel" are the processor times of the
thread per period, including the wait and the work after the cycle. If there is a compiled build (`tools/run
package/compiled`), the command measures it. TSA_COMPILE=0 measures the interpreted build. Without a vcan the command
runs itself under tools/vcan. --rate 0 is 1000 Hz, or less if the bit rate is too low.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

from tools import command
from tools.bench.loop import ways
from tools.bench.loop.rig import RATES, controller_text
from tools.bench.loop.ways import Factory, measure, nodes
from tsa_ctrl.config import load_configuration
from tsa_ctrl.system import realtime
from tsa_ctrl.system.realtime import RealtimeSettings
from tsa_ctrl.version import build_kind


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--axes", type=int, default=1, choices=tuple(RATES))
    parser.add_argument(
        "--rate", type=float, default=0.0, help="Hz; 0: the highest that the bit rate allows, at most 1000"
    )
    parser.add_argument("--rounds", type=int, default=6)
    parser.add_argument("--cycles", type=int, default=250, help="in one block")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    interface = command.vcan(__name__)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "controller.toml"
        path.write_text(controller_text(folder, interface, options.axes, options.rate), encoding="utf-8")
        configuration = load_configuration(path)
        rights = str(realtime.acquire(RealtimeSettings(allow_without=True)))
        with nodes(configuration):
            table: dict[str, Factory] = {
                "raw socket": lambda: ways.raw_socket(configuration),
                "ours": lambda: ways.ours(configuration),
                "ours, all": lambda: ways.ours_all(configuration),
            }
            library = ways.floor_library(folder)
            if library is not None:
                table["raw socket, C"] = lambda: ways.raw_socket_in_c(configuration, library)
            found = measure(table, configuration.file.controller.rate, options.rounds, options.cycles)
    if options.json:
        rate = configuration.file.controller.rate
        print(
            json.dumps(
                {"schema": 1, "axes": options.axes, "rate": rate, "unit": "us", "build": build_kind(), "ways": found}
            )
        )
        return 0
    report(found, configuration, rights, options.axes)
    return 0


def report(figures: dict[str, dict[str, float]], configuration: Any, rights: str, axes: int) -> None:
    rate = configuration.file.controller.rate
    print(f"\r{axes} axes at {rate:g} Hz, bus load {100 * configuration.load.worst:.0f} %, {rights}")
    heads = ("cycle p50", "p99", "user", "kernel", "lateness p50", "p99", "of floor", "lost")
    print(f"{'':16}{''.join(f'{head:>13}' for head in heads)}   us, {build_kind()}")
    floor = figures["raw socket"].get("cycle_p50", float("nan"))
    keys = ("cycle_p50", "cycle_p99", "user", "kernel", "lateness_p50", "lateness_p99")
    for name, row in figures.items():
        cells = [f"{row[key]:.0f}" if key in row else "-" for key in keys]
        cells += [f"{row['cycle_p50'] / floor:.2f}" if "cycle_p50" in row else "-", str(row["lost"])]
        print(f"{name:16}{''.join(f'{cell:>13}' for cell in cells)}")
