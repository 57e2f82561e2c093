"""Compensation of a distributed-tendon plant by (3.55) and by the extended model, and what limits each.

Usage: tools/run bench/control [--seconds 8] [--rate 1000] [--tendon distributed] [--out out/compare_control]
Run it under tools/vcan for a real vcan. Each line is a pair of processes, plant and daemon, on the same motion; the
shares are measured by taking one thing away in the plant.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tools import command
from tsa_ctrl.demo import rig
from tsa_ctrl.demo.bus_choice import choose
from tsa_ctrl.demo.motion import gait
from tsa_ctrl.demo.run import compare
from tsa_ctrl.model.parameters import TendonSheath, save_model

NOISELESS: dict[str, dict[str, Any]] = {"drive": {"torque_noise": 0.0}, "torque_sensor": {"noise": 0.0}}
PROMPT = {"drive": {"torque_time_constant": 1e-5}}
STIFF = {"perturbation": {"axial_stiffness": 10.0}}
LIGHT = {"motor": {"inertia": 2e-6}}
TAKEN_AWAY: dict[str, dict[str, dict[str, Any]]] = {
    "nothing": {},
    "noise of torque and sensor": NOISELESS,
    "lag of the current loop": PROMPT,
    "elasticity: reversals at once": STIFF,
    "motor inertia: ringing after reversals": LIGHT,
}


def extended() -> TendonSheath:
    """The model whose parameters are given: the plant's own friction, pretension and curvature."""
    truth = rig.NOMINAL.recalibrated(
        rig.NOMINAL.friction_angle * rig.TRUTH["friction_coefficient"], rig.NOMINAL.pretension * rig.TRUTH["pretension"]
    )
    return truth.with_effects({"elongation_coupling": {"curvature_profile": "uniform"}})


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--seconds", type=float, default=8.0, help="of torque per run (default 8)")
    parser.add_argument("--rate", type=float, default=1000.0, help="of the loop, Hz (default 1000)")
    parser.add_argument("--tendon", choices=("distributed", "full"), default="distributed")
    parser.add_argument("--out", type=Path, default=Path("out/compare_control"))
    arguments = parser.parse_args()
    bus = choose()
    arguments.out.mkdir(parents=True, exist_ok=True)
    save_model(extended(), arguments.out / "extended.toml")
    runs = {
        "none": ("nominal.toml", 0.0),
        "(3.55), nominal": ("nominal.toml", 0.95),
        "extended, given": ("extended.toml", 1.0),
    }
    controllers = {
        f"run{i}": rig.controller(bus, f"run{i}", arguments.rate, *run) for i, run in enumerate(runs.values())
    }
    table = Table(
        "taken away in the plant", *(f"{name}: RMS (mN·m)" for name in runs), "reduction by (3.55)", "by extended"
    )
    for label, change in TAKEN_AWAY.items():
        print(f"{label} ...", flush=True)
        tables = rig.plant(bus, arguments.tendon, change)
        courses = compare(arguments.out, bus, gait(), tables, controllers, arguments.seconds, lambda what, share: None)
        none, simple, full = (course.rms for course in courses.values())
        errors = (f"{1e3 * value:.1f}" for value in (none, simple, full))
        table.add_row(label, *errors, f"{100 * (1 - simple / none):.1f} %", f"{100 * (1 - full / none):.1f} %")
    Console().print(
        table, f"bus {bus.name}, {arguments.rate:g} Hz, {arguments.tendon} tendons, {arguments.seconds:g} s per run"
    )
    return 0
