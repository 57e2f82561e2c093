"""Define the common style of the pictures: sizes, colours and a light grid."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

FORWARD, BACKWARD = "#1f6fb4", "#d9622b"  # omega > 0, omega < 0
NEUTRAL, GUIDE = "#333333", "#9a9a9a"

plt.rcParams.update(
    {
        "figure.dpi": 130,
        "font.size": 9,
        "axes.titlesize": 10,
        "axes.titlelocation": "left",
        "axes.grid": True,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "grid.color": "#e6e6e6",
        "grid.linewidth": 0.7,
        "axes.axisbelow": True,
        "legend.frameon": False,
        "lines.linewidth": 1.5,
        "mathtext.fontset": "dejavusans",
    }
)


def grid(rows: int, columns: int, width: float, height: float) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure with rows x columns axes, and the axes. Width and height are in inches."""
    figure, axes = plt.subplots(rows, columns, figsize=(width, height), squeeze=False, layout="constrained")
    return figure, axes.tolist()


def save(figure: Figure, folder: Path, name: str) -> None:
    """Write a figure as PNG, and print its path."""
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / name)
    plt.close(figure)
    print(folder / name)
