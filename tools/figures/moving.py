"""Draw the animations of the README: a joint that lifts a weight, and a leg whose joints bend its sheaths.

Usage: tools/run figures/moving [--leg] [--out .readme/moving.gif] [--seconds 6] [--rate 12] [--from FOLDER]

The command runs `tsa demo --virtual --load weight`, or uses the output folder of such a run (--from). It draws the
angle of the joint encoder, the desired torque and the torque of the joint sensor. With --leg it runs `tsa demo --leg`,
and draws the angles of hip, knee and ankle, and the knee's torque error without and with `[routing]`.
"""

from __future__ import annotations

import argparse
import math
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from numpy.typing import NDArray

from tools import command
from tools.figures import look
from tsa_ctrl.demo.rig import FADE_IN
from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.table import load_run
from tsa_ctrl.system.process_supervisor import tsa

Columns = dict[str, NDArray[np.float64]]

RUNS = {"without": ("without compensation", look.BACKWARD), "with": ("with compensation", look.FORWARD)}
MARGIN = 2.0  # s of the run that are not drawn: fade-in and stop
DPI = 80
ARM = 2.6  # length of the arm in the drawing, in radii of the joint's pulley


def run(folder: Path, seconds: float) -> None:
    """Run the demo in virtual time."""
    line = tsa("demo", "--virtual", "--load", "weight", "--seconds", f"{seconds + MARGIN:g}", "--out", str(folder))
    subprocess.run(line, check=True, capture_output=True)


def course(folder: Path, seconds: float) -> Columns:
    """Return the measured columns of a run, with `t` from 0.

    Raises:
        UsageError: The folder has no log.
    """
    logs = sorted(folder.glob("*.mcap"))
    if not logs:
        raise UsageError(f"{folder}: no log in it; give a folder that `tsa demo --out` left")
    columns = load_run(logs[-1], ("q_j",), FADE_IN, FADE_IN + seconds)
    return {**columns, "t": columns["t"] - columns["t"][0]}


class Panel:
    """Draw one run, with the joint on the left and its torque on the right."""

    def __init__(self, drawing: Axes, chart: Axes, columns: Columns, words: str, colour: str, seconds: float) -> None:
        self._columns = columns
        drawing.set(xlim=(-3.2, 3.2), ylim=(-3.2, 3.2), aspect="equal")
        drawing.axis("off")
        drawing.add_patch(Circle((0.0, 0.0), 1.0, fill=False, lw=1.5, color=look.NEUTRAL))
        for side in (-1.0, 1.0):
            drawing.plot([-3.2, 0.0], [side, side], color=look.GUIDE, lw=2.0)
        (self._arm,) = drawing.plot([], [], color=look.NEUTRAL, lw=3.0, solid_capstyle="round")
        (self._weight,) = drawing.plot([], [], "s", color=colour, ms=11)
        chart.set(xlim=(0.0, seconds), ylabel="joint torque (N·m)", title=words)
        (self._wanted,) = chart.plot([], [], color=look.GUIDE, label="desired")
        (self._delivered,) = chart.plot([], [], color=colour, label="delivered")
        chart.legend(loc="upper right", ncols=2)

    @property
    def extreme(self) -> float:
        return float(max(np.abs(self._columns[name]).max() for name in ("tau_j_des", "tau_j")))

    def show(self, t: float) -> list[Artist]:
        """Draw the state at `t` s, and return the changed lines."""
        until = int(np.searchsorted(self._columns["t"], t, side="right"))
        angle = float(self._columns["q_j"][max(until - 1, 0)])
        x, y = ARM * math.sin(angle), -ARM * math.cos(angle)
        self._arm.set_data([0.0, x], [0.0, y])
        self._weight.set_data([x], [y])
        changed: list[Line2D] = [self._arm, self._weight]
        every = slice(0, until, 10)  # every tenth sample of 1 kHz, because a pixel is wider
        for line, name in ((self._wanted, "tau_j_des"), (self._delivered, "tau_j")):
            line.set_data(self._columns["t"][every], self._columns[name][every])
            changed.append(line)
        return [*changed]


def draw(runs: dict[str, Columns], seconds: float, rate: float, out: Path) -> None:
    """Write the animation of both runs, with `rate` frames per second."""
    figure, axes = look.grid(len(runs), 2, 6.4, 3.6)
    panels = [Panel(row[0], row[1], runs[name], *RUNS[name], seconds) for row, name in zip(axes, RUNS, strict=True)]
    largest = 1.15 * max(panel.extreme for panel in panels)
    for _, chart in axes:
        chart.set_ylim(-largest, 1.4 * largest)
    film(figure, axes, panels, seconds, rate, out)


