"""The signature of each effect: what it adds to (3.55), or to the stretch, against speed, load, angle and time, as PNG.

Usage: tools/run figures/gallery [--out out/gallery] [EFFECT ...]

One page per effect and one overview, `effects.png`, with the view in which each is recognised. All on one synthetic
60 s log of config/actuator.toml: reversals at several speeds, loads of both signs, warm-up by 15 K; for the effect
that needs it the bending varies.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from tools import command
from tools.figures import look as pictures
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.catalogue import CATALOGUE
from tsa_ctrl.model.effects.specification import Shown, Stage
from tsa_ctrl.model.functions import Array
from tsa_ctrl.model.parameters import load_tendon_sheath
from tsa_ctrl.model.predict import predict, stretch
from tsa_ctrl.model.signals import Signals, hold_direction

SHORT = (14.0, 20.0)  # s, a few reversals at several speeds
WHOLE = (0.0, 60.0)  # s
COLUMNS = 4  # of the overview


def seconds_of(shown: Shown) -> tuple[float, float]:
    """What is shown against time."""
    return SHORT if shown.short else WHOLE


def example_log(*, varying_bending: bool) -> Signals:
    """60 s at 1 kHz: joint motion of three frequencies, torque of both signs to beyond the slack bound, warm-up."""
    t = np.arange(60_000, dtype=np.float64) * 1e-3
    q = 0.5 * np.sin(2 * np.pi * 0.31 * t) + 0.22 * np.sin(2 * np.pi * 0.83 * t + 1.0) + 0.05 * np.sin(9.7 * t)
    omega = np.gradient(q, t)
    return Signals(
        t=t,
        tau_m=1.2 * np.sin(2 * np.pi * 0.13 * t) + 0.8 * np.sin(2 * np.pi * 0.47 * t),
        omega_j=omega,
        q_j=q,
        q_m=1.27 * q,
        theta=2.6 + (0.25 if varying_bending else 0.0) * np.sin(2 * np.pi * 0.021 * t),
        temperature=25.0 + 15.0 * (1.0 - np.exp(-t / 20.0)),
        acceleration_j=np.gradient(omega, t),
    )


def column(log: Signals, name: str) -> Array:
    """A signal that the example log has."""
    return np.asarray(getattr(log, name))


def since_reversal(log: Signals) -> Array:
    """Joint travel since the last reversal, rad."""
    sigma = hold_direction(log.omega_j)
    turns = np.concatenate([[0], np.flatnonzero(np.diff(sigma)) + 1])
    start = turns[np.searchsorted(turns, np.arange(len(log)), side="right") - 1]
    q = column(log, "q_j")
    return np.asarray(np.abs(q - q[start]))


def views(log: Signals, tau_j: Array) -> dict[str, tuple[str, Array]]:
    """Label and abscissa of each view."""
    return {
        "speed": ("joint velocity ω (rad/s)", log.omega_j),
        "load": ("joint torque τ_J by (3.55) (N·m)", tau_j),
        "angle": ("joint angle q (rad)", column(log, "q_j")),
        "time": ("time (s)", log.t),
        "motor": ("motor angle q_M (rad)", column(log, "q_m")),
        "since": ("travel since reversal |q − q_r| (rad)", since_reversal(log)),
        "acceleration": ("joint acceleration (rad/s²)", column(log, "acceleration_j")),
        "temperature": ("temperature (°C)", column(log, "temperature")),
        "theta": ("bending angle Θ (rad)", column(log, "theta")),
    }


@dataclass(frozen=True)
class Signature:
    """A log, what (3.55) says for it, and what one effect adds, N*m, or µm of the tendons' stretch."""

    log: Signals
    tau_j: Array
    residual: Array
    unit: str = "N·m"


def draw(axis: Axes, label: str, abscissa: Array, shown: Signature, span: tuple[float, float] | None) -> None:
    """Points coloured by direction; against time a line over `span`."""
    t, forward, residual = shown.log.t, shown.log.omega_j > 0.0, shown.residual
    if span is not None:
        chosen = (t >= span[0]) & (t <= span[1])
        axis.plot(abscissa[chosen], residual[chosen], color="#c8c8c8", linewidth=0.6, zorder=1)
        axis.set_xlim(*span)
    else:
        chosen = np.zeros(len(t), dtype=bool)
        chosen[::12] = True
    for direction, colour in ((forward, pictures.FORWARD), (~forward, pictures.BACKWARD)):
        picked = chosen & direction
        axis.plot(abscissa[picked], residual[picked], ".", color=colour, markersize=1.6, alpha=0.6, markeredgewidth=0)
    axis.set_xlabel(label)
    low, high = float(residual.min()), float(residual.max())
    margin = max(0.08 * (high - low), 0.02 * max(abs(low), abs(high)))
    axis.set_ylim(low - margin, high + margin)


