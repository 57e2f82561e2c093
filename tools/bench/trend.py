"""Measure what `tsa log trend` reports of a rig that wears, since which day, and of one that does not.

Usage: tools/run bench/trend [--days 12] [--folders 400]

Each day is a gait of 4 s on the distributed plant in virtual time, without a joint torque sensor; the file has the true
shape, and friction, pretension and stiffness up to 8 % off. Friction, pretension and the encoder's zero scatter from
day to day. A folder has eight days, the last three of them worn; of one folder none is. False alarms are counted over
folders of eight of all healthy days, in drawn orders.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tests.virtual.joints import GAIT, files
from tools import command
from tsa_ctrl import simulate_loop
from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.identify.trend import ALARM, Change, Run, judged, measured, trend
from tsa_ctrl.model.parameters import load_tendon_sheath, save_model

MODEL = "rig.toml"
SECONDS = 4.0
DAYS, WORN = 8, 5  # of a folder; healthy ones of it
SCATTER = 0.01  # 1, RMS from day to day, of friction and of pretension
PLACED = 20.0  # counts RMS, of the joint encoder's zero: 3 um of stretch
TRUE = {"friction_coefficient": 1.05, "pretension": 0.95, "axial_stiffness": 0.92}  # over the file's
SLIP = 2_000  # counts of 2^20: 0.012 rad
MIDDLE = 1 << 31  # counts: an absolute encoder whose zero is not at its end
WEAR: Mapping[str, Mapping[str, float]] = {  # factors on the truth; counts
    "nothing": {},
    "liner worn: friction a fifth more": {"friction_coefficient": 1.2},
    "tendon stretched: pretension a fifth less": {"pretension": 0.8},
    "tendon frayed: a tenth softer": {"axial_stiffness": 0.9},
    "pulley slipped by 0.012 rad": {"zero": SLIP},
}


def day(path: Path, number: int, worn: Mapping[str, float]) -> None:
    """Write one day's log (MCAP) as a daemon does; `number` draws its scatter."""
    rng = np.random.default_rng([7, number])
    truth = {name: value * worn.get(name, 1.0) for name, value in TRUE.items()}
    for name in ("friction_coefficient", "pretension"):
        truth[name] *= 1.0 + SCATTER * rng.standard_normal()
    zero = round(float(MIDDLE + worn.get("zero", 0.0) + PLACED * rng.standard_normal()))
    with tempfile.TemporaryDirectory(prefix="bench-trend-") as name:
        folder = Path(name)
        paths = files(
            folder,
            "imposed",
            GAIT,
            compensation=0.8,
            axis={"torque_sensor": None, "encoder": {"zero": MIDDLE}, "model": "nominal.toml"},
            plant={"torque_sensor": {"present": False}, "perturbation": truth, "encoder": {"zero": zero}},
        )
        simulate_loop(*paths, SECONDS, out=folder, seed=number)
        shutil.move(folder / "tsa.mcap", path)


def write(folder: Path, days: int) -> dict[str, Path]:
    """A folder of logs for each kind of wear, healthy days alike; `all` has all healthy ones."""
    save_model(NOMINAL, folder / MODEL)
    everything = folder / "all"
    everything.mkdir()
    for number in range(days):
        day(everything / f"day{number + 1:02}.mcap", number, {})
    found = {"all": everything}
    for place, (words, worn) in enumerate(WEAR.items()):
        found[words] = folder / f"wear{place}"
        found[words].mkdir()
        for number in range(DAYS):
            log = f"day{number + 1:02}.mcap"
            if worn and number >= WORN:
                day(found[words] / log, 100 * place + number, worn)
            else:
                shutil.copy2(everything / log, found[words] / log)
    return found


def false_alarms(runs: list[Run], folders: int) -> tuple[int, int]:
    """Changes told of folders of healthy days in drawn orders, and of how many quantities of folders."""
    rng = np.random.default_rng(3)
    told = 0
    for _ in range(folders):
        taken = [runs[place] for place in rng.permutation(len(runs))[:DAYS]]
        told += len(judged(taken).changes)
    return told, folders * len(runs[0].quantities)


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--days", type=int, default=12, help="healthy ones, at least 8")
    parser.add_argument("--folders", type=int, default=400, help="drawn of them")
    arguments = parser.parse_args()
    lines: list[tuple[object, ...]] = []
    with tempfile.TemporaryDirectory(prefix="bench-trend-") as name:
        logs = write(Path(name), max(DAYS, arguments.days))
        model = load_tendon_sheath(Path(name) / MODEL)
        for words in WEAR:
            changes = trend(logs[words], model).changes
            lines += [(words, *cells(change)) for change in changes] or [(words, "nothing", "", "", "", "")]
        runs = [measured(path, model) for path in sorted(logs["all"].iterdir())]
    told, of = false_alarms(runs, arguments.folders)
    command.print_table(("from the sixth of eight days on", "told", "since", "before", "after", "words"), lines)
    share = f"{100.0 * told / of:.2g} %; stated: {100.0 * ALARM:g} %"
    print(f"false alarms: {told} of {of} quantities of {arguments.folders} folders, {share}")
    return 0


def cells(change: Change) -> tuple[str, ...]:
    """Return the cells of a change."""
    name = change.quantity.replace("_", " ")
    before, after = (f"{value:.4g} {change.unit}" for value in (change.before, change.after))
    return name, change.since.removesuffix(".mcap"), before, after, str(change).split(": ", 2)[-1]
