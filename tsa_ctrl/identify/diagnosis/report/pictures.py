"""Draw the pictures of a diagnosis from `details`; this module computes only averages for display."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tsa_ctrl.display import TIME, axis_label
from tsa_ctrl.identify.diagnosis.report.details import Curves, Details
from tsa_ctrl.identify.diagnosis.report.result import Diagnosis
from tsa_ctrl.identify.diagnosis.report.words import captions, spoken, torque_scale
from tsa_ctrl.model.functions import Array

DPI = 150  # dots per inch: enough for a sharp picture on paper and on a screen
WIDTH = 6.2  # inches: letters of 9 points remain readable on a page of 400 px
# Inches. LEFT has room for a label and numbers of seven letters, and RIGHT is a margin. BOTTOM has room for numbers and
# a label, TOP for a title of two lines, and BETWEEN for the numbers of the upper row and the title of the lower row.
LEFT, RIGHT, BOTTOM, TOP, BETWEEN = 0.8, 0.12, 0.48, 0.4, 0.55
LETTER = 0.075  # inches, width of a letter of 8 points, for names next to an axis
SEGMENT = 4.0  # s, length of a segment with large errors: single reversals remain visible
SEGMENTS = 3  # number of segments with large errors: more do not fit on a page
BINS = 40  # bins of a residual against a signal: enough for its shape, few enough for low noise
DOTS = 4000  # largest number of dots in a scatter plot, to limit the size of the picture
RANKED = 12  # largest number of bars that remain readable
MEASURED, GIVEN, CALIBRATED, EXTENDED = "black", "tab:red", "tab:orange", "tab:blue"
DESCRIBED = "tab:green"
DIRECTIONS = ((1.0, "tab:green"), (-1.0, "tab:purple"))  # direction of motion and the colour of its curves

Draw = Callable[[Diagnosis, Details], Figure]


def plot(result: Diagnosis, folder: Path) -> dict[str, Path]:
    """Write all pictures as PNG files into `folder` and return their paths by caption, in the order of the report.

    Insufficient logs have no pictures.
    """
    return {caption: draw(result, name, folder) for name, caption in captions(result).items()}


def draw(result: Diagnosis, name: str, folder: Path) -> Path:
    """Write the picture with the file name `name` into `folder`, and return its path."""
    makes: dict[str, Draw] = {
        "load.png": _load,
        "worst.png": _worst,
        "staircase.png": _staircase,
        "ranking.png": _ranking,
        "residual.png": _residual,
        "reversals.png": _reversals,
        "autocorrelation.png": _autocorrelation,
        "occupancy.png": _occupancy,
    }
    assert result.details is not None
    path = folder / name
    _save(makes[name](result, result.details), path)
    return path


def _save(figure: Figure, path: Path) -> None:
    figure.set_dpi(DPI)
    FigureCanvasAgg(figure).print_png(path, metadata={"Software": None})


def _figure(
    rows: int, columns: int, height: float, *, left: float = LEFT, top: float = TOP, between: float = BETWEEN
) -> tuple[Figure, list[Axes]]:
    """Return a figure with rows x columns axes, and its axes row by row.

    `height`, `left`, `top` and `between` are the height of the figure, its margins and the space between rows in
    inches. The margins are fixed because an automatic layout takes as long as all the drawing.
    """
    figure = Figure(figsize=(WIDTH, height))
    across = (WIDTH - left - RIGHT - (columns - 1) * left) / columns  # width of one of the axes
    along = (height - top - BOTTOM - (rows - 1) * between) / rows
    grid = figure.subplots(rows, columns, squeeze=False)
    figure.subplots_adjust(
        left=left / WIDTH,
        right=1.0 - RIGHT / WIDTH,
        bottom=BOTTOM / height,
        top=1.0 - top / height,
        wspace=left / across,
        hspace=between / along,
    )
    axes = [axes for row in grid for axes in row]
    for each in axes:
        each.grid(alpha=0.25)
        each.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _load(result: Diagnosis, details: Details) -> Figure:
    """Draw the error of the nominal and of the best model against the motor torque, for each direction of motion."""
    load, direction = _joined(details, lambda c: c.tau_m), _joined(details, lambda c: c.sigma)
    name = "extended" if result.of_torque else "recalibrated"
    nominal = _joined(details, lambda c: c.measured - c.as_given)
    best = _joined(details, lambda c: c.measured - (c.extended if result.of_torque else c.recalibrated))
    factor, unit = torque_scale(result.rms)
    figure, (axes,) = _figure(1, 1, 3.2, top=RIGHT)
    step = max(1, len(load) // DOTS)
    for sign, colour in DIRECTIONS:
        there = direction == sign
        axes.plot(load[there][::step], factor * nominal[there][::step], ".", ms=1.5, color=colour, alpha=0.25)
        for error, model, style in ((nominal, "nominal", "-"), (best, name, "--")):
            binned = _binned(load[there], factor * error[there])
            axes.plot(*binned, style, color=colour, lw=1.6, label=f"{model}, σ = {sign:+.0f}")
    band = 2.0 * factor * details.noise
    axes.axhspan(-band, band, color="grey", alpha=0.25, lw=0, label="noise, 2 sigma")
    axes.set_ylim(_span(factor * nominal))
    axes.set_xlabel("motor torque (N·m)")
    axes.set_ylabel(f"error ({unit})")
    axes.legend(fontsize=7, ncols=3)
    return figure


def _worst(result: Diagnosis, details: Details) -> Figure:
    segments = worst_segments(details)
    figure, axes = _figure(len(segments), 1, 2.4 * len(segments) + 0.6, top=0.75)
    for each, (curves, part) in zip(axes, segments, strict=True):
        t = curves.t[part]
        band = 2.0 * details.noise
        middle = curves.extended[part] if curves.described is None else curves.described[part]
        colour = EXTENDED if curves.described is None else DESCRIBED
        each.fill_between(t, middle - band, middle + band, color=colour, alpha=0.15, lw=0, label="noise, 2 sigma")
        each.plot(t, curves.measured[part], color=MEASURED, lw=1.6, label="measured")
        each.plot(t, curves.as_given[part], color=GIVEN, lw=1.0, ls=":", label="nominal")
        each.plot(t, curves.recalibrated[part], color=CALIBRATED, lw=1.0, label="recalibrated")
        if result.of_torque:
            each.plot(t, curves.extended[part], color=EXTENDED, lw=1.0, label="extended")
        if curves.described is not None:
            each.plot(t, middle, color=DESCRIBED, lw=1.0, label="with the formula")
        each.set_ylabel(axis_label(details.target))
        each.set_title(curves.name, loc="left", fontsize=9)
    axes[-1].set_xlabel(TIME)
    figure.legend(*axes[0].get_legend_handles_labels(), fontsize=8, ncols=3, loc="upper center")
    return figure


def worst_segments(details: Details) -> list[tuple[Curves, slice]]:
    """Return up to SEGMENTS segments with the largest errors after recalibration, worst first, without overlap.

    A segment lasts SEGMENT s, or less at the end of a log.
    """
    width = max(2, round(SEGMENT / details.period))
    scored = []
    for number, curves in enumerate(details.curves):
        error = np.square(curves.measured - curves.recalibrated)
        for start in range(0, max(1, len(error) - width // 2), width):
            part = slice(start, min(start + width, len(error)))
            scored.append((-float(np.mean(error[part])), number, start, part))
    chosen = sorted(scored, key=lambda entry: entry[:3])[:SEGMENTS]
    return [(details.curves[number], part) for _, number, _, part in chosen]


def _staircase(result: Diagnosis, details: Details) -> Figure:
    steps = [("nominal", result.rms.as_given, GIVEN), ("recalibrated", result.rms.recalibrated, CALIBRATED)]
    if result.of_torque:
        steps.append(("extended", result.rms.extended, EXTENDED))
    if result.formula is not None:
        steps.append(("with the formula", result.formula.rms[1], DESCRIBED))
    steps.append(("sensor noise", result.rms.noise_floor, "grey"))
    factor, unit = torque_scale(result.rms)
    figure, (axes,) = _figure(1, 1, 2.8)
    for place, (name, value, colour) in enumerate(steps):
        if value is not None:
            axes.bar(place, factor * value, color=colour, width=0.6)
            axes.annotate(f"{factor * value:.3g}", (place, factor * value), ha="center", va="bottom")
        axes.text(place, 0.0, f"\n{name}", ha="center", va="top", fontsize=8)
    axes.set_xticks([])
    axes.margins(y=0.15)
    axes.set_ylabel(f"RMS error ({unit})")
    axes.set_title(fill(f"held-out data: {details.held_out}", 90), loc="left", fontsize=8)
    return figure


def _ranking(result: Diagnosis, details: Details) -> Figure:
    ranked = details.ranking if result.of_torque else details.ranking[:RANKED]
    names = [spoken(entry.effect) for entry in ranked]
    left = LETTER * max(map(len, names), default=0) + 0.2
    figure, (axes,) = _figure(1, 1, 0.3 * max(3, len(ranked)) + 1.0, left=left, top=RIGHT)
    across = WIDTH - left - RIGHT
    ends = [1.1 * entry.gain for entry in ranked]  # possible ends of the axis, with room for bars and labels
    seen: set[int] = set()
    for place, entry in enumerate(ranked):
        named = entry.group >= 0 and entry.group not in seen
        seen.add(entry.group)
        colour = "lightgrey" if entry.group < 0 or entry.excluded else f"C{entry.group}"
        axes.barh(place, entry.gain, color=colour, alpha=1.0 if named or entry.group < 0 else 0.5, height=0.7)
        if entry.group >= 0:
            role = "excluded" if entry.excluded else "not excluded"
            told = f"cause {entry.group + 1}" if named else f"instead of cause {entry.group + 1}: {role}"
            axes.text(entry.gain, place, f" {told}", va="center", fontsize=8)
            ends.append(entry.gain * across / (across - LETTER * (len(told) + 1)))
    axes.set_yticks(range(len(ranked)), names, fontsize=8)
    axes.grid(visible=False, axis="y")
    axes.invert_yaxis()
    shown = "share of the gain lost without the cause" if result.of_torque else "decrease of the whitened mean square"
    axes.set_xlabel(shown)
    axes.set_xlim(0.0, max(ends, default=0.0) or None)
    return figure


def _span(values: Array) -> tuple[float, float]:
    """Return the limits of an axis that shows 99 % of the values, with a margin.

    On a full axis, single large values at reversals would hide the others.
    """
    low, high = (float(value) for value in np.quantile(values, [0.005, 0.995]))
    margin = 0.15 * (high - low) or 1.0
    return low - margin, high + margin


def _residual(result: Diagnosis, details: Details) -> Figure:
    error = _joined(details, lambda c: c.measured - c.recalibrated)
    left = _joined(details, lambda c: c.measured - c.extended)
    direction = _joined(details, lambda c: c.sigma)
    factor, unit = torque_scale(result.rms)
    signals = [
        ("joint velocity (rad/s)", _joined(details, lambda c: c.omega)),
        ("angle (rad)", _joined(details, lambda c: c.angle)),
        ("time, logs in sequence (s)", np.arange(len(error)) * details.period),
    ]
    temperatures = [curves.temperature for curves in details.curves]
    if all(values is not None for values in temperatures):
        signals.append(("sheath temperature (°C)", np.concatenate([v for v in temperatures if v is not None])))
    rows = (len(signals) + 1) // 2
    figure, axes = _figure(rows, 2, 2.7 * rows + 0.4, top=RIGHT)
    step = max(1, len(error) // DOTS)
    span = _span(factor * error)
    for each, (name, signal) in zip(axes, signals, strict=False):
        each.plot(signal[::step], factor * error[::step], ".", ms=1.5, color="lightgrey")
        for sign, colour in DIRECTIONS:
            there = direction == sign
            each.plot(
                *_binned(signal[there], factor * error[there]),
                color=colour,
                lw=1.4,
                label=f"recalibrated, σ = {sign:+.0f}",
            )
            if result.of_torque:
                each.plot(
                    *_binned(signal[there], factor * left[there]), color=colour, lw=1.2, ls="--", label="extended"
                )
        each.set_ylim(span)
        each.set_xlabel(name)
        each.set_ylabel(f"residual ({unit})")
    for each in axes[len(signals) :]:
        each.set_visible(False)
    axes[0].legend(fontsize=7)
    return figure


def _reversals(result: Diagnosis, details: Details) -> Figure:
    figure, axes = _figure(1, 2, 3.2, top=RIGHT)
    error = _joined(details, lambda c: (c.measured - c.recalibrated) * c.sigma)
    left = _joined(details, lambda c: (c.measured - c.extended) * c.sigma)
    factor, unit = torque_scale(result.rms)
    for each, signal, name in (
        (axes[0], _joined(details, lambda c: c.elapsed), "time since the reversal (s)"),
        (axes[1], _joined(details, lambda c: c.distance), "travel since the reversal (rad)"),
    ):
        near = signal <= np.quantile(signal, 0.6)
        each.plot(*_binned(signal[near], factor * error[near]), color=CALIBRATED, label="recalibrated")
        if result.of_torque:
            each.plot(*_binned(signal[near], factor * left[near]), color=EXTENDED, label="extended")
        each.axhline(0.0, color="k", lw=0.5)
        each.set_xlabel(name)
        each.set_ylabel(f"σ · residual, mean ({unit})")
    axes[0].legend(fontsize=8)
    return figure


def _autocorrelation(result: Diagnosis, details: Details) -> Figure:
    figure, (axes,) = _figure(1, 1, 2.6, top=RIGHT)
    lags = np.arange(1, len(details.autocorrelation)) * details.period
    axes.vlines(lags, 0.0, details.autocorrelation[1:], color=EXTENDED, lw=2)
    axes.axhspan(-details.band, details.band, color="grey", alpha=0.25, lw=0, label="95 % of white noise")
    axes.axhline(0.0, color="k", lw=0.5)
    axes.set_xlabel("lag (s)")
    axes.set_ylabel("autocorrelation")
    axes.legend(fontsize=8)
    return figure


def _occupancy(result: Diagnosis, details: Details) -> Figure:
    figure, (axes,) = _figure(1, 1, 3.4)
    axes.grid(visible=False)
    found = details.audit
    share = 100.0 * np.ma.masked_equal(found.occupancy.T, 0.0)
    image = axes.pcolormesh(found.speed_edges, found.load_edges, share, cmap="viridis")
    figure.colorbar(image, ax=axes, label="share of the samples (%)")
    axes.set_xlabel("joint velocity (rad/s)")
    axes.set_ylabel("motor torque (N·m)")
    axes.set_title(f"{found.seconds:.0f} s, {found.reversals} reversals", loc="left", fontsize=9)
    return figure


def _joined(details: Details, of: Callable[[Curves], Array]) -> Array:
    return np.concatenate([of(curves) for curves in details.curves])


def _binned(signal: Array, value: Array) -> tuple[Array, Array]:
    """Return the means of signal and value over BINS bins with equal numbers of samples, sorted by the signal.

    Fewer samples than BINS are returned unchanged.
    """
    if len(signal) < BINS:
        return signal, value
    order = np.argsort(signal, kind="stable")
    parts = np.array_split(order, BINS)
    return np.array([signal[p].mean() for p in parts]), np.array([value[p].mean() for p in parts])
