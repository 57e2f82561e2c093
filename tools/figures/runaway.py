"""Draw runaway and passive runs by the compensation and the plant's share of the model's friction, for each load.

Usage: tools/run figures/runaway [--out .readme] [--quick]

The lines are the condition c h_model = h_true. The points are runs of the real loop in virtual time at set-point 0, on
distributed tendons with a share of the model file's pretension. The joint is nudged once, and the guard never acts. A
point is a runaway if friction and compensation together did positive work on the joint after the nudge, and otherwise
passive.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.lines import Line2D

from tools import command
from tools.campaign.passive.experiment import Experiment
from tools.campaign.passive.judge import power
from tools.figures import look
from tsa_ctrl.virtual.script import Fault

LOADS = ("weight", "spring", "free", "limb")
LEFT = (0.2, 0.4, 0.6, 0.8)  # h_true / h_model of the friction torque h, for which c is at most 1 with BESIDE
BESIDE = (-0.2, -0.05, 0.05, 0.2)  # difference between c and this share
NUDGED, SECONDS = 0.4, 0.8  # s of the log at the nudge, and s from the nudge to the end
ASLEEP = 100.0  # J, threshold that is too large for the guard to act


def work(load: str, left: float, compensation: float) -> float:
    """Return the work on the joint after the nudge at set-point 0, J."""
    asleep = {"law": {"settle": 0.0}, "passivity": {"energy": ASLEEP}}
    rig = Experiment(load, "zero", pretension=left, compensation=compensation, fade_in=0.1, axis=asleep)
    result = rig.play(NUDGED + SECONDS, [Fault("push value=0.8 duration=0.05", NUDGED)])
    return float(np.sum(power(result, NUDGED)[1]))


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--out", type=Path, default=command.ROOT / ".readme")
    parser.add_argument("--quick", action="store_true", help="only one share of the friction for each load")
    options = parser.parse_args()
    figure, (axes,) = look.grid(1, len(LOADS), 11.0, 3.2)
    agree = total = 0
    for axis, load in zip(axes, LOADS, strict=True):
        line = np.array([0.0, 1.1])
        axis.fill_between(line, line, 1.1, color=look.BACKWARD, alpha=0.10, linewidth=0.0)
        axis.fill_between(line, 0.0, line, color=look.FORWARD, alpha=0.10, linewidth=0.0)
        axis.plot(line, line, color=look.NEUTRAL, linewidth=1.0)
        for left in LEFT[1:2] if options.quick else LEFT:
            for beside in BESIDE:
                compensation = round(left + beside, 3)
                given = work(load, left, compensation)
                runs = given > 0.0
                total += 1
                agree += runs is (beside > 0.0)
                print(f"{load}: h {left:g}, c {compensation:g}: {1e3 * given:+.1f} mJ", flush=True)
                colour = look.BACKWARD if runs else look.FORWARD
                axis.plot(left, compensation, "o" if runs else "s", color=colour, markersize=4)
        axis.set(xlim=(0.0, 1.1), ylim=(0.0, 1.1), title=load, xlabel="h true / h model (1)")
    axes[0].set_ylabel("compensation c (1)")
    marks = [
        Line2D([], [], marker="o", linestyle="", markersize=4, color=look.BACKWARD, label="given: moves by itself"),
        Line2D([], [], marker="s", linestyle="", markersize=4, color=look.FORWARD, label="taken: passive"),
        Line2D([], [], color=look.NEUTRAL, linewidth=1.0, label="condition"),
    ]
    axes[0].legend(handles=marks, loc="upper left", fontsize=7)
    look.save(figure, options.out, "runaway.png")
    print(f"{agree} of {total} points are on the side of the line that the condition predicts")
    return 0
