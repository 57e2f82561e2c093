"""Publish a running daemon on a WebSocket from a separate process, as a client of the daemon's socket.

Topics: `/AXIS/signals` (each cycle, as far as the rate permits), `/AXIS/status` (`STATUS_RATE`), `/joint_states` (the
fields of sensor_msgs/JointState) and `/events` (foxglove.Log). Messages are JSON; log times are wall-clock times. The
layouts for Foxglove and PlotJuggler arrange the signals by the charts of the signal table.
"""

from __future__ import annotations

import json
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import foxglove
from foxglove.channels import LogChannel
from foxglove.messages import Log, LogLevel, Timestamp
from foxglove.websocket import Capability, Parameter, ServerListener

from tsa_ctrl.errors import TsaError, UsageError
from tsa_ctrl.ipc import protocol
from tsa_ctrl.ipc.client import AxisMeasured, Client, Measured
from tsa_ctrl.ipc.protocol import AnyRequest, Event
from tsa_ctrl.outputs import beside
from tsa_ctrl.signals import BANDED, CHARTS, SIGNALS, Kind, Place, Signal, signals_of

STATUS_RATE = 10.0  # Hz, of the status topics; the daemon publishes a new status at 50 Hz
BACKLOG = 4096  # messages for a slow client: some seconds at 1 kHz
EVENTS = "/events"  # topic
RECENT = 50  # events that a new subscriber receives
_TYPES = {Kind.CODE: "string", Kind.FLAG: "boolean", Kind.COUNT: "integer"}
_NUMBERS = {"type": "array", "items": {"type": "number"}}
_STAMP = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
JOINT_STATE = {
    "title": "sensor_msgs/JointState",
    "type": "object",
    "properties": {
        "header": {"type": "object", "properties": {"stamp": _STAMP, "frame_id": {"type": "string"}}},
        "name": {"type": "array", "items": {"type": "string"}},
        "position": _NUMBERS,
        "velocity": _NUMBERS,
        "effort": _NUMBERS,
    },
}


def schema_of(title: str, place: Place) -> dict[str, Any]:
    """Return the JSON schema of the signals of one axis in a place."""
    properties: dict[str, Any] = {}
    for signal in signals_of(place):
        if signal.kind is not Kind.AGE:
            kind = _TYPES.get(signal.kind, "number")
            properties[signal.name] = {"type": kind, "description": f"{signal.doc}, {signal.unit}"}
    return {"title": title, "type": "object", "properties": properties}


class Parameters(ServerListener):
    """Answer requests for live parameters. The daemon checks the role of each request.

    Each request has its own connection, because the daemon closes one that is idle for half a minute.
    """

    def __init__(self, path: str, settable: bool) -> None:
        self._path = path
        self._settable = settable
        self.subscribed = threading.Event()  # a client has subscribed to the events

    def on_subscribe(self, client: Any, channel: Any) -> None:
        """Note a new subscriber to the events."""
        if channel.topic == EVENTS:
            self.subscribed.set()

    def on_get_parameters(self, client: Any, param_names: list[str], request_id: str | None = None) -> list[Parameter]:
        """Return the parameters with these names, or all parameters if the list is empty."""
        try:
            status = self._ask(protocol.Status())
        except TsaError as error:
            self.rejected(f"parameters: {error}")
            return []
        return [
            Parameter(name, value=each["value"])
            for axis in status["axes"]
            for key, each in axis["parameters"].items()
            if each["value"] is not None and ((name := f"{axis['name']}.{key}") in param_names or not param_names)
        ]

    def on_set_parameters(
        self, client: Any, parameters: list[Parameter], request_id: str | None = None
    ) -> list[Parameter]:
        """Set parameters as `tsa set` does, and return their values afterwards."""
        for parameter in parameters:
            value = parameter.get_value()
            if not self._settable:
                self.rejected(f"{parameter.name}: parameters can only be read; start tsa live with --settable")
            elif isinstance(value, bool) or not isinstance(value, int | float):
                self.rejected(f"{parameter.name}: the value is not a number; give a number")
            else:
                try:
                    self._ask(protocol.Set(parameter.name, float(value)))
                except TsaError as error:
                    self.rejected(f"{parameter.name}: {error}")
        return self.on_get_parameters(client, [parameter.name for parameter in parameters])

    rejected: Callable[[str], None] = print

    def _ask(self, request: AnyRequest) -> dict[str, Any]:
        with Client(self._path) as client:
            return client.ask(request)


