"""Draw measured and simulated torque over time and as a hysteresis loop over the torque of the other end.

The picture also shows the residual.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl import outputs
from tsa_ctrl.display import MOST_POINTS, TIME, axis_label
from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.identify.simulate import Simulation

Array = NDArray[np.float64]

MEASURED = "#222222"
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # also distinct for colour-blind eyes


def draw(path: Path, dataset: Dataset, simulations: Sequence[Simulation]) -> None:
    """Write a picture of the simulations of one log in the format of the suffix, such as PNG.

    Raises:
        UsageError: the format is not supported, or the file cannot be written.
    """
    from matplotlib.figure import Figure  # slow to import

    quantity = simulations[0].quantity
    other = "tau_m" if quantity == "tau_j" else ("omega_m" if "omega_m" in dataset else "omega_j")
    figure = Figure(figsize=(12.0, 6.2), layout="constrained")
    axes: dict[str, Any] = figure.subplot_mosaic(
        [["torque", "loop"], ["residual", "loop"]], width_ratios=(2.2, 1.0), height_ratios=(2.0, 1.0)
    )
    _draw_time(axes["torque"], axes["residual"], dataset, simulations)
    _draw_loop(axes["loop"], dataset, simulations, other)
    axes["residual"].sharex(axes["torque"])
    axes["torque"].tick_params(labelbottom=False)
    figure.suptitle(_conclusion(dataset, simulations))
    outputs.save_picture(figure, path, dpi=130, keeping=False)  # the caller has made a backup


def _draw_time(torque: Any, residual: Any, dataset: Dataset, simulations: Sequence[Simulation]) -> None:
    quantity = simulations[0].quantity
    if quantity in dataset:
        torque.plot(*_thinned(dataset["t"], dataset[quantity]), color=MEASURED, lw=1.4, label="measured")
    for simulation, colour in zip(simulations, _colours(simulations), strict=True):
        torque.plot(*_thinned(dataset["t"], simulation.predicted), color=colour, lw=1.2, label=simulation.name)
        if simulation.residual is not None:
            label = f"{simulation.name}: RMS {simulation.rms:.4g} N·m"
            residual.plot(*_thinned(dataset["t"], simulation.residual), color=colour, lw=1.0, label=label)
    torque.set_ylabel(axis_label(quantity))
    above = (1.0, 1.0)  # so that the legends hide no data
    torque.legend(loc="lower right", bbox_to_anchor=above, ncols=2, frameon=False)
    residual.axhline(0.0, color=MEASURED, lw=0.6)
    residual.set_ylabel("residual (N·m)")
    residual.set_xlabel(TIME)
    if quantity in dataset:
        residual.legend(loc="lower right", bbox_to_anchor=above, ncols=2, frameon=False, fontsize="small")
    else:
        residual.text(0.5, 0.6, f"the log has no column {quantity}", transform=residual.transAxes, ha="center")
    for axis in (torque, residual):
        axis.grid(alpha=0.25)
        axis.margins(x=0.01)


def _draw_loop(loop: Any, dataset: Dataset, simulations: Sequence[Simulation], other: str) -> None:
    quantity = simulations[0].quantity
    x = dataset[other]
    step = max(1, len(x) // MOST_POINTS)
    if quantity in dataset:
        loop.plot(x[::step], dataset[quantity][::step], ".", color=MEASURED, ms=1.2, label="measured")
    for simulation, colour in zip(simulations, _colours(simulations), strict=True):
        loop.plot(x[::step], simulation.predicted[::step], ".", color=colour, ms=1.0, label=simulation.name)
    loop.set_xlabel(axis_label(other))
    loop.set_ylabel(axis_label(quantity))
    loop.grid(alpha=0.25)


def _thinned(t: Array, y: Array) -> tuple[Array, Array]:
    """Return the curve reduced to the smallest and the largest value of each interval, so that peaks remain."""
    stretch = len(y) // (MOST_POINTS // 2)
    if stretch < 2:
        return t, y
    whole = len(y) // stretch * stretch
    rows = y[:whole].reshape(-1, stretch)
    first = np.arange(0, whole, stretch)
    picks = np.sort(np.concatenate([first + rows.argmin(axis=1), first + rows.argmax(axis=1), [0, len(y) - 1]]))
    return t[picks], y[picks]


def _colours(simulations: Sequence[Simulation]) -> list[str]:
    return [COLOURS[i % len(COLOURS)] for i in range(len(simulations))]


def _conclusion(dataset: Dataset, simulations: Sequence[Simulation]) -> str:
    """Return the title: the error of the best model, or that the log has no measurement to compare with."""
    quantity = axis_label(simulations[0].quantity).partition(" (")[0]
    compared = [(each.rms, each.name) for each in simulations if each.rms is not None]
    if not compared:
        return f"{dataset.name}: simulated {quantity}; the log has no measurement of it"
    rms, name = min(compared)
    return f"{dataset.name}: {name} simulates the {quantity} with an RMS error of {rms:.4g} N·m"