def page(folder: Path, name: str, shown: Signature) -> None:
    """The four standard views, with the telling one first when it is none of them."""
    entry, every = CATALOGUE[name].shown, views(shown.log, shown.tau_j)
    keys = ["speed", "load", "angle", "time"]
    if entry.view not in keys:
        keys.insert(0, entry.view)
    figure, (axes,) = pictures.grid(1, len(keys), 3.1 * len(keys), 3.2)
    for axis, key in zip(axes, keys, strict=True):
        draw(axis, *every[key], shown, seconds_of(entry) if key == "time" else None)
    axes[0].set_ylabel(f"residual ({shown.unit})")
    values = ", ".join(f"{key} = {value}" for key, value in entry.parameters.items())
    figure.suptitle(f"{name}   {entry.equation}      {values}", x=0.01, ha="left", fontsize=10)
    axes[-1].plot([], [], ".", color=pictures.FORWARD, label="ω > 0")
    axes[-1].plot([], [], ".", color=pictures.BACKWARD, label="ω < 0")
    figure.legend(loc="upper right", ncols=2, fontsize=9)
    pictures.save(figure, folder, f"{name}.png")


def overview(folder: Path, effects: dict[str, Signature]) -> None:
    """All effects on one sheet, each in the view in which it is recognised."""
    rows = math.ceil((len(effects) + 1) / COLUMNS)  # the last cell is the legend
    figure, axes = pictures.grid(rows, COLUMNS, 14.0, 2.6 * rows)
    cells = [axis for row in axes for axis in row]
    for axis, (name, shown) in zip(cells, effects.items(), strict=False):
        entry = CATALOGUE[name].shown
        draw(
            axis, *views(shown.log, shown.tau_j)[entry.view], shown, seconds_of(entry) if entry.view == "time" else None
        )
        unit = "" if shown.unit == "N·m" else f"   ({shown.unit})"
        axis.set_title(f"{name}\n{entry.equation}{unit}", fontsize=8.5)
        axis.xaxis.label.set_fontsize(8)
        axis.tick_params(labelsize=7.5)
    for cell in cells[len(effects) :]:
        cell.axis("off")
    last = cells[len(effects)]
    last.text(0.0, 0.62, "residual = with the effect − (3.55), N·m", fontsize=9)
    last.plot([0.02], [0.45], "o", color=pictures.FORWARD)
    last.text(0.06, 0.43, "ω > 0", fontsize=9)
    last.plot([0.02], [0.30], "o", color=pictures.BACKWARD)
    last.text(0.06, 0.28, "ω < 0", fontsize=9)
    last.set_xlim(0, 1)
    last.set_ylim(0, 1)
    for row in axes:
        row[0].set_ylabel("residual (N·m)", fontsize=8)
    pictures.save(figure, folder, "effects.png")


def main() -> int:
    parser = command.parser(__name__, __doc__)
    parser.add_argument("effects", nargs="*", metavar="EFFECT", help="only these pages; default all, and the overview")
    parser.add_argument(
        "--out", type=Path, default=Path("out/gallery"), help="folder for the PNGs (default out/gallery)"
    )
    arguments = parser.parse_args()
    unknown = [name for name in arguments.effects if name not in CATALOGUE]
    if unknown:
        raise UsageError(f"unknown effect '{unknown[0]}'; known are {', '.join(CATALOGUE)}")
    model = load_tendon_sheath(command.CONFIG / "actuator.toml")
    logs = {varying: example_log(varying_bending=varying) for varying in (False, True)}
    effects = {}
    for name in arguments.effects or CATALOGUE:
        log = logs[CATALOGUE[name].shown.view == "theta"]
        tau_j = predict(model, log)
        extended = model.with_effects({name: CATALOGUE[name].shown.parameters})
        effects[name] = Signature(log, tau_j, predict(extended, log) - tau_j)
        if CATALOGUE[name].stage is Stage.STRETCH:
            effects[name] = Signature(log, tau_j, 1e6 * (stretch(extended, log) - stretch(model, log)), "µm")
        page(arguments.out, name, effects[name])
    if not arguments.effects:
        overview(arguments.out, effects)
    return 0
