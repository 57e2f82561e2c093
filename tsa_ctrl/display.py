"""Display results in a Python session as one line of text, a table in a notebook, or a picture."""

from __future__ import annotations

import html
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_POINTS = 6000  # approximate number of points of a line, because a screen shows no more
TIME = "time (s)"
_QUANTITIES = {  # name and unit of a log column in every picture
    "t": TIME,
    "tau_j": "joint torque (N·m)",
    "tau_m": "motor torque (N·m)",
    "tau_j_des": "desired joint torque (N·m)",
    "omega_j": "joint velocity (rad/s)",
    "omega_m": "motor velocity (rad/s)",
    "q_j": "joint angle (rad)",
    "q_m": "motor angle (rad)",
    "theta": "wrap angle (rad)",
    "t1": "tension of tendon a (N)",
    "t3": "tension of tendon b (N)",
    "temperature": "sheath temperature (°C)",
}


def axis_label(column: str, unit: str = "") -> str:
    """Return the axis label of a log column as quantity (unit), or of any other column from its name and `unit`."""
    return _QUANTITIES.get(column) or (f"{column} ({unit})" if unit else column)


class Displayed(ABC):
    """A result that a Python session displays. `facts` returns its rows, and `plot` returns its picture."""

    @abstractmethod
    def facts(self) -> Mapping[str, str]:
        """Return the rows to display: values with units by name."""

    @abstractmethod
    def plot(self) -> Figure:
        """Return a picture of the result, which a notebook displays and `savefig` writes."""

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{name}: {value}' for name, value in self.facts().items())})"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><th style='text-align:left'>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>"
            for name, value in self.facts().items()
        )
        return f"<table><caption>{type(self).__name__}</caption>{rows}</table>"


def lines(
    panels: Sequence[tuple[str, Mapping[str, NDArray[np.float64]]]], t: NDArray[np.float64], title: str
) -> Figure:
    """Return a picture of signals over time `t` (s), with one panel for each (axis label, lines by name)."""
    from matplotlib.figure import Figure  # slow to import

    figure = Figure(figsize=(9.0, 1.0 + 2.2 * len(panels)), layout="constrained")
    axes: Any = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    step = max(1, len(t) // MOST_POINTS)
    for axis, (label, signals) in zip(axes, panels, strict=True):
        for name, values in signals.items():
            axis.plot(t[::step], values[::step], lw=1.0, label=name)
        axis.set_ylabel(label)
        axis.legend(loc="upper right")
    axes[-1].set_xlabel(TIME)
    figure.suptitle(title)
    return figure


def bars(values: Mapping[str, float], label: str, title: str) -> Figure:
    """Return a picture of values by name as horizontal bars."""
    from matplotlib.figure import Figure  # slow to import

    figure = Figure(figsize=(7.0, 0.9 + 0.45 * len(values)), layout="constrained")
    axis = figure.subplots()
    shown = axis.barh(list(values), list(values.values()))
    axis.bar_label(shown, fmt="%.4g", padding=3)
    axis.invert_yaxis()
    axis.margins(x=0.12)
    axis.set_xlabel(label)
    axis.set_title(title)
    return figure
