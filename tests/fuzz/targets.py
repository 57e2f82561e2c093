"""Targets of coverage-guided fuzzing: everything that reads external bytes.

A call raises an exception only for a defect.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import math
import shutil
import socket
import struct
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from tests.bus.fake import FakeBus, FakeClock
from tests.bus.nodes import Responder, cycle, one_axis_rig
from tests.conftest import ROOT
from tests.daemon.serving import description
from tests.fuzz.corpus import Target
from tests.fuzz.frames import NODES
from tests.log.logs import write_log
from tests.plant.bench import Bench
from tsa_ctrl.bus.canopen import objects
from tsa_ctrl.bus.canopen.eds import check_plan
from tsa_ctrl.bus.canopen.objects import MAX_TORQUE, Write
from tsa_ctrl.bus.drive.checks import NodeReport, Report, Row
from tsa_ctrl.bus.drive.profile import load_profile
from tsa_ctrl.bus.drive.session import Session
from tsa_ctrl.bus.settings import BusSettings
from tsa_ctrl.bus.wire.bus import Frame
from tsa_ctrl.config import load_configuration
from tsa_ctrl.dashboard.server import application
from tsa_ctrl.errors import BusError, TsaError, UsageError
from tsa_ctrl.ipc.connection import listen
from tsa_ctrl.ipc.mailbox import RECOVER, Mailbox
from tsa_ctrl.ipc.protocol import Recover, Set
from tsa_ctrl.ipc.server import Server
from tsa_ctrl.log.reader import LogFile
from tsa_ctrl.log.table import read_table, read_waypoints
from tsa_ctrl.model.parameters import load_model
from tsa_ctrl.plant.cia402 import PowerState
from tsa_ctrl.plant.process import check as load_plant
from tsa_ctrl.sensors.process import SerialSensorSettings
from tsa_ctrl.sensors.reader import LineParser

IDS = (0x181, 0x281, 0x1A0, 0x1C0, 0x081, 0x0A0, 0x701, 0x720, 0x740, 0x581, 0x601, 0x201, 0x080, 0x000, 0x77F,
       0x20000040)  # fmt: skip
PORT, TOKEN = 8123, "secret"
CONFIG = ROOT / "config"


@cache
def _kept() -> tempfile.TemporaryDirectory[str]:
    """Return a temporary folder that exists as long as the process. Its files are overwritten by each input."""
    return tempfile.TemporaryDirectory(prefix="tsa-fuzz-")


def _folder() -> Path:
    return Path(_kept().name)


def _in_file(suffix: str, read: Callable[[Path], object], beside: Path | None = None) -> Callable[[bytes], None]:
    """Return a target that writes the input to a file and reads it. A one-line UsageError is permitted.

    The files of the folder `beside` are next to it.
    """

    def call(data: bytes) -> None:
        path = _folder() / f"input{suffix}"
        if beside is not None and not (_folder() / "drives").exists():
            shutil.copytree(beside, _folder(), dirs_exist_ok=True)
        path.write_bytes(data)
        try:
            read(path)
        except UsageError as error:
            if len(str(error).splitlines()) != 1:
                raise AssertionError(f"not one line: {error}") from None

    return call


def _frames(data: bytes) -> None:
    """Decode the input as CAN frames: an identifier, a length and the data.

    The highest identifiers end a cycle with a command.
    """
    rig, bus, _ = one_axis_rig(Responder())
    target = objects.TARGET_TORQUE
    held = [Row(objects.MAX_TORQUE, 0, 3000), Row(objects.STATUSWORD, 0, 7)]
    rig.look_after(Report((NodeReport("drive", 1, rows=held),)))
    rig.start()
    place = 0
    while place < len(data):
        number = data[place] % (len(IDS) + 4)
        if number >= len(IDS):
            cycle(rig, bus, 0.001 if number % 2 else 0.03)
            for axis in rig.axes:
                axis.command(0x0F, (data[place] - 128) / 100.0)
                assert abs(axis.tau_m_sent) <= axis.scale.most_digits * axis.scale.torque + 1e-9
            rig.read_back(bus.clock.now)
            rig.heartbeat(bus.clock.now)
            place += 1
            continue
        length = data[place + 1] % 9 if place + 1 < len(data) else 0
        payload = data[place + 2 : place + 2 + length]
        if IDS[number] == 0x581 and place % 2:
            key = objects.MAX_TORQUE.key if place % 3 else target.key
            payload = struct.pack("<BHB", 0x4B, *key) + (payload + bytes(4))[:4]
        bus.waiting.append((IDS[number], payload))
        place += 2 + length


@cache
def _machine() -> Bench:
    return Bench(_folder())


def _nodes(data: bytes) -> None:
    """Pass the input to simulated nodes with torque, ten bytes per frame: a reset restores every node.

    A first byte of at least 128 is an SDO request. All answers are valid frames, and only an enabled drive has torque.
    """
    bench = _machine()
    bench.send(0x000, b"\x81\x00")
    bench.set_up()
    bench.enable(500)
    drive = bench.unit.drive
    for place in range(0, len(data), 10):
        frame = data[place : place + 10]
        can_id = 0x600 + NODES[frame[0] % 3] if frame[0] & 0x80 else IDS[frame[0] % len(IDS)]
        for answer_id, answer in bench.send(can_id, frame[2 : 2 + (8 if frame[0] & 0x80 else frame[0] // 15)]):
            assert 0 <= answer_id < 0x800
            assert len(answer) == 8 if 0x580 < answer_id < 0x600 else len(answer) <= 8
        if frame[0] % 4 == 0:
            bench.clock.now += 1e-3
            bench.machine.tick(bench.clock.now)
        assert not drive.command.torque or drive.machine.state is PowerState.OPERATION_ENABLED
    bench.send(0x000, b"\x81\x00")
    assert [bench.upload(node, 0x1000, 0, "I") & 0xFFFF for node in NODES] == [0x0192, 0x0196, 0x0194]
    assert not drive.command.enabled


def _socket(data: bytes) -> None:
    """Send requests to the socket server: each line gets an answer, and only values within bounds reach the loop."""
    path, now = _folder() / "tsa.sock", 100.0
    mailbox = Mailbox(2, 2)
    server = Server(listen(str(path), None), mailbox, description(path, ["knee", "hip"]), lambda: now)
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(str(path))
        client.sendall(data[:4000] + b"\n")
        for _ in range(2 + data.count(b"\n")):
            server.step(0.0)
            server.step(0.0)
        client.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            for line in client.recv(1 << 20).splitlines():
                found = json.loads(line)
                assert found.get("ok", True) or found["error"]
    while (command := mailbox.take()) is not None:
        low, high = {0: (0.0, 1.2), RECOVER: (0.0, 0.0)}[command.parameter]
        assert command.axis in (0, 1)
        assert low <= command.value <= high
    assert abs((mailbox.wanted(0) or (0.0,))[0]) <= 2.0
    assert mailbox.wanted(1) in (None, (0.0, -math.inf))
    server.close()
    mailbox.close()
    path.unlink()


class _Answers:
    """An SDO server that answers with the input, eight bytes per request."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def __call__(self, frame: Frame) -> list[Frame]:
        if not 0x600 < frame[0] < 0x680:
            return []
        answer, self._data = self._data[:8], self._data[8:]
        if answer[:1] == b"\xfe":  # insert the requested object into the answer
            answer = bytes((0x43 | answer[1] % 4 << 2 if len(answer) > 1 else 0x41,)) + frame[1][1:4] + answer[4:]
        return [(0x580 + (frame[0] & 0x7F), answer)] if answer else []


