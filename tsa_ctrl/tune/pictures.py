"""Pictures of a tuning, as PNG: the fit and its residual, and the torque error before and after."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tsa_ctrl.identify.dataset import Dataset
from tsa_ctrl.model.parameters import TendonSheath
from tsa_ctrl.model.predict import predict
from tsa_ctrl.tune.estimate import sliding_error
from tsa_ctrl.tune.procedure import Outcome, Verification
from tsa_ctrl.tune.run import longest

FloatArray = NDArray[np.float64]

SHOWN = 8.0  # s of a run
DPI = 120


def draw(outcome: Outcome, folder: Path) -> list[tuple[str, Path]]:
    """Write all pictures; (what it shows, file) of each."""
    log = longest(outcome.logs)
    pictures = [
        ("Measured joint torque and the predictions of the two files", _fit(log, outcome, folder / "fit.png")),
        ("Residual of the two files", _residual(log, outcome, folder / "residual.png")),
    ]
    if outcome.verification is not None:
        file = _verification(outcome.verification, folder / "verification.png")
        pictures.append(("Verification on another motion", file))
    return pictures


def _models(outcome: Outcome) -> tuple[tuple[str, TendonSheath, str], ...]:
    return (
        ("given file", outcome.nominal, "tab:red"),
        ("new file", outcome.estimate.model, "tab:blue"),
    )


def _fit(log: Dataset, outcome: Outcome, file: Path) -> Path:
    figure = Figure(figsize=(9.0, 6.5), layout="constrained")
    course, loop = figure.subplots(2, 1, height_ratios=[2, 3])
    part = log["t"] - log["t"][0] <= SHOWN
    t = (log["t"] - log["t"][0])[part]
    course.plot(t, log["tau_j"][part], "k", lw=1.6, label="measured")
    loop.plot(log["tau_m"][part], log["tau_j"][part], "k.", ms=1.0, label="measured")
    for name, model, colour in _models(outcome):
        predicted = predict(model, log.signals())[part]
        course.plot(t, predicted, colour, lw=0.9, label=name)
        loop.plot(log["tau_m"][part], predicted, ".", color=colour, ms=0.8, label=name)
    course.set(xlabel="time (s)", ylabel="joint torque (N·m)")
    loop.set(xlabel="motor torque (N·m)", ylabel="joint torque (N·m)")
    return _saved(figure, file)


def _residual(log: Dataset, outcome: Outcome, file: Path) -> Path:
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    axes = figure.subplots(2, 2)
    against = (("time (s)", "t"), ("joint speed (rad/s)", "omega_j"), ("motor torque (N·m)", "tau_m"), ("", ""))
    for name, model, colour in _models(outcome):
        residual = 1e3 * (log["tau_j"] - predict(model, log.signals()))
        rms = 1e3 * sliding_error([log], model)
        for place, (label, column) in zip(axes.flat[:3], against, strict=False):
            place.plot(log[column], residual, ".", ms=0.8, color=colour, label=f"{name}: sliding RMS {rms:.0f} mN·m")
            place.set_xlabel(label)
        axes.flat[3].hist(residual, bins=80, color=colour, alpha=0.6)
    for place in axes.flat[:3]:
        place.set_ylabel("residual (mN·m)")
    axes.flat[3].set(xlabel="residual (mN·m)", ylabel="samples")
    return _saved(figure, file)


def _verification(verification: Verification, file: Path) -> Path:
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    torque, error = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    runs = (
        ("without compensation", verification.without, "tab:grey"),
        ("given file", verification.before, "tab:red"),
        ("new file", verification.after, "tab:blue"),
    )
    part = verification.after.t <= verification.after.t[0] + SHOWN
    torque.plot(verification.after.t[part], verification.after.wanted[part], "k", lw=2.0, label="desired")
    for name, run, colour in runs:
        part = run.t <= run.t[0] + SHOWN
        torque.plot(run.t[part], run.delivered[part], colour, lw=0.9, label=name)
        shown = f"{name}: RMS {1e3 * run.rms:.0f} mN·m"
        error.plot(run.t[part], (run.delivered - run.wanted)[part], colour, lw=0.9, label=shown)
    torque.set_ylabel("joint torque (N·m)")
    error.set(xlabel="time since the enable (s)", ylabel="error (N·m)")
    return _saved(figure, file)


def _saved(figure: Figure, file: Path) -> Path:
    for axes in figure.axes:
        axes.grid(alpha=0.3)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="upper right", fontsize=8, markerscale=6.0)
    figure.savefig(file, dpi=DPI)
    return file
