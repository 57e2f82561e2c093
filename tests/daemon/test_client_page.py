"""Test the examples of the client page: the protocol, the configuration, and the controllers in Python and C."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from tests.conftest import ROOT
from tests.daemon.serving import PATIENCE, Serving, until
from tsa_ctrl.control.settings import SetPointSettings
from tsa_ctrl.ipc.mailbox import Reading

FOLDER = ROOT / "tsa_ctrl" / "ipc"
STRICT = ("-std=c11", "-D_POSIX_C_SOURCE=200809L", "-Wall", "-Wextra", "-Werror")
STIFFNESS = 3.0  # N*m/rad
COMPILER = shutil.which("cc") or shutil.which("gcc")


def block(language: str) -> str:
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    (found,) = re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)
    return str(found)


def test_every_line_of_the_conversation_is_answered_and_the_configuration_is_one(serving: Serving) -> None:
    """Each request of the example gets a positive answer, except the one with the option `quiet`."""
    lines = block("json").splitlines()
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(PATIENCE)
        connection.connect(serving.path)
        connection.sendall(block("json").encode())
        reader = connection.makefile()
        answers = [json.loads(reader.readline()) for line in lines if not json.loads(line).get("quiet")]
    assert len(answers) == len(lines) - 1
    assert all(answer.get("ok", True) for answer in answers)
    tables = re.sub(r"^\[.*\]$", "", block("toml"), flags=re.MULTILINE)
    settings = msgspec.toml.decode(tables, type=SetPointSettings)
    assert (settings.kind, settings.timeout) == ("socket", SetPointSettings().timeout)


@contextlib.contextmanager
def started(serving: Serving, *command: str) -> Iterator[subprocess.Popen[str]]:
    """Start a program of the page with the socket of this server, and end it if the test fails."""
    with subprocess.Popen(
        command,
        env={**os.environ, "XDG_RUNTIME_DIR": str(Path(serving.path).parent)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def responds(serving: Serving, q_j: float, wanted: float) -> bool:
    """Return True once the program answers this angle of the knee with this torque and a new time stamp."""
    now = time.monotonic()

    def follows() -> bool:
        serving.mailbox.measure(time.monotonic(), 1, 2, [Reading(q_j=q_j), Reading(q_j=9.0)])
        found = serving.mailbox.wanted(0)
        return found is not None and found[0] == pytest.approx(wanted) and found[1] >= now

    return until(follows)


def test_the_controller_in_python_runs_as_printed_and_beyond_the_range(serving: Serving) -> None:
    """A set-point beyond the range of the axis is clamped, and the program continues until the daemon ends."""
    with started(serving, sys.executable, "-c", block("python")) as process:
        assert all(responds(serving, *each) for each in ((-3.0, 2.0), (0.1, 0.4), (3.0, -2.0)))
        serving.end()
        said, error = process.communicate(timeout=PATIENCE)
    assert (process.returncode, error) == (0, "")
    assert "the daemon" in said


def test_the_controller_in_python_ends_quietly_when_it_is_interrupted(serving: Serving) -> None:
    """The lease is released, so the set-point is 0. The program prints nothing and ends with exit code 0."""
    with started(serving, sys.executable, "-c", block("python")) as process:
        assert responds(serving, 0.1, 0.4)
        process.send_signal(signal.SIGINT)
        said, error = process.communicate(timeout=PATIENCE)
    assert (process.returncode, said, error) == (0, "", "")
    assert until(lambda: (serving.mailbox.wanted(0) or (1.0,))[0] == 0.0)


@pytest.fixture(scope="module")
def spring(tmp_path_factory: pytest.TempPathFactory) -> str:
    if COMPILER is None:
        pytest.skip("no C compiler here: apt-get install gcc")
    program = tmp_path_factory.mktemp("c") / "spring"
    done = subprocess.run(
        [COMPILER, *STRICT, "-o", str(program), str(FOLDER / "spring.c")], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    return str(program)


def test_the_controller_in_c_is_a_spring_until_the_daemon_ends(serving: Serving, spring: str) -> None:
    """The program calculates set-points from the measurements, adds a time stamp, and reports why it ends."""
    with started(serving, spring, serving.path, "knee", str(STIFFNESS)) as process:
        assert all(responds(serving, q_j, -STIFFNESS * q_j) for q_j in (0.2, -0.1))
        serving.end()
        _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert "the daemon has ended" in said or "the daemon is gone" in said


def test_what_is_wrong_is_one_line(serving: Serving, spring: str) -> None:
    rows = [
        ((), 2, "usage"),
        (("none.sock", "knee", "1"), 1, "none.sock"),
        ((serving.path, "toe", "1"), 1, "no axis toe"),
    ]
    for arguments, status, words in rows:
        done = subprocess.run([spring, *arguments], capture_output=True, text=True, timeout=PATIENCE, check=False)
        assert (done.returncode, done.stderr.count("\n")) == (status, 1)
        assert words in done.stderr