class Publisher:
    """Turn measurements, status and events of a daemon into messages of a WebSocket server."""

    def __init__(self, path: str, port: int, settable: bool) -> None:
        """Connect to the daemon and open the server.

        Args:
            path: path of the daemon's socket.
            port: port of 127.0.0.1; 0 selects a free one.
            settable: True lets clients change live parameters.

        Raises:
            BusError: no daemon answers.
            UsageError: the port is taken.
        """
        self._client = Client(path)
        status = self._client.ask(protocol.Status())
        self.axes = [axis["name"] for axis in status["axes"]]
        self._context = context = foxglove.Context()
        self._signals = [
            foxglove.Channel(f"/{name}/signals", schema=schema_of(f"{name} signals", Place.CLIENT), context=context)
            for name in self.axes
        ]
        self._status = [
            foxglove.Channel(f"/{name}/status", schema=schema_of(f"{name} status", Place.STATUS), context=context)
            for name in self.axes
        ]
        self._joints = foxglove.Channel("/joint_states", schema=JOINT_STATE, context=context)
        self._events = LogChannel(EVENTS, context=context)
        self._recent: deque[Event] = deque(maxlen=RECENT)
        self._listener = Parameters(path, settable)
        self._listener.rejected = lambda text: self._log(text, LogLevel.Warning, time.time_ns())
        try:
            self._server = foxglove.start_server(
                name=f"tsa {status['name']}",
                port=port,
                capabilities=[Capability.Parameters],
                server_listener=self._listener,
                context=context,
                message_backlog_size=BACKLOG,
            )
        except RuntimeError as error:
            raise UsageError(f"port {port} of 127.0.0.1 cannot be opened ({error}); choose another --port") from None
        self.port = self._server.port
        self.published = 0  # cycles

    def run(self, rate: float, go_on: Callable[[], bool] = lambda: True) -> None:
        """Publish the signals at `rate` (Hz) until `go_on` returns False. Raises BusError if the daemon ends."""
        last, due = -1, 0.0
        for measured in self._client.cycles(rate):
            if not go_on():
                return
            now = time.monotonic()
            zero = time.time_ns() - round(now * 1e9)  # ns since the epoch at the zero of the monotonic clock
            if measured.cycle != last:
                last = measured.cycle
                self._publish(measured, zero + round(measured.time * 1e9))
            if now >= due:
                due = now + 1.0 / STATUS_RATE
                status = self._client.ask(protocol.Status())
                self._publish_status(status["axes"], zero + round(now * 1e9))
                if status["uptime"] is not None:
                    self._publish_events(zero + round((now - status["age"] - status["uptime"]) * 1e9))

    def _publish_events(self, start: int) -> None:
        """Publish new events, and recent ones for a new subscriber; `start` of the loop is in ns since the epoch."""
        new = self._client.events()
        self._recent.extend(new)
        if self._listener.subscribed.is_set():
            self._listener.subscribed.clear()
            new = list(self._recent)
        for event in new:
            text = f"{event.axis}: {event.text}" if event.axis else event.text
            self._log(text, LogLevel.Error if event.fault else LogLevel.Info, start + round(event.t * 1e9))

    def _publish(self, measured: Measured, wall: int) -> None:
        """Publish one cycle; `wall` is its time, ns since the epoch."""
        for channel, axis in zip(self._signals, measured.axes, strict=True):
            channel.log(_values(axis), log_time=wall)
        known = [axis for axis in measured.axes if axis.q_j is not None]
        stamp = {"sec": wall // 10**9, "nsec": wall % 10**9}
        self._joints.log(
            {
                "header": {"stamp": stamp, "frame_id": ""},
                "name": [axis.name for axis in known],
                "position": [axis.q_j for axis in known],
                "velocity": [axis.omega_j or 0.0 for axis in known],
                "effort": [_effort(axis) for axis in known],
            },
            log_time=wall,
        )
        self.published += 1

    def _publish_status(self, axes: list[dict[str, Any]], wall: int) -> None:
        """Publish the status of each axis, with the ends of each band as signals."""
        for channel, axis in zip(self._status, axes, strict=True):
            found = {name: axis[name] for name in SIGNALS if name in axis and name not in BANDED}
            for name in BANDED:
                if (band := axis.get(name)) is not None:
                    found |= {name: band["value"], f"{name}_low": band["low"], f"{name}_high": band["high"]}
            channel.log({name: value for name, value in found.items() if value is not None}, log_time=wall)

    def _log(self, text: str, level: LogLevel, wall: int) -> None:
        stamp = Timestamp(wall // 10**9, wall % 10**9)
        self._events.log(Log(timestamp=stamp, level=level, message=text, name="tsa"), log_time=wall)

    def close(self) -> None:
        """Close the server and the connection."""
        self._server.stop()
        self._client.close()


def _values(axis: AxisMeasured) -> dict[str, Any]:
    """Return the signals of one axis that have a value."""
    found = {signal.name: getattr(axis, signal.name) for signal in signals_of(Place.CLIENT)}
    return {name: value for name, value in found.items() if value is not None}


def _effort(axis: AxisMeasured) -> float:
    """Return the joint torque of the best source: its sensor, the tendon elongation, the model; N*m."""
    for value in (axis.tau_j, axis.tau_j_stretch, axis.tau_j_model):
        if value is not None:
            return float(value)
    return 0.0


def topic_of(axis: str, signal: Signal) -> str:
    """Return the topic of a signal of an axis: `signals` if it is sent in each cycle, otherwise `status`."""
    return f"/{axis}/{'signals' if Place.CLIENT in signal.where else 'status'}"


def log_topic_of(axis: str, signal: Signal) -> str:
    """Return the topic of a signal of an axis in a recorded log, which has one topic for each axis."""
    return f"/{axis}"


def _charts(recorded: bool) -> tuple[Callable[[str, Signal], str], dict[str, list[Signal]]]:
    """Return the function for the topic of a signal, and the charts with the signals that the source has."""
    place = Place.LOG if recorded else Place.CLIENT | Place.STATUS
    found = {title: [each for each in signals if each.where & place] for title, signals in CHARTS.items()}
    return log_topic_of if recorded else topic_of, {title: signals for title, signals in found.items() if signals}


def foxglove_layout(axes: Sequence[str], recorded: bool = False) -> str:
    """Return a Foxglove layout: a column of plots for each axis, and the events; `recorded`: of a log, not live."""
    panels: dict[str, object] = {"Log!events": {"topicToRender": EVENTS}, "Parameters!live": {}}
    columns: list[object] = []
    topic, charts = _charts(recorded)
    for axis in axes:
        names = []
        for title, signals in charts.items():
            name = f"Plot!{axis}-{title.replace(' ', '-')}"
            names.append(name)
            panels[name] = {
                "title": f"{axis}: {title}",
                "paths": [
                    {
                        "value": f"{topic(axis, signal)}.{signal.name}",
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


def plotjuggler_layout(axes: Sequence[str], recorded: bool = False) -> str:
    """Return a PlotJuggler layout: a tab for each axis, with the same plots one below the other."""
    topic, charts = _charts(recorded)
    root = ElementTree.Element("root")
    tabs = ElementTree.SubElement(root, "tabbed_widget", {"parent": "main_window", "name": "Main Window"})
    for axis in axes:
        tab = ElementTree.SubElement(tabs, "Tab", containers="1", tab_name=axis)
        share = ";".join(f"{1.0 / len(charts):.4f}" for _ in charts)
        sizes = {"sizes": share, "count": str(len(charts)), "orientation": "-"}
        splitter = ElementTree.SubElement(ElementTree.SubElement(tab, "Container"), "DockSplitter", sizes)
        for title, signals in charts.items():
            area = ElementTree.SubElement(splitter, "DockArea", name=f"{axis}: {title}")
            plot = ElementTree.SubElement(area, "plot", style="Lines", mode="TimeSeries")
            for signal in signals:
                ElementTree.SubElement(plot, "curve", name=f"{topic(axis, signal)}/{signal.name}")
    ElementTree.SubElement(tabs, "currentTabIndex", index="0")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def write_layouts(folder: Path, axes: Sequence[str]) -> list[Path]:
    """Write the layouts for the live signals and for a log into a folder and return their paths.

    Raises:
        UsageError: a file cannot be written.
    """
    written = []
    for name, text in (
        ("foxglove.json", foxglove_layout(axes)),
        ("plotjuggler.xml", plotjuggler_layout(axes)),
        ("foxglove-log.json", foxglove_layout(axes, recorded=True)),
        ("plotjuggler-log.xml", plotjuggler_layout(axes, recorded=True)),
    ):
        with beside(folder / name) as path:
            folder.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        written.append(folder / name)
    return written
