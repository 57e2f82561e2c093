"""Identify stiffness and shape of random rigs, and verify the joint torque from the tendon elongation.

Usage: tools/run bench/stretch [--rigs 30] [--first 0] [--seed 1] [--rows FILE] [--json]

Each rig differs from its nominal file by up to 20 % in friction, pretension and stiffness. Its sheath has an even or a
double bend with a centre of up to s_c = 0.7. Motor inertia and delay are random. The log is a gait of 6 s, from which
the fit of `tsa calibrate --stretch` identifies stiffness and curvature profile.

Then the observer runs on a locked joint, a weight, and the gait with other noise, and is compared with the distributed
plant. Errors are RMS values after 1.5 s, divided by the RMS torque. On average over the rigs, the band should contain
95 % of the samples. The share of one rig varies, because the remaining errors of stiffness and profile are constant.
Each run is also evaluated with the true profile, which excludes the error of the identified profile.
--rows keeps each finished rig in a file, so that a long list can be run in parts.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from rich.table import Table

from tests.virtual.joints import GAIT, rms, sine
from tests.virtual.rigs import Drawn, draw
from tools import command
from tools.command import Row
from tsa_ctrl.demo.rig import gait
from tsa_ctrl.identify.calibrate.stretch import StretchFit, fit_stretch
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.curvature import NAMED, Points, Profile, centred
from tsa_ctrl.model.parameters import TendonSheath, save_model
from tsa_ctrl.observer.stretch import StretchObserver
from tsa_ctrl.virtual.result import AxisResult
from tsa_ctrl.virtual.simulation import simulate_loop

SETTLED = 1.5  # s of a log that are excluded from the errors
MOST_CENTRE = 0.7
COUNTS = (2.0 * math.pi / 65_536, 2.0 * math.pi / 1_048_576)  # rad
PERIOD = 1e-3
S_BENT: Points = ((0.0, 0.0), (0.1, 0.0), (0.35, 0.5), (0.65, 0.5), (0.9, 1.0), (1.0, 1.0))
RUNS: dict[str, tuple[str, dict[str, Any], float]] = {
    "gait": ("imposed", GAIT, 4.0),
    "held": ("held", sine(0.5, 0.5), 4.5),
    "weight": ("weight", sine(0.5, 0.5), 4.5),
}


KINDS = {
    "sliding": "sliding",
    "all": "all samples",
    "sliding_told": "true profile: sliding",
    "all_told": "true profile: all samples",
}


def shape(seed: int, number: int) -> Profile:
    """Return a random curvature profile, even or with two bends, shifted to a centre of 0.1 to 0.7."""
    rng = np.random.default_rng([seed, number, 7])
    return centred(Profile((NAMED["uniform"], S_BENT)[int(rng.integers(2))]), float(rng.uniform(0.1, MOST_CENTRE)))


def play(
    folder: Path, rig: Drawn, bends: Profile, load: str, setpoint: dict[str, Any], seconds: float, seed: int
) -> AxisResult:
    """Run the nominal controller on the true rig."""
    save_model(rig.nominal, folder / "nominal.toml")
    gait().write_setpoint(folder / "setpoint.csv")
    gait().write_motion(folder / "motion.csv")
    axis = {
        "name": "joint",
        "model": "nominal.toml",
        "drive": {"node_id": 1, "max_torque": 3.0},
        "encoder": {"node_id": 32},
        "torque_sensor": {"node_id": 64},
        "setpoint": setpoint,
        "law": {"fade_in": 0.5, "compensation": 0.8},
        "estimator": {"kind": "fixed"},
        "limits": {"torque": 2.5, "rate": 400.0},
    }
    plant = {
        "name": "joint",
        "actuator": "nominal.toml",
        **rig.axis(),
        "tendon": {"kind": "distributed", "curvature": [list(point) for point in bends.points]},
        "joint": {"load": load},
        "motion": {"kind": "file", "file": "motion.csv"},
    }
    for name, tables in (
        ("controller", {"controller": {"settle_cycles": 20}, "axis": [axis]}),
        ("plant", {"physics": {"start": "first_enable"}, "axis": [plant]}),
    ):
        (folder / f"{name}.toml").write_text(tomlkit.dumps(tables), encoding="utf-8")
    return simulate_loop(folder / "controller.toml", folder / "plant.toml", seconds, seed=seed).axes[0]


def identify(result: AxisResult, nominal: TendonSheath, bends: Profile | None = None) -> StretchFit:
    """Identify stiffness and shape from a run. With `bends`, the shape is given."""
    names = ("t", "tau_m", "q_m", "q_j", "omega_m", "omega_j", "tau_j")
    kept = result.log["t"] < result.until
    kept &= np.all([np.isfinite(result.log[name]) for name in names], axis=0)
    log = Dataset.from_arrays({name: result.log[name][kept] for name in names}, "gait")
    if bends is not None:
        nominal = nominal.with_effects({"elongation_coupling": {"curvature_profile": bends.points}})
    return fit_stretch([log], nominal)


def verify(result: AxisResult, model: TendonSheath, inertia: float) -> dict[str, float]:
    """Return the observer's errors divided by the RMS torque, and the share of samples within its band."""
    log = result.log
    seen = StretchObserver(model, PERIOD, COUNTS, inertia)
    told = np.full((log["t"].size, 2), np.nan)
    columns = zip(*(log[name].tolist() for name in ("tau_m", "omega_m", "q_m", "q_j")), strict=True)
    for row, values in enumerate(columns):
        seen.update(*values)
        told[row] = seen.torque, 0.5 * (seen.high - seen.low)
    kept = result.counted & (log["t"] > SETTLED)
    if not kept.any():  # the nominal controller's run ended in a fault
        return dict.fromkeys(("torque", "sliding", "all", "held_by_band", "band"), math.nan)
    z = result.truth["z"][np.searchsorted(result.truth["clock"], result.start + log["t"] + log["lateness"])]
    error = (told[:, 0] - result.delivered)[kept]
    size = rms(result.delivered[kept])
    slides = np.abs(z[kept]) > 0.999
    return {
        "torque": size,
        "sliding": rms(error[slides]) / size if slides.any() else math.nan,
        "all": rms(error) / size,
        "held_by_band": float(np.mean(np.abs(error) <= told[kept, 1])),
        "band": float(np.mean(told[kept, 1])) / size,
    }