def _sdo(data: bytes) -> None:
    """Read and write objects in a session. A one-line error is permitted."""
    logging.getLogger("canopen").setLevel(logging.CRITICAL)
    bus = FakeBus(FakeClock(), _Answers(data))
    with Session(bus, BusSettings()) as session:
        session.be_patient(1, 0.01)
        for act in (
            lambda: session.read(1, objects.STATUSWORD),
            lambda: session.ask(1, objects.MAX_TORQUE),
            lambda: session.read_if_there(1, objects.MODE),
            lambda: session.write(1, objects.MAX_TORQUE, 3000),
            lambda: session.upload_if_there(1, objects.POSITION_ACTUAL),
            lambda: session.read_text(1, objects.MODE),
        ):
            try:
                act()
            except TsaError as error:
                if len(str(error).splitlines()) != 1:
                    raise AssertionError(f"not one line: {error}") from None


class _Feed:
    """Replace the dashboard's connection to the daemon. No daemon is running."""

    def status(self) -> dict[str, Any]:
        return {"error": "nobody answers"}

    def ask(self, request: Set | Recover) -> dict[str, Any]:
        if isinstance(request, Recover):
            raise UsageError("nothing to recover from")
        raise BusError(f"nobody takes {request}")

    def stop(self) -> dict[str, Any]:
        return {"signalled": 1}


