"""Test the examples of the client page: the protocol, the configuration, and the controllers in Python and C."""

from __future__ import annotations

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


@pytest.fixture
def serving(tmp_path: Path) -> Iterator[Serving]:
    running = Serving(tmp_path / "tsa.sock", ["knee", "hip"])
    assert running.ready, running.greeting
    yield running
    running.end()


def block(language: str) -> str:
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    (found,) = re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)
    return str(found)


def test_every_line_of_the_conversation_is_answered(serving: Serving) -> None:
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


def test_the_configuration_is_one() -> None:
    tables = re.sub(r"^\[.*\]$", "", block("toml"), flags=re.MULTILINE)
    settings = msgspec.toml.decode(tables, type=SetPointSettings)
    assert (settings.kind, settings.timeout) == ("socket", SetPointSettings().timeout)


def started(serving: Serving) -> subprocess.Popen[str]:
    """Start the Python program of the page with the socket of this server."""
    return subprocess.Popen(
        [sys.executable, "-c", block("python")],
        env={**os.environ, "XDG_RUNTIME_DIR": str(Path(serving.path).parent)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_the_controller_in_python_runs_as_printed_and_beyond_the_range(serving: Serving) -> None:
    """A set-point beyond the range of the axis is clamped, and the program continues until the daemon ends."""
    process = started(serving)
    try:
        for q_j, wanted in ((-3.0, 2.0), (0.1, 0.4), (3.0, -2.0)):

            def follows(q_j: float = q_j, wanted: float = wanted) -> bool:
                serving.mailbox.measure(time.monotonic(), 1, 2, [Reading(q_j=q_j), Reading()])
                found = serving.mailbox.wanted(0)
                return found is not None and found[0] == pytest.approx(wanted)

            assert until(follows)
        serving.end()
        said, error = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
        process.communicate()
    assert (process.returncode, error) == (0, "")
    assert "the daemon" in said


def test_the_controller_in_python_ends_quietly_when_it_is_interrupted(serving: Serving) -> None:
    """The lease is released, so the set-point is 0. The program prints nothing and ends with exit code 0."""
    process = started(serving)
    try:

        def torque() -> bool:
            serving.mailbox.measure(time.monotonic(), 1, 2, [Reading(q_j=0.1), Reading()])
            found = serving.mailbox.wanted(0)
            return found is not None and found[0] == pytest.approx(0.4)

        assert until(torque)
        process.send_signal(signal.SIGINT)
        said, error = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
        process.communicate()
    assert (process.returncode, said, error) == (0, "", "")

    def withdrawn() -> bool:
        found = serving.mailbox.wanted(0)
        return found is not None and found[0] == 0.0

    assert until(withdrawn)


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
    process = subprocess.Popen([spring, serving.path, "knee", str(STIFFNESS)], stderr=subprocess.PIPE, text=True)
    try:
        for q_j in (0.2, -0.1):
            now = time.monotonic()

            def follows(q_j: float = q_j, now: float = now) -> bool:
                serving.mailbox.measure(time.monotonic(), 1, 2, [Reading(q_j=q_j), Reading(q_j=9.0)])
                wanted = serving.mailbox.wanted(0)
                return wanted is not None and wanted[0] == pytest.approx(-STIFFNESS * q_j) and wanted[1] >= now

            assert until(follows)
        serving.end()
        _, said = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == 1
    assert "the daemon has ended" in said or "the daemon is gone" in said


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [((), 2, "usage"), (("none.sock", "knee", "1"), 1, "none.sock"), (("SOCKET", "toe", "1"), 1, "no axis toe")],
)
def test_what_is_wrong_is_one_line(
    serving: Serving, spring: str, arguments: tuple[str, ...], status: int, words: str
) -> None:
    given = [serving.path if argument == "SOCKET" else argument for argument in arguments]
    done = subprocess.run([spring, *given], capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (status, 1)
    assert words in done.stderr