def trial(asked: tuple[int, int]) -> Row:
    """Return the identified parameters of one rig, by seed and number, and the observer's errors in each run."""
    seed, number = asked
    rig, bends = draw(seed, number), shape(seed, number)
    with tempfile.TemporaryDirectory(prefix="bench-stretch-") as name:
        folder = Path(name)
        seen = play(folder, rig, bends, "imposed", GAIT, 6.0, 1)
        found = identify(seen, rig.nominal)
        told = identify(seen, rig.nominal, bends)
        runs = {}
        for label, (load, setpoint, seconds) in RUNS.items():
            result = play(folder, rig, bends, load, setpoint, seconds, 2)
            runs[label] = verify(result, found.model, found.motor_inertia.value)
            again = verify(result, told.model, told.motor_inertia.value)
            runs[label] |= {f"{key}_told": again[key] for key in ("sliding", "all")}
    assert found.centre is not None
    stiffness, true = found.axial_stiffness, rig.truth.axial_stiffness
    return {
        "seed": seed,
        "rig": number,
        "stiffness": stiffness.value / true,
        "stiffness_held": stiffness.low <= true <= stiffness.high,
        "stiffness_half": (stiffness.high / stiffness.low - 1.0) / 2.0,
        "inertia": found.motor_inertia.value / rig.inertia,
        "true_centre": bends.centre,
        **{f"{label}_{key}": value for label, values in runs.items() for key, value in values.items()},
        "centre": found.centre.value,
        "centre_held": found.centre.low <= bends.centre <= found.centre.high,
        "centre_half": 0.5 * (found.centre.high - found.centre.low),
    }


def main() -> int:
    parser = command.parser(__name__, __doc__)
    command.share(parser, "rigs first seed rows processes json", rigs=30, seed=1)
    arguments = parser.parse_args()
    numbers = range(arguments.first, arguments.first + arguments.rigs)
    asked = [(arguments.seed, number) for number in numbers]
    rows = command.run_rows(trial, asked, lambda row: (row["seed"], row["rig"]), arguments)
    command.print_tables(rows, arguments, lambda: report(rows))
    return 0


def report(rows: list[Row]) -> Iterator[Table | str]:
    """Yield the table of the relative errors, as median (worst) of the rigs, and then the coverage of the intervals."""
    lines = []
    for label in RUNS:
        ran = [row for row in rows if math.isfinite(row[f"{label}_sliding"])]
        if ran:
            lines.append((label, f"{len(ran)} of {len(rows)}", *_cells(ran, label)))
    heads = ("worst sliding error", "samples in the 95 % band (lowest to highest rig)", "half width of the band")
    yield command.table(("run", "rigs", *KINDS.values(), *heads), lines)
    for name in ("stiffness", "centre"):
        held = sum(row[f"{name}_held"] for row in rows)
        half = np.median([row[f"{name}_half"] for row in rows])
        yield f"{name}: {held} of {len(rows)} intervals hold the truth; half an interval {half:.3g} (median)"


def _cells(rows: list[Row], label: str) -> list[str]:
    share, size = max((row[f"{label}_sliding"], 1e3 * row[f"{label}_torque"]) for row in rows)
    held = 100.0 * np.array([row[f"{label}_held_by_band"] for row in rows])
    return [
        *(_spread([row[f"{label}_{kind}"] for row in rows]) for kind in KINDS),
        f"{share * size:.1f} of {size:.0f} mN·m",
        f"{held.mean():.1f} % ({held.min():.0f} to {held.max():.0f})",
        _spread([row[f"{label}_band"] for row in rows]),
    ]


def _spread(shares: list[float]) -> str:
    """Format median and worst value, %."""
    return f"{100.0 * np.median(shares):.1f} % ({100.0 * max(shares):.1f})"
