"""The supervisor replaces a worker that dies or hangs, but not one that has finished. No worker outlives it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import pytest

from tests.system.test_parent import alive

PROGRAM = """
import os, sys, time
from tsa_ctrl.system import process_supervisor
process_supervisor.LOOK, process_supervisor.REST = 0.01, 0.0
heard = [0.0]
def left():
    heard[0] = time.monotonic()
def work(before):
    print("worker", before, os.getpid(), flush=True)
    {work}
    return 0
def replaced(number):
    print("replaced", number, 0, flush=True)
sys.exit(process_supervisor.supervise(work, left, lambda: heard[0], 0.3, replaced))
"""


class Kept:
    """A supervisor whose workers send no sign of life, so that each one has 0.3 s."""

    def __init__(self, work: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM.format(work=work)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    def line(self) -> tuple[str, int, int]:
        assert self.process.stdout is not None
        word, number, pid = self.process.stdout.readline().split()
        return word, int(number), int(pid)


@pytest.fixture
def kept() -> Iterator[Callable[[str], Kept]]:
    made: list[Kept] = []

    def make(work: str) -> Kept:
        made.append(Kept(work))
        return made[-1]

    yield make
    for each in made:
        each.process.kill()
        each.process.communicate()


def test_worker_that_has_done_its_work_is_not_replaced(kept: Callable[[str], Kept]) -> None:
    out, error = kept("pass").process.communicate(timeout=30)
    assert [line.split()[:2] for line in out.splitlines()] == [["worker", "0"]]
    assert error == ""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_worker_that_dies_or_hangs_is_gone_before_the_next_begins(
    kept: Callable[[str], Kept], number: signal.Signals
) -> None:
    """A worker stopped by SIGSTOP never runs next to its replacement."""
    one = kept("time.sleep(60)")
    _, _, first = one.line()
    os.kill(first, number)
    assert one.line()[:2] == ("replaced", 1)
    assert not alive(first)
    word, before, second = one.line()
    assert (word, before) == ("worker", 1)
    assert second != first


def test_worker_that_always_fails_is_replaced_as_long_as_the_parent_lives(kept: Callable[[str], Kept]) -> None:
    """A daemon must not lose its socket permanently after ten crashes of the server."""
    one = kept("os._exit(1)")
    for number in range(30):
        assert one.line()[:2] == ("worker", number)
        assert one.line()[:2] == ("replaced", number + 1)
    assert one.process.poll() is None


def test_worker_that_always_fails_is_given_up_once_the_parent_has_ended() -> None:
    """The shell is the parent that ends. Its output closes when the last process that holds it has ended."""
    program = PROGRAM.format(work="os._exit(1)")
    command = ["sh", "-c", '"$0" -c "$1" & sleep 0.3', sys.executable, program]
    output = subprocess.run(command, stdout=subprocess.PIPE, text=True, timeout=60, check=True).stdout
    numbers = [int(line.split()[1]) for line in output.splitlines() if line.startswith("worker")]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) > 10


def test_worker_that_always_fails_is_given_up_if_the_parent_ended_before_the_supervisor_began() -> None:
    """The parent's process id can then no longer be compared, but its end of the pipe to stdin is closed."""
    command = [sys.executable, "-c", PROGRAM.format(work="os._exit(1)")]
    done = subprocess.run(command, input=b"", stdout=subprocess.PIPE, timeout=60, check=False)
    assert done.returncode == 1
    assert len(done.stdout.splitlines()) > 10


def test_no_worker_is_left_by_a_supervisor_that_is_killed_while_it_forks() -> None:
    """Each worker holds the write end of the output, so the output ends when the last one has ended."""
    for number in range(20):
        command = [sys.executable, "-c", PROGRAM.format(work="time.sleep(60) if before % 3 == 2 else os._exit(1)")]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(0.001 * number)
        process.kill()
        process.communicate(timeout=20)
