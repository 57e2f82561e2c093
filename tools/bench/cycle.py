"""Measure execution time and wake-up latency of a control cycle, next to the cost of the bus alone.

Usage: tools/run bench/cycle [--axes 1] [--rate 0] [--rounds 6] [--cycles 250] [--json]

One run, one bus, and one process that answers each SYNC (as in `tsa bench`). The variants take turns in blocks:

  raw socket        SYNC out, TPDOs in, RPDOs out: the minimum in Python
  raw socket, C     the same in C; without a C compiler this row is left out
  ours              the cycle of `tsa run`: SYNC, image, supervision, law, limiter, RPDO
  ours, all         the same with the work after the RPDO: estimate, record for the log, a command of the local socket

"cycle" is wall time from the wake-up to the end of the cycle. "user" and "kernel" are the processor time of the
thread per period, with the wait and with what follows the cycle. A compiled build is measured if there is one
(`tools/run package/compiled`); TSA_COMPILE=0 measures the interpreted one.
Needs a vcan; without one it runs under tools/vcan. --rate 0: 1000 Hz, or less where the bit rate carries less.
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
    parser.add_argument("--rate", type=float, default=0.0, help="Hz; 0: as much of 1000 as the bit rate carries")
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
