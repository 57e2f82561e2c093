"""Two pieces of work in two processes: what comes back, what is the same object, and what happens when one fails."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tsa_ctrl.system.twin import both, twins

OPEN = Path("/proc/self/fd")


@pytest.fixture
def two_cores(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    with twins():
        yield


def is_there(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_nobody_gets_a_second_process_who_did_not_ask_for_it() -> None:
    assert both(os.getpid, os.getpid) == (os.getpid(), os.getpid())


def test_one_core_is_one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    with twins():
        assert both(os.getpid, os.getpid) == (os.getpid(), os.getpid())


@pytest.mark.usefixtures("two_cores")
def test_two_cores_are_two_processes_and_none_is_left() -> None:
    here, there = both(os.getpid, os.getpid)
    assert here == os.getpid() != there
    assert not is_there(there)


@pytest.mark.usefixtures("two_cores")
def test_arrays_larger_than_a_pipe_come_back() -> None:
    data = np.arange(2e6)
    here, there = both(lambda: data + 1.0, lambda: {"twice": 2.0 * data})
    np.testing.assert_array_equal(here, data + 1.0)
    np.testing.assert_array_equal(there["twice"], 2.0 * data)


@pytest.mark.usefixtures("two_cores")
def test_a_known_object_comes_back_as_itself_though_it_cannot_be_sent() -> None:
    function = lambda: 1  # noqa: E731 (no function of a module can be pickled by its name)
    _, there = both(lambda: None, lambda: [function, 2], known=[function])
    assert there == [function, 2]


@pytest.mark.usefixtures("two_cores")
def test_a_piece_in_a_piece_takes_no_third_process() -> None:
    _, there = both(lambda: None, lambda: (os.getpid(), both(os.getpid, os.getpid)))
    assert there[1] == (there[0], there[0])


@pytest.mark.usefixtures("two_cores")
def test_what_fails_there_is_done_here() -> None:
    """Its error is raised as if there were one process; one that was only the other's does not count."""
    mine = os.getpid()

    def wrong() -> None:
        raise ValueError("always")

    def unlucky() -> int:
        if os.getpid() != mine:
            os.kill(os.getpid(), signal.SIGKILL)
        return 7

    with pytest.raises(ValueError, match="always"):
        both(lambda: None, wrong)
    assert both(lambda: 1, unlucky) == (1, 7)


@pytest.mark.usefixtures("two_cores")
def test_an_error_here_ends_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """At once, and it is waited for."""
    started = time.monotonic()
    seen: list[int] = []
    fork = os.fork

    def noted() -> int:
        seen.append(fork())
        return seen[-1]

    def wrong() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fork", noted)
    with pytest.raises(KeyboardInterrupt):
        both(wrong, lambda: time.sleep(60.0))
    assert time.monotonic() - started < 30.0
    assert not is_there(seen[0])


@pytest.mark.usefixtures("two_cores")
def test_no_room_for_a_process_is_one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    def full() -> int:
        raise BlockingIOError

    monkeypatch.setattr(os, "fork", full)
    before = len(list(OPEN.iterdir()))
    assert both(os.getpid, os.getpid) == (os.getpid(), os.getpid())
    assert len(list(OPEN.iterdir())) == before


def test_a_process_that_is_killed_takes_the_other_along() -> None:
    """However it is killed."""
    script = (
        "import os, time\n"
        "from tsa_ctrl.system.twin import both, twins\n"
        "os.sched_getaffinity = lambda _: {0, 1}\n"
        "def there():\n"
        "    print(os.getpid(), flush=True)\n"
        "    time.sleep(60)\n"
        "with twins():\n"
        "    both(lambda: time.sleep(60), there)\n"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        other = int(process.stdout.readline())
        assert is_there(other)
        process.kill()
        process.wait()
        deadline = time.monotonic() + 20.0
        while is_there(other) and time.monotonic() < deadline:
            time.sleep(0.02)
        assert not is_there(other)
