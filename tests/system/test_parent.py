"""The processes of the demo end when the demo ends, also after a crash."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tsa_ctrl.system.process_supervisor import terminal_blocked

CHILD = """
import time
from tsa_ctrl.system.process_supervisor import follow
follow()
print('up', flush=True)
time.sleep(120)
"""
PARENT = f"""
import subprocess, sys, time
from tsa_ctrl.system.process_supervisor import environment
child = subprocess.Popen([sys.executable, "-c", {CHILD!r}], env=environment(), stdout=subprocess.PIPE, text=True)
print(child.stdout.readline().strip(), child.pid, flush=True)
time.sleep(120)
"""


POOL = """
import os, time
from concurrent.futures import ProcessPoolExecutor
from tsa_ctrl.system.process_supervisor import begin_worker, worker_context
if __name__ == '__main__':
    pool = ProcessPoolExecutor(2, mp_context=worker_context('json'), initializer=begin_worker)
    server = pool.submit(os.getppid).result()
    workers = [each for each in pool._processes]
    print(server, *workers, flush=True)
    pool.submit(time.sleep, 120)
    time.sleep(120)
"""


def alive(pid: int) -> bool:
    """Return True if a process runs; a zombie does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text("ascii").rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_child_ends_with_a_parent_that_is_killed() -> None:
    parent = subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    word, number = parent.stdout.readline().split()
    assert word == "up"
    assert alive(int(number))
    parent.kill()
    parent.communicate()
    end = time.monotonic() + 20.0
    while alive(int(number)) and time.monotonic() < end:
        time.sleep(0.05)
    assert not alive(int(number))


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.3])
def test_workers_and_their_server_end_with_a_parent_that_is_killed(tmp_path: Path, delay: float) -> None:
    """A worker keeps the pipes of its server open, so that the end of one does not end the other."""
    program = tmp_path / "pool.py"
    program.write_text(POOL)
    parent = subprocess.Popen([sys.executable, str(program)], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    numbers = [int(number) for number in parent.stdout.readline().split()]
    assert len(numbers) >= 2
    time.sleep(delay)
    parent.kill()
    parent.communicate()
    end = time.monotonic() + 20.0
    while any(map(alive, numbers)) and time.monotonic() < end:
        time.sleep(0.05)
    left = [number for number in numbers if alive(number)]
    for number in left:
        os.kill(number, signal.SIGKILL)
    assert left == []


def test_child_of_a_parent_that_is_gone_does_not_begin() -> None:
    environment = {**os.environ, "TSA_PARENT": "1" if os.getpid() != 1 else "2"}
    found = subprocess.run([sys.executable, "-c", CHILD], env=environment, capture_output=True, text=True, timeout=60)
    assert (found.returncode, found.stdout) == (1, "")


def test_child_never_gets_the_terminals_signals_and_they_wait_for_its_owner() -> None:
    heard: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: heard.append(number))
    try:
        with terminal_blocked():
            child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(120)"])
            signal.raise_signal(signal.SIGINT)
            assert heard == []
        assert heard == [signal.SIGINT]
        for number in (signal.SIGINT, signal.SIGHUP):
            child.send_signal(number)
        time.sleep(0.1)
        assert alive(child.pid)
    finally:
        signal.signal(signal.SIGINT, before)
        child.kill()
        child.wait()
