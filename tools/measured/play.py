"""Plays a motion and torque measured on a cable-driven instrument through the demo, and simulates both logs.

Usage: tools/run measured/play [--trial load050_0.3Hz] [--out out/davinci] [--seconds 12] [--file-only] [ARGUMENT...]

The measured log is simulated with the model beside it, the demo's with its nominal model. ARGUMENT is for `tsa demo`.
The data is looked for in the folder named by TSA_DATA, else in ../shared/data; without it there is one line and nothing
to do. --file-only: only the set-point file, in the range of the demo's rig.
"""

from __future__ import annotations

import argparse
import datetime
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tools import command
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.dataset import Dataset, load_log
from tsa_ctrl.log.csv_out import write_columns
from tsa_ctrl.model.signals import low_pass
from tsa_ctrl.system.processes import tsa

PEAK = 0.9  # N*m at the joint: what the demo's rig carries without slack, with room
CUTOFF = 10.0  # Hz, as for the figures published with the data
RATE = 200.0  # Hz of the file
SETTLING = 1.5  # s at the start of a trial, before its motion is periodic

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Excerpt:
    """Whole periods of a trial: t in s from 0, tau_j_des in N*m, q_j in rad; the end meets the start."""

    t: Array
    tau_j_des: Array
    q_j: Array
    torque_scale: float
    angle_shift: float

    def write(self, path: Path) -> None:
        write_columns(path, {"t": self.t, "tau_j_des": self.tau_j_des, "q_j": self.q_j}, keeping=False)


def excerpt(log: Dataset, period: float) -> Excerpt:
    """The whole periods of `log` after it has settled, low-passed, centred and scaled to PEAK."""
    periods = int((log.seconds - SETTLING) / period)
    if periods < 1:
        raise UsageError(f"{log.label}: {log.seconds:.1f} s hold no whole period of {period:g} s; choose another trial")
    t = np.arange(round(periods * period * RATE) + 1) / RATE
    start = log["t"][0] + SETTLING
    torque, angle = (
        _closed(np.interp(start + t, log["t"], low_pass(log[name], log.period, CUTOFF))) for name in ("tau_j", "q_j")
    )
    scale = PEAK / float(np.max(np.abs(torque)))
    shift = -0.5 * float(angle.max() + angle.min())
    return Excerpt(t, scale * torque, angle + shift, scale, shift)


def _closed(values: Array) -> Array:
    """`values` without the drift from the first to the last, so that they can be repeated."""
    closed: Array = values - (values[-1] - values[0]) * np.linspace(0.0, 1.0, len(values))
    return closed


def shown(*arguments: str | Path) -> int:
    """Run a verb and show it."""
    words = [str(argument) for argument in arguments]
    print(f"\n$ tsa {' '.join(words)}", flush=True)
    return subprocess.run(tsa(*words), check=False).returncode


def run(options: argparse.Namespace, more: list[str]) -> int:
    folder = command.measured_data(__name__)
    if folder is None:
        return 0
    measured = folder / f"{options.trial}.csv.gz"
    if not measured.is_file():
        trials = ", ".join(path.name.removesuffix(".csv.gz") for path in sorted(folder.glob("*.csv.gz")))
        raise UsageError(f"{measured}: no such trial; there are {trials}")
    frequency = re.search(r"([\d.]+)Hz", options.trial)
    log = load_log(measured)
    play = excerpt(log, 1.0 / float(frequency[1]) if frequency else log.seconds - SETTLING - log.period)
    setpoint = options.out / "setpoint.csv"
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{options.out}: cannot be written ({error.strerror}); choose another --out") from None
    play.write(setpoint)
    print(
        f"{setpoint}: {play.t[-1]:.2f} s of {options.trial} in whole periods at {RATE:g} Hz; joint torque times "
        f"{play.torque_scale:.2f} (peak {PEAK:g} N*m), joint angle shifted by {play.angle_shift:+.3f} rad and not "
        f"scaled, both low-passed at {CUTOFF:g} Hz with zero phase"
    )
    print("data: O'Neill, Stephens, Kowalewski, IEEE RA-L 3(4):3027-3034, 2018 (Open Database License 1.0)")
    if options.file_only:
        return 0
    demo = options.out / f"demo-{datetime.datetime.now():%Y%m%d-%H%M%S}"
    failed = shown("demo", "--setpoint", setpoint, "--seconds", options.seconds, "--out", demo, *more)
    code = shown("simulate", measured, "--model", folder / "actuator.toml", "--picture", options.out / "measured.png")
    if failed:
        return failed
    for recorded in sorted(demo.glob("*.mcap")):
        picture = recorded.with_suffix(".png")
        code = shown("simulate", recorded, "--model", demo / "nominal.toml", "--picture", picture) or code
    return code


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--trial", default="load050_0.3Hz")
    parser.add_argument("--out", type=Path, default=command.ROOT / "out" / "davinci")
    parser.add_argument("--seconds", default="12")
    parser.add_argument("--file-only", action="store_true")
    return run(*parser.parse_known_args())
