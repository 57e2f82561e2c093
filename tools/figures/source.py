"""Figures 3-19 and 3-20 of the source, computed by the model and written as PNG.

Usage: tools/run figures/source [--out out/figures]

3-19: alpha + beta and |alpha - beta| against the bending angle for mu = 0.01 to 0.05, all curvature at the motor end.
3-20: joint torque and pretension over 10 s, constant and varying bending. The source prints no parameters for it; those
chosen here fit its axes (torque -1 to 2 N*m, pretension 0 to 100 N) and stand beside the picture.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from tools import command
from tools.figures import look as pictures
from tsa_ctrl.model import transmission
from tsa_ctrl.model.composition import pretension_at
from tsa_ctrl.model.curvature import Profile
from tsa_ctrl.model.functions import ARRAYS
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.predict import predict
from tsa_ctrl.model.signals import Signals

MUS = (0.01, 0.02, 0.03, 0.04, 0.05)
ACTUATOR = TendonSheath(
    motor_pulley_radius=0.020,
    joint_pulley_radius=0.020,
    axial_stiffness=60e3,
    unstrained_length=1.2,
    diameter=0.6e-3,
    contact_offset=0.4e-3,
    friction_coefficient=0.10,
    bending_angle=math.pi / 2,
    pretension=60.0,
)
SWING = 0.6  # rad, amplitude of the varying bending angle
TORQUE = (0.45, 0.85)  # N*m, mean and amplitude of the motor torque
PERIOD = 5.0  # s, of motor torque and joint motion; the bending takes twice as long


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


def figure_3_20(folder: Path) -> None:
    t = np.arange(0.0, 10.0, 1e-3)
    phase = 2.0 * math.pi * t / PERIOD
    tau_m = TORQUE[0] + TORQUE[1] * np.sin(phase)
    omega = np.cos(phase - 0.4)
    bendings = {
        "constant bending": np.full_like(t, ACTUATOR.bending_angle),
        "varying bending": ACTUATOR.bending_angle + SWING * np.sin(0.5 * phase),
    }
    figure, axes = pictures.grid(3, 2, 9.6, 6.4)
    for column, (title, theta) in enumerate(bendings.items()):
        top, middle, bottom = (axes[row][column] for row in range(3))
        log = Signals(t=t, tau_m=tau_m, omega_j=omega, theta=theta)
        simple = predict(ACTUATOR, log)
        full = predict(ACTUATOR.with_effects({"elongation_coupling": {"curvature_profile": "motor_end"}}), log)
        x = np.sign(omega) * ACTUATOR.friction_coefficient * theta
        level = pretension_at(ARRAYS, ACTUATOR, theta)
        line = transmission.full_model(ARRAYS, x, np.exp(x), np.exp(-x), level, 0.020, 0.020)
        top.plot(t, theta, color=pictures.NEUTRAL)
        top.set_title(title[0].upper() + title[1:])
        middle.plot(t, tau_m, color=pictures.GUIDE, linestyle="--", label="motor torque")
        middle.plot(t, simple, color=pictures.FORWARD, label="joint torque (3.55)")
        middle.plot(t, full, color=pictures.BACKWARD, linewidth=1.0, label="joint torque (3.53)")
        bottom.plot(t, level, color=pictures.FORWARD, label="pretension (3.56)")
        bottom.plot(
            t, line.level + line.coupling * tau_m, color=pictures.BACKWARD, linewidth=1.0, label="pretension (3.54)"
        )
        bottom.plot(t, np.abs(tau_m) / 0.040, color=pictures.GUIDE, linestyle=":", label=r"slack below $|\tau_M|/2r_M$")
        top.set_ylim(0.0, 3.0)
        middle.set_ylim(-1.0, 2.0)
        bottom.set_ylim(0.0, 100.0)
        bottom.set_xlabel("time (s)")
        for axis in (top, middle, bottom):
            axis.set_xlim(0.0, 10.0)
    for axis, label in zip(
        (row[0] for row in axes), ("bending angle Θ (rad)", "torque (N·m)", "pretension (N)"), strict=True
    ):
        axis.set_ylabel(label)
    for row in (1, 2):
        axes[row][0].legend(
            loc="lower left",
            bbox_to_anchor=(-0.01, 0.98),
            ncols=3,
            fontsize=7.5,
            borderpad=0.2,
            columnspacing=1.2,
            handlelength=1.6,
        )
    a = ACTUATOR
    figure.suptitle("Figure 3-20   Joint torque and pretension", x=0.01, ha="left")
    figure.supxlabel(
        f"Chosen to fit the printed axes: r_M = r_J = {a.motor_pulley_radius} m, EA = {a.axial_stiffness / 1e3:g} kN, "
        f"l_us = {a.unstrained_length} m, d = {a.diameter * 1e3:g} mm, p = {a.contact_offset * 1e3:g} mm, "
        f"μ = {a.friction_coefficient}, curvature at the motor end,\n"
        f"Θ = π/2 or π/2 + {SWING} sin(2π t/10 s) rad, T_p0 = {a.pretension:g} N at π/2, "
        f"τ_M = {TORQUE[0]} + {TORQUE[1]} sin(2π t/5 s) N·m, ω_J = cos(2π t/5 s − 0.4) rad/s",
        fontsize=7.5,
        x=0.01,
        ha="left",
    )
    print("3-20 with", ", ".join(f"{k} = {v:g}" for k, v in dataclasses.asdict(a).items() if isinstance(v, float)))
    pictures.save(figure, folder, "figure_3_20.png")


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument(
        "--out", type=Path, default=Path("out/figures"), help="folder for the PNGs (default out/figures)"
    )
    folder = parser.parse_args().out
    figure_3_19(folder)
    figure_3_20(folder)
    return 0
