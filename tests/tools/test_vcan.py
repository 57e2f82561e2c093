"""tools/vcan passes streams and exit status of the command for every kind of interface."""

from __future__ import annotations

import os
import random
import subprocess
import sys

import pytest

from tests.conftest import ROOT

VCAN = str(ROOT / "tools" / "vcan")
NO_VCAN = 77


def run(command: list[str], environment: dict[str, str], stdin: bytes = b"") -> subprocess.CompletedProcess[bytes]:
    done = subprocess.run([VCAN, *command], input=stdin, capture_output=True, env=os.environ | environment)
    if done.returncode == NO_VCAN:
        pytest.skip(done.stderr.decode().strip())
    return done


@pytest.mark.parametrize(
    ("command", "environment", "status", "message"),
    [
        ([], {}, 2, "usage: tools/vcan COMMAND [ARGUMENT...]"),
        (["no-such-command"], {}, 127, "no-such-command: no such command"),
        (["true"], {"TSA_VCAN_TIMEOUT": "soon"}, 2, "TSA_VCAN_TIMEOUT=soon: a number of seconds"),
        (["true"], {"TSA_VCAN_MEMORY": "64M"}, 2, "TSA_VCAN_MEMORY=64M: a size from 128M on"),
        (["true"], {"TSA_VCAN": "lo"}, 2, "TSA_VCAN=lo: that is no vcan"),
    ],
)
def test_wrong_use_is_one_line(command: list[str], environment: dict[str, str], status: int, message: str) -> None:
    """A wrong call ends before a process starts, with a line that states the allowed values."""
    done = run(command, environment)
    assert done.returncode == status
    assert done.stdout == b""
    assert done.stderr.decode().startswith(f"tools/vcan: {message}")
    assert done.stderr.count(b"\n") == 1


def test_local_sockets_are_chosen_by_name_and_are_no_vcan_for_the_tests() -> None:
    script = "from tests.conftest import lack_of_vcan; import os; print(os.environ['TSA_VCAN'], lack_of_vcan())"
    done = run([sys.executable, "-c", script], {"TSA_VCAN": "datagram:bench", "PYTHONPATH": str(ROOT)})
    assert done.returncode == 0
    assert done.stdout.startswith(b"datagram:bench no vcan: TSA_VCAN=datagram:bench: local sockets")


def test_the_guests_first_process_needs_the_standard_library_alone() -> None:
    call = [sys.executable, "-ES", "-c", f"import sys; sys.path[0] = {str(ROOT)!r}; import tools.guest.init"]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_streams_and_exit_status_pass_through() -> None:
    """Input, output and errors larger than any buffer arrive unchanged."""
    data = random.Random(1).randbytes(200_000)
    done = run(["sh", "-c", "cat; printf 'to\\nerrors\\r\\n' >&2; exit 7"], {"TSA_VCAN": ""}, stdin=data)
    assert done.returncode == 7
    assert done.stdout == data
    assert done.stderr.endswith(b"to\nerrors\r\n")


@pytest.mark.vcan
def test_an_existing_vcan_is_used(vcan: str) -> None:
    assert run(["sh", "-c", "printf %s $TSA_VCAN; exit 5"], {}).stdout == vcan.encode()


@pytest.mark.vcan
def test_the_time_out_ends_the_command() -> None:
    assert run(["sleep", "1000"], {"TSA_VCAN_TIMEOUT": "0.2"}).returncode == 124
