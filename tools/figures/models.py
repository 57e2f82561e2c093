"""Draw the simplified, full and distributed tendon models for the same motion, and print their differences.

Usage: tools/run figures/models [--seconds 8] [--out .readme]

The sheath is evenly bent. All models have the same motion and motor torque. (3.55) and (3.53) are formulas for sliding.
The full model of the plant also covers standstill. In the distributed tendons, a slip front travels from the motor
after a reversal.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import numpy as np
import tomlkit
from numpy.typing import NDArray

from tools import command
from tools.figures.look import BACKWARD, FORWARD, GUIDE, NEUTRAL, grid, save
from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.model.parameters import save_model
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.signals import Signals
from tsa_ctrl.plant.axis import Axis
from tsa_ctrl.plant.settings import load_plant

Array = NDArray[np.float64]
PERIOD = 1e-3  # s between two commands
TORQUE, OFFSET, FREQUENCY = 0.5, 0.15, 0.31  # N*m, N*m, Hz of the motor torque
SETTLE = 1.0  # s in which the motion grows from standstill, which is not drawn
SHOWN = 4.0  # s of motion in the picture
SLIDING = 0.3  # s after a reversal, by which the whole tendon slides


def run(kind: str, seconds: float) -> dict[str, Array]:
    """Return the signals of one axis of the plant, with nominal parameters and a motor without inertia."""
    axis = {
        "name": "joint",
        "actuator": "actuator.toml",
        "tendon": {"kind": kind, "curvature": "uniform"},
        "drive": {"torque_time_constant": 1e-5, "torque_noise": 0.0},
        "motor": {"inertia": 0.0},
        "torque_sensor": {"noise": 0.0},
        "motion": {"kind": "sine", "amplitude": 0.4, "frequency": 0.5, "ramp": SETTLE},
    }
    with tempfile.TemporaryDirectory() as name:
        save_model(NOMINAL, Path(name) / "actuator.toml")
        (Path(name) / "plant.toml").write_text(tomlkit.dumps({"axis": [axis]}), encoding="utf-8")
        plant = load_plant(Path(name) / "plant.toml")
        joint = Axis(plant.axis[0], plant.physics)
    joint.command.enabled = True
    names = ("tau_m", "tau_j", "q_j", "omega_j")
    rows = []
    for i in range(round((SETTLE + seconds) / PERIOD)):
        t = (i + 1) * PERIOD
        joint.command.torque = OFFSET + TORQUE * math.sin(2.0 * math.pi * FREQUENCY * t)
        joint.advance(t)
        values = joint.values()
        rows.append([t, *(values[name] for name in names)])
    columns = np.array([row for row in rows if row[0] > SETTLE]).T
    return dict(zip(("t", *names), columns, strict=True))


def sliding(course: dict[str, Array]) -> NDArray[np.bool_]:
    """Return a mask of the samples that are more than SLIDING s after a reversal."""
    t = course["t"]
    flips = np.flatnonzero(np.diff(np.sign(course["omega_j"]))) + 1
    last = np.concatenate([[0.0], t[flips]])[np.searchsorted(flips, np.arange(t.size), side="right")]
    return np.asarray(t - last > SLIDING)


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--seconds", type=float, default=8.0, help="of motion (default 8)")
    parser.add_argument("--out", type=Path, default=command.ROOT / ".readme")
    arguments = parser.parse_args()
    truth = run("distributed", arguments.seconds)
    signals = Signals(t=truth["t"], tau_m=truth["tau_m"], omega_j=truth["omega_j"], q_j=truth["q_j"])
    bent = NOMINAL.with_effects({"elongation_coupling": {"curvature_profile": "uniform"}})
    curves = {
        "simplified (3.55)": (predict(NOMINAL, signals), BACKWARD),
        "full (3.53), sliding": (predict(bent, signals), FORWARD),
        "full, with standstill (plant)": (run("full", arguments.seconds)["tau_j"], GUIDE),
    }
    figure, ((torque,), (error,)) = grid(2, 1, 8.0, 5.6)
    part = truth["t"] < truth["t"][0] + SHOWN
    torque.plot(truth["t"][part], truth["tau_j"][part], color=NEUTRAL, lw=2.2, label="distributed")
    rows = []
    for name, (values, colour) in curves.items():
        differs = 1e3 * (values - truth["tau_j"])
        torque.plot(truth["t"][part], values[part], color=colour, lw=1.1, label=name)
        error.plot(truth["t"][part], differs[part], color=colour, lw=1.1)
        rows.append(
            (name, *(f"{np.sqrt(np.mean(np.square(each))):.2f}" for each in (differs, differs[sliding(truth)])))
        )
    torque.set_ylabel("joint torque (N·m)")
    error.set(xlabel="time (s)", ylabel="less distributed (mN·m)")
    torque.set_title(f"Evenly bent sheath, x = {NOMINAL.friction_angle:.2f}, T_p = {NOMINAL.pretension:.0f} N")
    torque.legend(fontsize=8, ncols=2)
    save(figure, arguments.out, "models.png")
    heads = ("model", "RMS against distributed (mN·m)", f"the same, {SLIDING:g} s and more after reversals (mN·m)")
    command.print_table(heads, rows)
    return 0
