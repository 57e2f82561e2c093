"""Test `tsa live` with an independent WebSocket client and a real socket server."""

from __future__ import annotations

import contextlib
import json
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import msgspec
import pytest
from mcap.reader import make_reader

from tests.daemon.serving import PATIENCE
from tests.dashboard.playing import Played
from tests.log.logs import HEADER, write_log
from tsa_ctrl.errors import UsageError
from tsa_ctrl.ipc.client import Client
from tsa_ctrl.ipc.connection import CLIENTS
from tsa_ctrl.ipc.mailbox import Command
from tsa_ctrl.ipc.protocol import Event

pytest.importorskip("foxglove")
client = pytest.importorskip("websockets.sync.client")

from tsa_ctrl.live import Publisher, write_layouts  # noqa: E402 (after the check that the extra is there)


class Loop:
    """A simulated daemon and its publisher."""

    def __init__(self, path: Path, settable: bool) -> None:
        self.daemon = Played(path)
        self.serving = self.daemon.serving
        self.publisher = Publisher(self.daemon.path, 0, settable)
        self._running = True
        self._thread = threading.Thread(target=self.publisher.run, args=(1000.0, lambda: self._running), daemon=True)
        self._thread.start()

    def end(self) -> None:
        self._running = False
        self._thread.join(PATIENCE)
        self.publisher.close()
        self.daemon.end()


class Reader:
    """A client of the Foxglove WebSocket protocol."""

    def __init__(self, port: int) -> None:
        self.socket = client.connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"])
        self.channels: dict[str, Any] = {}
        while len(self.channels) < 6:
            message = json.loads(self.socket.recv(PATIENCE))
            if message["op"] == "advertise":
                self.channels |= {channel["topic"]: channel for channel in message["channels"]}

    def subscribe(self, *topics: str) -> None:
        wanted = [{"id": number, "channelId": self.channels[topic]["id"]} for number, topic in enumerate(topics)]
        self.socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def message(self) -> tuple[int, int, Any]:
        """Return subscription, time (ns) and content of the next message."""
        while True:
            data = self.socket.recv(PATIENCE)
            if isinstance(data, bytes) and data[0] == 1:
                number, stamp = struct.unpack_from("<IQ", data, 1)
                return number, stamp, data[13:]

    def answer(self, operation: str) -> Any:
        while True:
            data = self.socket.recv(PATIENCE)
            if isinstance(data, str) and (message := json.loads(data))["op"] == operation:
                return message


@pytest.fixture
def loop(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Loop]:
    found = Loop(tmp_path / "tsa.sock", getattr(request, "param", False))
    yield found
    found.end()


def test_a_client_reads_the_signals_of_each_axis_with_their_times(loop: Loop) -> None:
    """Each cycle arrives at most once and in order. A signal without a value is omitted."""
    reader = Reader(loop.publisher.port)
    assert set(reader.channels) == {
        "/knee/signals", "/knee/status", "/hip/signals", "/hip/status", "/joint_states", "/events",
    }  # fmt: skip
    assert json.loads(reader.channels["/knee/signals"]["schema"])["properties"]["tau_m"]["type"] == "number"
    reader.subscribe("/hip/signals")
    found = [reader.message() for _ in range(100)]
    values = [json.loads(content) for _, _, content in found]
    assert all(value["q_j"] == 0.5 and "tau_j" not in value for value in values)
    torques, times = [value["tau_m"] for value in values], [stamp for _, stamp, _ in found]
    assert torques == sorted(set(torques))
    assert times == sorted(set(times))
    assert abs(times[-1] * 1e-9 - time.time()) < PATIENCE


def test_joint_states_have_the_fields_of_ros_and_the_status_the_signals_that_a_cycle_lacks(loop: Loop) -> None:
    reader = Reader(loop.publisher.port)
    assert reader.channels["/joint_states"]["schemaName"] == "sensor_msgs/JointState"
    reader.subscribe("/joint_states", "/knee/status")
    found: dict[int, tuple[int, Any]] = {}
    while len(found) < 2:
        number, stamp, content = reader.message()
        found[number] = (stamp, json.loads(content))
    (stamp, state), (_, status) = found[0], found[1]
    assert (state["name"], state["position"], len(state["effort"])) == (["knee", "hip"], [0.25, 0.5], 2)
    assert state["header"]["stamp"]["sec"] == stamp // 10**9
    assert status["state"] == "operation_enabled"
    assert {"sigma", "friction_term", "pretension", "tau_j_stretch", "tau_j_stretch_low"} <= set(status)
    assert "tau_j_model" not in status


