"""Simplified, full and distributed tendon models on the same motion: picture, table, convergence.

Usage: tools/run bench/tendons [--seconds 8] [--out out/compare_models]

An evenly bent sheath, one motion, one motor torque. (3.55) and (3.53) are the formulas for sliding; the plant's full
model adds standstill; the distributed tendons let a slip front travel from the motor end after each reversal.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from tools import command
from tools.bench.tendon_runs import Course, make_axis, run
from tools.figures.look import BACKWARD, FORWARD, GUIDE, NEUTRAL, grid, save
from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.signals import Signals

FINE_ELEMENTS, FINE_STEP = 160, 2.5e-5  # what the convergence is measured against
ELEMENTS = (5, 10, 20, 40, 80)
STEPS = (1e-4, 5e-5)  # s
SHOWN = 4.0  # s in the picture
SLIDING = 0.3  # s after a reversal from which on the whole tendon slides


def formulas(course: Course) -> dict[str, np.ndarray]:
    """Joint torque of the formulas for the motor torque of a course."""
    signals = Signals(t=course.t, tau_m=course.tau_m, omega_j=course.omega_j, q_j=course.q_j)
    full = NOMINAL.with_effects({"elongation_coupling": {"curvature_profile": "uniform"}})
    return {"simplified (3.55)": predict(NOMINAL, signals), "full (3.53), sliding": predict(full, signals)}


def rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def sliding(course: Course) -> np.ndarray:
    """Samples more than SLIDING s after a reversal."""
    flips = np.flatnonzero(np.diff(np.sign(course.omega_j))) + 1
    last = np.zeros(len(course.t))
    for i in flips:
        last[i:] = course.t[i]
    return course.t - last > SLIDING


def picture(course: Course, curves: dict[str, np.ndarray], out: Path) -> None:
    figure, ((torque,), (error,)) = grid(2, 1, 8.0, 5.6)
    part = course.t < course.t[0] + SHOWN
    colours = dict(zip(curves, (BACKWARD, FORWARD, GUIDE), strict=True))
    torque.plot(course.t[part], course.tau_j[part], color=NEUTRAL, lw=2.2, label="distributed, N = 40")
    for name, values in curves.items():
        torque.plot(course.t[part], values[part], color=colours[name], lw=1.1, label=name)
        error.plot(course.t[part], 1e3 * (values - course.tau_j)[part], color=colours[name], lw=1.1, label=name)
    torque.set_ylabel("joint torque (N·m)")
    error.set_ylabel("less distributed (mN·m)")
    error.set_xlabel("time (s)")
    torque.set_title(f"Evenly bent sheath, x = {NOMINAL.friction_angle:.2f}, T_p = {NOMINAL.pretension:.0f} N")
    torque.legend(fontsize=8, ncols=2)
    save(figure, out, "models.png")


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--seconds", type=float, default=8.0, help="of motion (default 8)")
    parser.add_argument("--out", type=Path, default=Path("out/compare_models"))
    arguments = parser.parse_args()
    console = Console()

    distributed = run(make_axis(NOMINAL, "distributed"), arguments.seconds)
    curves = formulas(distributed)
    curves["full, with standstill (plant)"] = run(make_axis(NOMINAL, "full"), arguments.seconds).tau_j
    picture(distributed, curves, arguments.out)
    still = sliding(distributed)
    table = Table("model", "RMS against distributed (mN·m)", f"the same, {SLIDING:g} s and more after reversals (mN·m)")
    for name, values in curves.items():
        error = 1e3 * (values - distributed.tau_j)
        table.add_row(name, f"{rms(error):.1f}", f"{rms(error[still]):.2f}")
    console.print(table, f"RMS of the joint torque: {1e3 * rms(distributed.tau_j):.0f} mN·m")

    fine = run(make_axis(NOMINAL, "distributed", FINE_ELEMENTS), arguments.seconds)
    table = Table(
        "elements per tendon", f"RMS against N = {FINE_ELEMENTS} (mN·m)", "processor time per simulated s (s)"
    )
    for elements in ELEMENTS:
        course = run(make_axis(NOMINAL, "distributed", elements), arguments.seconds)
        table.add_row(str(elements), f"{1e3 * rms(course.tau_j - fine.tau_j):.3f}", f"{course.cost:.3f}")
    console.print(table)
    short = run(make_axis(NOMINAL, "distributed", step=FINE_STEP), arguments.seconds)
    table = Table("sub-step (ms)", f"RMS against {1e3 * FINE_STEP:g} ms (mN·m)", "processor time per simulated s (s)")
    for step in STEPS:
        course = run(make_axis(NOMINAL, "distributed", step=step), arguments.seconds)
        table.add_row(f"{1e3 * step:g}", f"{1e3 * rms(course.tau_j - short.tau_j):.3f}", f"{course.cost:.3f}")
    console.print(table)
    return 0
