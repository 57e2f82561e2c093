"""Simulate a leg whose joints bend each other's sheaths: three joints in one loop, with and without `[routing]`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from matplotlib.figure import Figure

from tsa_ctrl import outputs
from tsa_ctrl.demo.outcome import Course, course_of, window
from tsa_ctrl.demo.rig import PERIOD, RATE, Play, cycle
from tsa_ctrl.virtual.simulation import play

Progress = Callable[[str, float], None]

# Typical joint angles of level walking from the literature, in degrees, and small assisting torques, in N*m.
# Each pair is (share of the stride, value), with heel strike at 0.
ANGLES: Mapping[str, tuple[tuple[float, float], ...]] = {
    "hip": ((0.0, 20.0), (0.15, 14.0), (0.5, -12.0), (0.65, -2.0), (0.85, 22.0)),
    "knee": ((0.0, 5.0), (0.15, 18.0), (0.40, 5.0), (0.60, 35.0), (0.72, 61.0), (0.95, 6.0)),
    "ankle": ((0.0, 0.0), (0.08, -5.0), (0.45, 10.0), (0.62, -16.0), (0.8, 0.0)),
}
TORQUES: Mapping[str, tuple[tuple[float, float], ...]] = {
    "hip": ((0.0, 0.6), (0.25, 0.3), (0.5, -0.5), (0.75, 0.2)),
    "knee": ((0.0, -0.2), (0.17, 0.8), (0.40, -0.3), (0.60, 0.3), (0.85, -0.3)),
    "ankle": ((0.0, 0.0), (0.2, -0.2), (0.48, 0.8), (0.65, 0.0)),
}
ROUTING = {"hip": {}, "knee": {"hip": 0.8}, "ankle": {"knee": 0.5}}  # rad of wrap angle per rad of the other joint
WITHOUT, FIXED, FOLLOWED = "without", "fixed", "with"  # no compensation, no routing, with both
SECONDS = 9.0  # s of torque: five strides
SHOWN = 2.0 * PERIOD  # s in the picture


def strides() -> dict[str, Play]:
    """Return one stride of each joint."""
    t = np.arange(0.0, PERIOD + 0.5 / RATE, 1.0 / RATE)
    return {
        name: Play(t, cycle(TORQUES[name])(t / PERIOD % 1.0), np.radians(cycle(ANGLES[name])(t / PERIOD % 1.0)))
        for name in ANGLES
    }


@dataclass(frozen=True)
class Leg:
    """Three runs with the same motion; each holds its joints by name."""

    runs: Mapping[str, Mapping[str, Course]]
    picture: Path

    def rms(self, run: str) -> float:
        """Return the RMS error over all joints, N*m."""
        return float(np.sqrt(np.mean([joint.rms**2 for joint in self.runs[run].values()])))

    @property
    def reduction(self) -> float:
        """Return the reduction of the RMS error of all joints by compensation with routing, %."""
        return 100.0 * (1.0 - self.rms(FOLLOWED) / self.rms(WITHOUT))

    def to_dict(self) -> dict[str, Any]:
        """Return the public JSON object of `tsa demo --leg --json`."""
        names = list(self.runs[FOLLOWED])
        courses = [next(iter(joints.values())) for joints in self.runs.values()]
        cycles = [course.summary["cycles"] for course in courses]
        return {
            "schema": 1,
            "bus": "virtual time",
            "load": "leg",
            "rms": {
                "wanted": float(np.sqrt(np.mean([np.mean(j.wanted**2) for j in self.runs[FOLLOWED].values()]))),
                **{run: self.rms(run) for run in self.runs},
                "unit": "N*m",
            },
            "axes": [
                {"name": name, "rms": {run: joints[name].rms for run, joints in self.runs.items()}} for name in names
            ],
            "reduction_percent": self.reduction,
            "picture": str(self.picture),
            "log": str(courses[-1].log),
            "cycles": {key: sum(c[key] for c in cycles) for key in ("planned", "sent", "late", "missed_pdo")},
        }

    def draw(self) -> None:
        """Write the picture: the error of each joint in the three runs over two strides."""
        figure = Figure(figsize=(9.0, 8.0), layout="constrained")
        rows = figure.subplots(len(self.runs[FOLLOWED]), 2, sharex=True, width_ratios=[1, 1])
        looks = {
            WITHOUT: ("tab:red", "without compensation"),
            FIXED: ("tab:orange", "without routing"),
            FOLLOWED: ("tab:blue", "with routing"),
        }
        for row, (name, joint) in zip(rows, self.runs[FOLLOWED].items(), strict=True):
            first = joint.t[0]
            row[0].plot(*window(joint.t, joint.wanted, first, SHOWN), "k", lw=2.2, label="desired")
            for run, (colour, label) in looks.items():
                one = self.runs[run][name]
                row[0].plot(*window(one.t, one.delivered, first, SHOWN), colour, lw=1.0)
                text = f"{label}: {1e3 * one.rms:.0f} mN·m RMS"
                row[1].plot(*window(one.t, 1e3 * one.error, first, SHOWN), colour, lw=1.0, label=text)
            row[0].set_ylabel(f"{name}: joint torque (N·m)")
            row[1].set_ylabel("torque error (mN·m)")
            row[1].axhline(0.0, color="k", lw=0.5)
            low, high = row[1].get_ylim()
            row[1].set_ylim(low, high + 0.45 * (high - low))
            row[1].legend(loc="upper right", fontsize=7)
            for axes in row:
                axes.grid(alpha=0.3)
        rows[0][0].legend(loc="upper right", fontsize=7)
        for axes in rows[-1]:
            axes.set_xlabel("time since torque was enabled (s)")
        figure.suptitle(f"Compensation with routing reduces the torque error of the leg by {self.reduction:.1f} %")
        outputs.save_picture(figure, self.picture, dpi=130, keeping=False)


def demo(folder: Path, seconds: float, say: Progress) -> Leg:
    """Run the leg of `folder` (as written by `tsa init --leg`) three times in virtual time.

    Raises:
        BusError: a run failed.
    """
    text = (folder / "controller.toml").read_text(encoding="utf-8")
    runs: dict[str, dict[str, Course]] = {}
    for number, run in enumerate((WITHOUT, FIXED, FOLLOWED)):
        (folder / f"controller-{run}.toml").write_text(_controller(folder, text, run), encoding="utf-8")

        def tick(share: float, run: str = run, number: int = number) -> None:
            say(f"leg, {run}", (number + share) / 3.0)

        summary = play(folder, run, seconds, tick)
        runs[run] = {name: course_of(folder, summary, seconds, name) for name in ANGLES}
    leg = Leg(runs, folder / "demo.png")
    leg.draw()
    return leg


def _controller(folder: Path, text: str, run: str) -> str:
    """Return the controller file of a run: without compensation, without routing, or with both."""
    document = tomlkit.parse(text)
    document["log"]["folder"] = run
    for axis in document["axis"]:
        if run == WITHOUT:
            axis["law"]["compensation"] = 0.0
        elif run == FIXED:
            model = tomlkit.parse((folder / str(axis["model"])).read_text(encoding="utf-8"))
            model.pop("routing", None)
            name = f"fixed-{axis['model']}"
            (folder / name).write_text(tomlkit.dumps(model), encoding="utf-8")
            axis["model"] = name
    written: str = tomlkit.dumps(document)
    return written
