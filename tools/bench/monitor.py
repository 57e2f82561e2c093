"""The monitor: when it finds each fault, when the torque is gone, and whether it leaves healthy rigs alone.

tools/run bench/monitor [--healthy SECONDS --rigs N --seed S]: virtual time. Each trial runs on a limb, with a drive
that reacts to NMT stop and with one that does not. With --healthy the shipped rig and drawn rigs run on every load with
the monitor, which must not act.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path

import tomlkit
from rich.console import Console
from rich.table import Table

from tests.monitor.healthy import Sound, frames, watched
from tests.monitor.trials import TRIALS, Trial
from tests.virtual.joints import files, sine
from tests.virtual.rigs import draw
from tools import command
from tsa_ctrl import simulate_loop
from tsa_ctrl.model.parameters import save_model
from tsa_ctrl.monitor.watch import Monitor

LOADS = ("imposed", "held", "free", "spring", "weight", "limb", "wearer")
LONGEST = 100  # ms after the finding, for which torque is looked for
NONE = 1e-3  # N*m


def cost() -> tuple[float, float]:
    """Return microseconds per frame and per cycle of one axis; the best of five."""
    given = list(frames(Sound(), 2.0))
    best = float("inf")
    for _ in range(5):
        monitor = Monitor(watched())
        begin = time.perf_counter()
        for frame, now in given:
            monitor.step(frame, now)
        best = min(best, time.perf_counter() - begin)
    return 1e6 * best / len(given), 1e6 * best / 2000


def gone(trial: Trial) -> str:
    """Return when the torque is gone, ms after the fault."""
    found = [ms for ms in range(LONGEST) if trial.torque(trial.late + 1e-3 * ms) < NONE]
    return f"{1e3 * trial.late + found[0]:.0f}" if found else "never"


def healthy(seconds: float, rigs: int, seed: int) -> list[str]:
    """Return the reactions of the monitor on healthy rigs, a line each."""
    lines = []
    for number in range(rigs + 1):
        for load in LOADS:
            with tempfile.TemporaryDirectory(prefix="bench-monitor-") as name:
                folder = Path(name)
                paths = _shipped(folder, load) if number == 0 else _drawn(folder, load, seed, number)
                controller = tomlkit.parse(paths[0].read_text(encoding="utf-8"))
                controller["monitor"] = {"enabled": True}
                paths[0].write_text(tomlkit.dumps(controller), encoding="utf-8")
                events = simulate_loop(*paths, seconds).summary.events
            acted = [event.text for event in events if "monitor: " in event.text]
            lines.append(f"{'shipped' if number == 0 else f'rig {number}'}, {load}: {acted or 'left alone'}")
            print(lines[-1], flush=True)
    return lines


def _shipped(folder: Path, load: str) -> tuple[Path, Path]:
    shutil.copytree(command.CONFIG, folder / "config")
    path = folder / "config" / "plant.toml"
    plant = tomlkit.parse(path.read_text(encoding="utf-8"))
    plant["axis"][0]["joint"]["load"] = load
    path.write_text(tomlkit.dumps(plant), encoding="utf-8")
    return folder / "config" / "controller.toml", path


def _drawn(folder: Path, load: str, seed: int, number: int) -> tuple[Path, Path]:
    rig = draw(seed, number)
    save_model(rig.nominal, folder / "rig.toml")
    save_model(rig.truth, folder / "plant-rig.toml")
    return files(
        folder,
        load,
        sine(0.5, 0.7),
        delay=rig.delay,
        inertia=rig.inertia,
        curvature=rig.curvature,
        axis={"model": "rig.toml"},
        plant={"actuator": "plant-rig.toml"},
    )


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--healthy", type=float, default=0.0, help="s of each healthy run; 0: none")
    parser.add_argument("--rigs", type=int, default=2, help="drawn rigs in addition to the shipped one")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    table = Table("fault", "found", "after (ms)", "torque gone (ms)", "drive without reaction (ms)")
    for name, (_, spoil, _) in TRIALS.items():
        found = []
        for watchdogs in (True, False):
            with tempfile.TemporaryDirectory(prefix="bench-monitor-") as folder:
                found.append(Trial(Path(folder), spoil, True, 1.2, drive={"watchdogs": watchdogs}))
        stop = found[0].stop
        row = ("", "") if stop is None else (stop.id, f"{1e3 * found[0].late:.1f}")
        table.add_row(name, *row, *(gone(trial) for trial in found))
    console = Console(width=120)
    console.print(table)
    per_frame, per_cycle = cost()
    console.print(f"step: {per_frame:.1f} us per frame, {per_cycle:.0f} us per cycle of one axis")
    if arguments.healthy > 0.0:
        lines = healthy(arguments.healthy, arguments.rigs, arguments.seed)
        acted = [line for line in lines if not line.endswith("left alone")]
        console.print(f"healthy: {len(lines)} runs of {arguments.healthy:g} s, acted in {len(acted)}")
        return 1 if acted else 0
    return 0