def _http(data: bytes) -> None:
    """Pass a request to the dashboard: method and path, headers, an empty line, and the body in two pieces."""
    head, _, body = data.partition(b"\n\n")
    first, *lines = head.split(b"\n")
    method, _, path = first.partition(b" ")
    where, _, query = path.partition(b"?")
    headers = [(name.strip().lower(), value.strip()) for name, _, value in (line.partition(b":") for line in lines)]
    scope = {
        "type": "websocket" if method == b"WS" else "http",
        "http_version": "1.1", "method": method.decode("latin-1"), "path": where.decode("latin-1"), "raw_path": where,
        "query_string": query, "headers": headers, "scheme": "http", "server": ("127.0.0.1", PORT), "client": None,
    }  # fmt: skip
    pieces = [body[: len(body) // 2], body[len(body) // 2 :]]
    statuses: list[int] = []

    async def receive() -> dict[str, Any]:
        if scope["type"] == "websocket":
            return {"type": "websocket.connect"}
        if not pieces:
            return {"type": "http.disconnect"}
        return {"type": "http.request", "body": pieces.pop(0), "more_body": bool(pieces)}

    async def send(message: dict[str, Any]) -> None:
        if message["type"] == "http.response.start":
            statuses.append(message["status"])

    app = application(_Feed(), TOKEN, PORT)  # type: ignore[arg-type]
    asyncio.run(app(scope, receive, send))  # type: ignore[arg-type]
    assert all(status < 500 or status == 503 for status in statuses), statuses


def _log(path: Path) -> None:
    """Read a whole log: blocks, notes and the angles of the other joints."""
    log = LogFile(path)
    for axis, block in log.blocks(log.fields):
        assert axis in log.axes
        assert block.ndim == 2
    for angle in log.joint_angles().values():
        assert angle(np.array([0.0, 1.0])).shape == (2,)
    assert all("\n" not in problem for problem in log.problems)


def _serial(data: bytes) -> None:
    """Parse the input in pieces, for a sensor with a unit and one without."""
    for settings in (
        SerialSensorSettings(port="/dev/x", quantity="tau_j"),
        SerialSensorSettings(
            port="/dev/x", quantity="t1", pattern=r"(?P<value>[-+0-9.eE]+)\s*(?P<unit>\w+)", unit="N", low=0.0
        ),
    ):
        parser = LineParser(settings)
        step = 1 + len(data) // 3
        for start in range(0, len(data), step):
            for value in parser.feed(data[start : start + step]):
                assert settings.low <= value <= settings.high
        parser.reset()
        parser.feed(data)


def _text(*parts: str) -> tuple[bytes, ...]:
    return tuple(part.encode() for part in parts)


def _mcap() -> bytes:
    path = _folder() / "seed.mcap"
    path.unlink(missing_ok=True)
    write_log(path, chunks=1, per_chunk=2)
    return path.read_bytes()


EDS = (
    "[FileInfo]\nFileName=a.eds\n[DeviceInfo]\nVendorName=x\n[MandatoryObjects]\nSupportedObjects=1\n1=0x1000\n"
    "[1000]\nParameterName=Device type\nObjectType=0x7\nDataType=0x0007\nAccessType=ro\nDefaultValue=0x20192\n"
    "[6072]\nParameterName=Max torque\nDataType=0x0006\nAccessType=rw\nLowLimit=0\nHighLimit=$NODEID+1\n"
)
HOST = f"host: 127.0.0.1:{PORT}\nx-token: {TOKEN}\n"
CSV = "# sample\n# unit: s\nt,tau_j,q_m\n0,0.5,1\n0.1,0.25,1e-3\n0.2,-0.5,nan\n"
MOST_MCAP = 3000


@cache
def targets() -> tuple[Target, ...]:
    """Return all targets."""
    return (
        Target(
            "frames",
            _frames,
            (bytes((17, 4, 8, 0x10, 0x23, 1, 0, 0, 0, 0, 0, 17, 6, 1, 5, 18, 19)),),
            (b"\x11", b"\x12\x13", b"\x09\x08"),
        ),
        Target(
            "nodes",
            _nodes,
            (bytes.fromhex("81004000100000000000c0002b406000000000000b000600000000000000"),),
            (b"\x80\x00", b"\x2b\x71\x60", b"\x40\x18\x10", b"\x2f\x00\x16", b"\x23\x00\x14\x01", b"\x0b\x00\x0f"),
        ),
        Target(
            "socket",
            _socket,
            tuple(
                json.dumps(request).encode()
                for request in (
                    {"verb": "status"},
                    {"verb": "set", "name": "knee.compensation", "value": 0.5},
                    {"verb": "setpoint", "axis": "knee", "value": -0.25, "time": 99.9},
                    {"verb": "setpoint", "axis": "knee", "value": 1.5, "quiet": True},
                    {"verb": "lease", "seconds": 0.05},
                    {"verb": "events", "since": 0},
                    {"verb": "recover"},
                )
            ),
            _text('"', "{", "}", "[", ":", "null", "true", '"verb"', '"stop', "hip", "\n", "NaN", "1e999", "-1e308"),
        ),
        Target(
            "sdo",
            _sdo,
            (b"\xfe\x02AAAA\x00\x00" * 6, b"\x80\x41\x60\x00\x00\x00\x02\x06", b"\x41\x61\x60\x00\x14\x00\x00\x00"),
            (b"\xfe\x02", b"\xfe\x00", b"\x80", b"\x60\x72\x60\x00", b"\x00\x00\x02\x06", b"\x41"),
        ),
        Target(
            "http",
            _http,
            _text(
                f"GET /\n{HOST}\n", f"GET /events\n{HOST}\n", f"GET /?token={TOKEN}\nhost: localhost:{PORT}\n\n",
                f'POST /set\n{HOST}\n{{"name": "compensation", "value": 0.5}}', f"POST /stop\n{HOST}\n",
                f"POST /recover\n{HOST}\n", f"GET /static/index.html\n{HOST}\n", f"WS /events\n{HOST}\n",
            ),
            _text(
                "GET ", "POST ", "/set", "/stop", "origin: http://evil\n", f"x-token: {TOKEN}\n", "\n\n", '"name"', "{",
                "[", "1e400",
            ),
        ),
        Target(
            "toml",
            _in_file(".toml", load_model),
            ((CONFIG / "actuator.toml").read_bytes(),),
            _text("[pretension]", "value = ", "nan", "[effects.backlash]", "=", "\n", '"', "[[", "{}", "unit"),
        ),
        *(
            Target(
                name,
                _in_file(".toml", read, CONFIG),
                ((CONFIG / seed).read_bytes(),),
                _text("[axis]", "[[axis]]", "[bus]", "# ", "= ", "\n", "true", '"../../etc/passwd"', "07:32:00"),
            )
            for name, seed, read in (
                ("controller", "controller.toml", load_configuration),
                ("plant", "plant.toml", load_plant),
                ("profile", "drives/epos4.toml", lambda path: load_profile(str(path), path.parent)),
            )
        ),
        Target(
            "csv",
            _in_file(".csv", read_table),
            _text(CSV, CSV.replace(",", ";"), CSV + "\n \n", CSV + '"1,2\n'),
            _text("t,", "# ", "\n", ",", ";", "nan", '"', "1e999"),
        ),
        Target(
            "set-point",
            _in_file(".csv", lambda path: read_waypoints(path, ["tau_j_des"])),
            _text("t,tau_j_des\n0,0\n1,0.5\n", "t,x\n0,0\n"),
            _text("tau_j_des", "t", ",", "\n0", "inf", "nan"),
        ),
        Target(
            "mcap",
            _in_file(".mcap", _log),
            (_mcap(),),
            (b"\x89MCAP0\r\n", b"\x05", b"\x06", b"\x0c", struct.pack("<Q", 1 << 40)),
        ),
        Target(
            "eds",
            _in_file(".eds", lambda path: check_plan(path, [Write(MAX_TORQUE, 1000)])),
            _text(EDS),
            _text("[6072]", "DataType=", "0x", "=", "\n[", "$NODEID", "ObjectType=8", "SubNumber=", "[6072sub1]", ";"),
        ),
        Target(
            "serial",
            _serial,
            _text("x\n1.5\n-2e3 N\r\n", "0.1 N\n\n12 kg\n"),
            _text("\n", "\r", " N", "-", "1e", "9" * 300),
        ),
    )  # fmt: skip
