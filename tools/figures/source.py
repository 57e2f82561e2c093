"""Draw figure 3-19 of the source from the model, and print the reference values.

Usage: tools/run figures/source [--out .readme]

The figure shows alpha + beta and |alpha - beta| over the bending angle for mu = 0.01 to 0.05, with all curvature at the
motor end.
"""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from tools import command
from tools.figures import look as pictures
from tsa_ctrl.model.curvature import Profile
from tsa_ctrl.model.functions import ARRAYS

MUS = (0.01, 0.02, 0.03, 0.04, 0.05)


def figure_3_19(folder: Path) -> None:
    theta = np.linspace(0.0, math.pi / 2, 91)
    figure, ((left, right),) = pictures.grid(1, 2, 9.2, 3.7)
    colours = plt.get_cmap("viridis")(np.linspace(0.85, 0.05, len(MUS)))
    for mu, colour in zip(MUS, colours, strict=True):
        bent = Profile.of("motor_end")
        alpha, beta = bent.mean_exponential(ARRAYS, mu * theta), bent.mean_exponential(ARRAYS, -mu * theta)
        total, difference = alpha + beta, np.abs(alpha - beta)
        left.plot(theta, total, color=colour, label=f"$\\mu$ = {mu:.2f}")
        right.plot(theta, difference, color=colour, label=f"$\\mu$ = {mu:.2f}")
        if mu in {MUS[0], MUS[-1]}:
            for axis, value in ((left, total[-1]), (right, difference[-1])):
                axis.plot(theta[-1], value, "o", color=colour, markersize=4, clip_on=False)
                axis.annotate(f"{value:.5f}", (theta[-1], value), (-4, 4), textcoords="offset points", ha="right")
            print(f"mu = {mu:.2f}, Theta = pi/2: alpha + beta = {total[-1]:.5f}, |alpha - beta| = {difference[-1]:.5f}")
    left.set_title("Sum stays near 2: the pretension hardly moves")
    right.set_title("Difference: motor torque couples into the pretension")
    left.set_ylabel(r"$(\alpha + \beta)\,/\,l_{us}$  (1)")
    right.set_ylabel(r"$|\alpha - \beta|\,/\,l_{us}$  (1)")
    left.ticklabel_format(axis="y", useOffset=False)
    left.set_ylim(1.9998, 2.0070)
    right.set_ylim(0.0, 0.175)
    for axis in (left, right):
        axis.set_xlabel(r"bending angle $\Theta$ (rad)")
        axis.set_xticks([0, math.pi / 8, math.pi / 4, 3 * math.pi / 8, math.pi / 2])
        axis.set_xticklabels(["0", "π/8", "π/4", "3π/8", "π/2"])
        axis.set_xlim(0.0, math.pi / 2)
    left.legend(loc="upper left")
    figure.suptitle("Figure 3-19   Elongation integrals, all curvature at the motor end", x=0.01, ha="left")
    pictures.save(figure, folder, "figure_3_19.png")


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("--out", type=Path, default=command.ROOT / ".readme", help="folder of the PNG")
    figure_3_19(parser.parse_args().out)
    return 0