LEG = {"fixed": ("without routing", look.BACKWARD), "with": ("with routing", look.FORWARD)}
BONES = {"hip": 0.43, "knee": 0.43, "ankle": 0.2}  # m: thigh, shank, foot
JOINT = "knee"


class Limb:
    """Draw one run of the leg, with its bones on the left and the torque error of the knee on the right."""

    def __init__(self, drawing: Axes, chart: Axes, run: dict[str, Columns], words: str, colour: str) -> None:
        self._run = run
        self._error = 1e3 * (run[JOINT]["tau_j"] - run[JOINT]["tau_j_des"])
        drawing.set(xlim=(-0.6, 0.6), ylim=(-1.05, 0.15))
        drawing.set_aspect("equal")
        drawing.axis("off")
        (self._bones,) = drawing.plot([], [], "o-", color=look.NEUTRAL, lw=4.0, ms=8, mfc=colour)
        chart.set(ylabel="knee error (mN·m)", title=f"{words}: {self.rms:.0f} mN·m RMS")
        chart.axhline(0.0, color=look.GUIDE, lw=1.0)
        (self._line,) = chart.plot([], [], color=colour)

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(np.square(self._error))))

    @property
    def extreme(self) -> float:
        return float(np.abs(self._error).max())

    def show(self, t: float) -> list[Artist]:
        """Draw the state at `t` s, and return the changed lines."""
        x, y, direction = [0.0], [0.0], 0.0
        for name, length in BONES.items():
            columns = self._run[name]
            angle = float(np.interp(t, columns["t"], columns["q_j"]))
            direction += {"hip": angle, "knee": -angle, "ankle": 0.5 * math.pi + angle}[name]
            x.append(x[-1] + length * math.sin(direction))
            y.append(y[-1] - length * math.cos(direction))
        self._bones.set_data(x, y)
        times = self._run[JOINT]["t"]
        every = slice(0, int(np.searchsorted(times, t, side="right")), 4)
        self._line.set_data(times[every], self._error[every])
        return [self._bones, self._line]


def draw_leg(folder: Path, seconds: float, rate: float, out: Path) -> None:
    """Write the animation of the leg without and with routing, from the logs of `tsa demo --leg --out folder`."""
    figure, axes = look.grid(len(LEG), 2, 6.4, 3.6)
    panels = []
    for row, (name, words) in zip(axes, LEG.items(), strict=True):
        log = sorted((folder / name).glob("*.mcap"))[-1]
        run = {joint: load_run(f"{log}:{joint}", ("q_j",), FADE_IN, FADE_IN + seconds) for joint in BONES}
        run = {joint: {**columns, "t": columns["t"] - columns["t"][0]} for joint, columns in run.items()}
        panels.append(Limb(row[0], row[1], run, *words))
    largest = 1.1 * max(panel.extreme for panel in panels)
    for _, chart in axes:
        chart.set(xlim=(0.0, seconds), ylim=(-largest, largest))
    film(figure, axes, panels, seconds, rate, out)


def film(
    figure: Figure, axes: list[list[Axes]], panels: Sequence[Panel | Limb], seconds: float, rate: float, out: Path
) -> None:
    """Write the animation of the panels, with `rate` frames per second."""
    for drawing, chart in axes:
        drawing.set_box_aspect(1.0)
        chart.set_box_aspect(0.42)
    axes[-1][1].set_xlabel("time (s)")
    frames = np.arange(0.0, seconds, 1.0 / rate)
    moving = FuncAnimation(figure, lambda t: [a for panel in panels for a in panel.show(t)], frames=frames, blit=False)
    moving.save(out, writer=PillowWriter(fps=round(rate)), dpi=DPI)


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--leg", action="store_true", help="draw the leg (default file .readme/leg_moving.gif)")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--rate", type=float, default=12.0, help="frames per second")
    parser.add_argument("--from", type=Path, dest="folder", help="output folder of tsa demo --out")
    asked: argparse.Namespace = parser.parse_args()
    out = asked.out or command.ROOT / ".readme" / ("leg_moving.gif" if asked.leg else "moving.gif")
    with tempfile.TemporaryDirectory(prefix="tsa-moving-") as name:
        folder = asked.folder or Path(name)
        if asked.leg:
            if asked.folder is None:
                line = tsa("demo", "--leg", "--seconds", f"{asked.seconds + MARGIN:g}", "--out", str(folder))
                subprocess.run(line, check=True, capture_output=True)
            draw_leg(folder, asked.seconds, asked.rate, out)
        else:
            if asked.folder is None:
                run(folder, asked.seconds)
            draw({run: course(folder / run, asked.seconds) for run in RUNS}, asked.seconds, asked.rate, out)
    print(f"{out}: {out.stat().st_size / 1000:.0f} kB")
    return 0