def test_events_are_log_messages_also_for_a_client_that_comes_later(loop: Loop) -> None:
    event = Event(0, 1.0, "knee", "stale PDO: gone", fault=True, cause_id="stale_pdo")
    loop.serving.mailbox.publish_text(msgspec.json.encode([event]))
    for _ in range(2):
        reader = Reader(loop.publisher.port)
        assert reader.channels["/events"]["schemaName"] == "foxglove.Log"
        reader.subscribe("/events")
        assert b"knee: stale PDO: gone" in reader.message()[2]


def test_parameters_can_be_read_and_only_with_settable_be_set(loop: Loop) -> None:
    reader = Reader(loop.publisher.port)
    reader.socket.send(json.dumps({"op": "getParameters", "parameterNames": ["knee.compensation"], "id": "1"}))
    (parameter,) = reader.answer("parameterValues")["parameters"]
    assert (parameter["name"], parameter["value"]) == ("knee.compensation", 0.95)
    change = {"op": "setParameters", "parameters": [{"name": "knee.compensation", "value": 0.5}], "id": "2"}
    reader.socket.send(json.dumps(change))
    (parameter,) = reader.answer("parameterValues")["parameters"]
    assert parameter["value"] == 0.95
    assert loop.daemon.taken == []


@pytest.mark.parametrize("loop", [True], indirect=True)
def test_a_settable_parameter_passes_the_daemon_and_its_bounds(loop: Loop) -> None:
    """A value that is not a number is rejected with this reason."""
    reader = Reader(loop.publisher.port)
    for value, taken in ((0.5, [Command(0, 0, 0.5)]), (9.0, []), ("on", []), (True, [])):
        change = {"op": "setParameters", "parameters": [{"name": "knee.compensation", "value": value}], "id": "2"}
        if isinstance(value, str | bool):
            reader = Reader(loop.publisher.port)
            reader.subscribe("/events")
        before = len(loop.daemon.taken)
        reader.socket.send(json.dumps(change))
        if isinstance(value, str | bool):
            while b"knee.compensation: the value is not a number" not in reader.message()[2]:
                pass
        else:
            reader.answer("parameterValues")
        assert loop.daemon.taken[before:] == taken


def test_parameters_need_no_connection_that_stays_open(loop: Loop) -> None:
    """The daemon closes the connection that has been silent longest, as it closes one that is idle."""
    reader = Reader(loop.publisher.port)
    for number in ("1", "2"):
        reader.socket.send(json.dumps({"op": "getParameters", "parameterNames": ["knee.compensation"], "id": number}))
        (parameter,) = reader.answer("parameterValues")["parameters"]
        assert parameter["value"] == 0.95
        with contextlib.ExitStack() as others:
            for _ in range(CLIENTS):
                others.enter_context(Client(loop.serving.path)).measure()


def test_layouts_show_signals_that_the_server_and_a_log_have(loop: Loop, tmp_path: Path) -> None:
    """Both programs show the same curves."""
    write_log(tmp_path / "log.mcap")
    with (tmp_path / "log.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    logged = {
        channel.topic: {line.split()[1] for line in summary.schemas[channel.schema_id].data.decode().splitlines()}
        for channel in summary.channels.values()
    }
    sent = {
        topic: set(json.loads(channel["schema"])["properties"])
        for topic, channel in Reader(loop.publisher.port).channels.items()
        if topic.endswith(("signals", "status"))
    }
    live, log = write_layouts(tmp_path / "new", ["knee", "hip"])[:2], write_layouts(tmp_path, HEADER.axes)[2:]
    for (foxglove, plotjuggler), signals in ((live, sent), (log, logged)):
        panels = json.loads(foxglove.read_text(encoding="utf-8"))["configById"].values()
        paths = [path["value"].rpartition(".") for panel in panels for path in panel.get("paths", ())]
        curves = [curve.attrib["name"].rpartition("/") for curve in ElementTree.parse(plotjuggler).iter("curve")]
        assert [(topic, name) for topic, _, name in paths] == [(topic, name) for topic, _, name in curves]
        assert all(name in signals[topic] for topic, _, name in paths)
        assert len(paths) > 10


def test_a_port_that_is_taken_is_one_line(loop: Loop) -> None:
    with pytest.raises(UsageError, match=r"port \d+ of 127\.0\.0\.1 cannot be opened .* choose another --port"):
        Publisher(loop.serving.path, loop.publisher.port, False)
