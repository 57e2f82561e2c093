"""Invalid requests to the local socket.

The answers are strict, the mailbox receives only commands within their bounds, and the server process does not grow.
"""

from __future__ import annotations

import contextlib
import json
import math
import random
import socket
import tempfile
from pathlib import Path

from tests.daemon.serving import Serving, until
from tests.fuzz.part import Holdings, Part
from tsa_ctrl.ipc.client import Client
from tsa_ctrl.ipc.mailbox import RECOVER
from tsa_ctrl.ipc.protocol import Status

GOOD = (
    b'{"verb":"status"}',
    b'{"verb":"set","name":"knee.compensation","value":0.5}',
    b'{"verb":"set","name":"hip.compensation","value":1.1999}',
    b'{"verb":"setpoint","axis":"knee","value":-0.25}',
    b'{"verb":"setpoint","axis":"knee","value":0.5,"time":12.5}',
    b'{"verb":"setpoint","axis":"knee","value":1.5,"quiet":true}',
    b'{"verb":"lease","seconds":0.05}',
    b'{"verb":"release"}',
    b'{"verb":"measure"}',
    b'{"verb":"events","since":0}',
    b'{"verb":"recover"}',
)
PIECES = (
    *(b'"', b"{", b"}", b"[", b"]", b",", b":", b"null", b"true", b'"verb"', b'"stop', b"\\u0000", b"\xff", b"\0"),
    *(b"NaN", b"1e999", b"-1e308", b"99999999999999999999999", b"-0", b"0.1e-400", b" " * 50, b"[" * 300),
)
BOUNDS = {0: (0.0, 1.2), RECOVER: (0.0, 0.0)}  # allowed values of each parameter
MOST = 2.0  # N*m, largest set-point
LINES = 40  # most lines of one connection


def run(lines: int, seed: int) -> Part:
    """Send this many lines. Some connections close without reading the answers."""
    part = Part("socket")
    draw = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        serving = Serving(Path(folder) / "tsa.sock", ["knee", "hip"])
        try:
            pid = serving.process.pid
            descriptors = Holdings.of(pid).descriptors
            while part.inputs < lines:
                with part.surviving("connection"):
                    _connection(serving, draw, part)
                _take(serving, part)
                if part.inputs <= max(LINES, lines // 4):
                    part.before = _idle(pid, descriptors)
            with part.surviving("at the end"), Client(serving.path) as client:
                part.counts["alive"] = int(client.ask(Status())["schema"] == 1)
            part.after = _idle(pid, descriptors)
        finally:
            said = serving.end()
        if serving.process.returncode != 0 or "Traceback" in said:
            part.blame(f"the server ended with {serving.process.returncode}: {said[-300:]}")
    return part


def _idle(pid: int, descriptors: int) -> Holdings:
    """Return the state of the server once all clients have disconnected."""
    until(lambda: Holdings.of(pid).descriptors <= descriptors)
    return Holdings.of(pid)


def _line(draw: random.Random) -> bytes:
    """Return a valid request with up to four random changes."""
    line = bytearray(draw.choice(GOOD))
    for _ in range(draw.randrange(5)):
        at = draw.randrange(len(line) + 1)
        kind = draw.randrange(4)
        if kind == 0 and line:
            del line[at : at + draw.randrange(1, 8)]
        elif kind == 1:
            line[at:at] = draw.choice(PIECES)
        elif kind == 2 and at < len(line):
            line[at] = draw.randrange(256)
        else:
            line = bytearray(draw.randbytes(draw.randrange(60)))
    return bytes(line).replace(b"\n", b" ")


def _connection(serving: Serving, draw: random.Random, part: Part) -> None:
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(5.0)
        connection.connect(serving.path)
        lines = [_line(draw) for _ in range(draw.randrange(1, LINES))]
        part.inputs += len(lines)
        data = b"\n".join(lines) + (b"\n" if draw.random() < 0.9 else b"")
        if draw.random() < 0.05:
            data += b"x" * 10_000
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            connection.sendall(data)
            if draw.random() < 0.3:
                return  # close without reading an answer
            connection.shutdown(socket.SHUT_WR)
            answers = b""
            while piece := connection.recv(1 << 16):
                answers += piece
            for answer in answers.splitlines():
                found = json.loads(answer)
                if "event" in found:
                    part.counts[f"told: {found['event']}"] += 1
                    continue
                part.counts["refused" if not found["ok"] else "taken"] += 1
                if not found["ok"] and not found["error"]:
                    part.blame("a refusal without words")


def _take(serving: Serving, part: Part) -> None:
    """Check that the values that reach the loop are within their bounds."""
    while (command := serving.mailbox.take()) is not None:
        part.counts["commands"] += 1
        low, high = BOUNDS.get(command.parameter, (math.inf, -math.inf))
        if command.axis not in (0, 1) or not low <= command.value <= high:
            part.blame(f"reached the loop: {command}")
    if (wanted := serving.mailbox.wanted(0)) is not None and not abs(wanted[0]) <= MOST:
        part.blame(f"reached the loop: {wanted}")
    if serving.mailbox.wanted(1) not in (None, (0.0, -math.inf)):
        part.blame("the set-point of an axis that takes none")
