"""Layouts for Foxglove and PlotJuggler that show the signals of `tsa live`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from tsa_ctrl.outputs import beside
from tsa_ctrl.signals import CHARTS, Place, Signal


def topic_of(axis: str, signal: Signal) -> str:
    """Return the topic that has a signal of an axis: of each cycle, else of the status."""
    return f"/{axis}/{'signals' if Place.CLIENT in signal.where else 'status'}"


def foxglove_layout(axes: Sequence[str]) -> str:
    """Return a Foxglove layout: a column of plots for each axis, and the events."""
    panels: dict[str, object] = {"Log!events": {"topicToRender": "/events"}, "Parameters!live": {}}
    columns: list[object] = []
    for axis in axes:
        names = []
        for title, signals in CHARTS.items():
            name = f"Plot!{axis}-{title.replace(' ', '-')}"
            names.append(name)
            panels[name] = {
                "title": f"{axis}: {title}",
                "paths": [
                    {
                        "value": f"{topic_of(axis, signal)}.{signal.name}",
                        "enabled": True,
                        "timestampMethod": "receiveTime",
                    }
                    for signal in signals
                ],
                "showLegend": True,
                "isSynced": True,
                "followingViewWidth": 10,
            }
        columns.append(_split(names, "column"))
    plots = _split(columns, "row")
    layout = {
        "first": plots,
        "second": _split(["Log!events", "Parameters!live"], "row"),
        "direction": "column",
        "splitPercentage": 75,
    }
    return json.dumps(
        {
            "configById": panels,
            "globalVariables": {},
            "userNodes": {},
            "playbackConfig": {"speed": 1},
            "layout": layout,
        },
        indent=1,
    )


def _split(panels: Sequence[object], direction: str) -> object:
    """Return a mosaic that divides its area among the panels evenly."""
    if len(panels) == 1:
        return panels[0]
    return {
        "first": panels[0],
        "second": _split(panels[1:], direction),
        "direction": direction,
        "splitPercentage": 100.0 / len(panels),
    }


def plotjuggler_layout(axes: Sequence[str]) -> str:
    """Return a PlotJuggler layout: a tab for each axis, with the same plots one below the other."""
    root = ElementTree.Element("root")
    tabs = ElementTree.SubElement(root, "tabbed_widget", {"parent": "main_window", "name": "Main Window"})
    for axis in axes:
        tab = ElementTree.SubElement(tabs, "Tab", containers="1", tab_name=axis)
        share = ";".join(f"{1.0 / len(CHARTS):.4f}" for _ in CHARTS)
        sizes = {"sizes": share, "count": str(len(CHARTS)), "orientation": "-"}
        splitter = ElementTree.SubElement(ElementTree.SubElement(tab, "Container"), "DockSplitter", sizes)
        for title, signals in CHARTS.items():
            area = ElementTree.SubElement(splitter, "DockArea", name=f"{axis}: {title}")
            plot = ElementTree.SubElement(area, "plot", style="Lines", mode="TimeSeries")
            for signal in signals:
                ElementTree.SubElement(plot, "curve", name=f"{topic_of(axis, signal)}/{signal.name}")
    ElementTree.SubElement(tabs, "currentTabIndex", index="0")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def write(folder: Path, axes: Sequence[str]) -> list[Path]:
    """Write both layouts into a folder and return their paths; raises UsageError if it cannot be written."""
    written = []
    for name, text in (("foxglove.json", foxglove_layout(axes)), ("plotjuggler.xml", plotjuggler_layout(axes))):
        with beside(folder / name) as path:
            folder.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        written.append(folder / name)
    return written
