"""A rig's health as a picture: each quantity over the runs with its intervals, changes as lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.quantity import spelled
from tsa_ctrl.identify.simulation_picture import COLOURS, MEASURED
from tsa_ctrl.identify.trend import WORDS, Trend


def draw(path: Path, found: Trend) -> None:
    """Write it as PNG (or what the ending says). Raises UsageError."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = [name for name in WORDS if any(name in run.quantities for run in found.runs)]
    figure, axes = pyplot.subplots(len(names), 1, figsize=(9.0, 2.6 * len(names)), sharex=True, squeeze=False)
    try:
        for axis, name in zip(axes[:, 0], names, strict=True):
            places = [k for k, run in enumerate(found.runs) if name in run.quantities]
            quantities = [found.runs[k].quantities[name] for k in places]
            values = np.array([quantity.value for quantity in quantities])
            reach = [values - [q.low for q in quantities], [q.high for q in quantities] - values]
            axis.errorbar(places, values, yerr=np.maximum(reach, 0.0), fmt="o", color=MEASURED, capsize=3)
            for change in found.changes:
                if change.quantity == name:
                    since = next(k for k, run in enumerate(found.runs) if run.log == change.since)
                    axis.axvline(since - 0.5, color=COLOURS[1])
            axis.set_ylabel(f"{name.replace('_', ' ')} ({spelled(quantities[0].unit)})")
            axis.grid(alpha=0.3)
        axes[-1, 0].set_xticks(range(len(found.runs)), [run.log for run in found.runs], rotation=30, ha="right")
        figure.tight_layout()
        try:
            figure.savefig(path, dpi=130)
        except (ValueError, OSError) as error:
            raise UsageError(f"{path}: cannot be written ({error}); choose a name that ends with .png") from None
    finally:
        pyplot.close(figure)
