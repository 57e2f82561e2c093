"""The same work in two processes in step: what comes back, what is the same object, and what happens when one fails."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tsa_ctrl.system import twin
from tsa_ctrl.system.twin import at_once, both, in_step

OPEN = Path("/proc/self/fd")


@pytest.fixture
def two_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})


def is_there(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def pids() -> tuple[int, int]:
    return both(os.getpid, os.getpid)


def test_nobody_gets_a_second_process_who_did_not_ask_for_it() -> None:
    assert pids() == (os.getpid(), os.getpid())


def test_one_core_is_one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    assert in_step(lambda leads: (leads, *pids())) == (True, os.getpid(), os.getpid())


@pytest.mark.usefixtures("two_cores")
def test_two_cores_are_two_processes_and_none_is_left() -> None:
    leads, here, there = in_step(lambda leads: (leads, *pids()))
    assert leads
    assert here == os.getpid() != there
    assert not is_there(there)
    assert pids() == (os.getpid(), os.getpid())


@pytest.mark.usefixtures("two_cores")
def test_the_copy_goes_on_with_what_the_first_has_computed() -> None:
    """Each piece of the second pair needs both of the first; that of the copy comes from the same one process."""

    def work(leads: bool) -> list[tuple[int, float]]:
        one, two = both(lambda: (os.getpid(), 2.0), lambda: (os.getpid(), 3.0))
        product = one[1] * two[1]
        return [one, two, *both(lambda: (os.getpid(), product), lambda: (os.getpid(), product + 1.0))]

    found = in_step(work)
    assert [value for _, value in found] == [2.0, 3.0, 6.0, 7.0]
    assert [pid == os.getpid() for pid, _ in found] == [True, False, True, False]
    assert found[1][0] == found[3][0]


@pytest.mark.usefixtures("two_cores")
def test_tasks_are_shared_and_come_back_in_their_order() -> None:
    found = in_step(lambda leads: at_once([lambda k=k: (k, os.getpid()) for k in range(5)]))  # type: ignore[misc]
    assert [number for number, _ in found] == [0, 1, 2, 3, 4]
    assert [pid == os.getpid() for _, pid in found] == [True, False, True, False, True]


@pytest.mark.usefixtures("two_cores")
def test_arrays_larger_than_a_pipe_go_both_ways() -> None:
    data = np.arange(2e6)

    def work(leads: bool) -> float:
        here, there = both(lambda: data + 1.0, lambda: {"twice": 2.0 * data})
        np.testing.assert_array_equal(here, data + 1.0)
        np.testing.assert_array_equal(there["twice"], 2.0 * data)
        return both(lambda: 0.0, lambda: float(here[5] + there["twice"][7]))[1]

    assert in_step(work) == 20.0


@pytest.mark.usefixtures("two_cores")
def test_a_known_object_is_itself_in_both_though_it_cannot_be_sent() -> None:
    functions: list[Callable[[], int]] = [lambda: 1, lambda: 2]

    def work(leads: bool) -> tuple[object, object, object]:
        first, second = both(lambda: [functions[1], 3], lambda: [functions[0], 4], known=functions)
        _, same = both(lambda: None, lambda: first[0] is functions[1])
        return first, second, same

    assert in_step(work) == ([functions[1], 3], [functions[0], 4], True)


@pytest.mark.usefixtures("two_cores")
def test_a_piece_in_a_piece_takes_no_third_process() -> None:
    _, there = in_step(lambda leads: both(lambda: None, lambda: (os.getpid(), pids())))
    assert there[1] == (there[0], there[0])


@pytest.mark.usefixtures("two_cores")
def test_an_error_is_raised_as_if_there_were_one_process() -> None:
    def wrong() -> None:
        raise ValueError("always")

    for pair in ((wrong, lambda: None), (lambda: None, wrong)):
        with pytest.raises(ValueError, match="always"):
            in_step(lambda leads, pair=pair: both(*pair))  # type: ignore[misc]


@pytest.mark.usefixtures("two_cores")
@pytest.mark.parametrize("how", ["killed", "fails", "hangs", "astray", "unsendable"])
def test_a_copy_that_fails_leaves_one_process(how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it should have computed is computed here, and all that comes after."""
    monkeypatch.setattr(twin, "PATIENCE", 0.2)
    mine = os.getpid()

    def unlucky() -> object:
        if os.getpid() != mine:
            if how == "killed":
                os.kill(os.getpid(), signal.SIGKILL)
            if how == "fails":
                raise ValueError("only there")
            if how == "hangs":
                time.sleep(60.0)
            if how == "unsendable":
                return lambda: 7
        return 7

    def work(leads: bool) -> object:
        if how == "astray" and not leads:
            both(lambda: 0, lambda: 0)
        return both(lambda: 1, unlucky), pids()

    assert in_step(work) == ((1, 7), (mine, mine))


@pytest.mark.usefixtures("two_cores")
def test_what_cannot_be_sent_to_the_copy_leaves_one_process() -> None:
    here, there = in_step(lambda leads: both(lambda: os.getpid, lambda: (os.getpid(), lambda: 7)))
    assert here() == there[0] == os.getpid()


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
        in_step(lambda leads: both(wrong, lambda: time.sleep(60.0)))
    assert time.monotonic() - started < 30.0
    assert not is_there(seen[0])


@pytest.mark.usefixtures("two_cores")
def test_no_room_for_a_process_is_one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    def full() -> int:
        raise BlockingIOError

    monkeypatch.setattr(os, "fork", full)
    before = len(list(OPEN.iterdir()))
    assert in_step(lambda leads: pids()) == (os.getpid(), os.getpid())
    assert len(list(OPEN.iterdir())) == before


def run(*lines: str) -> subprocess.Popen[str]:
    head = (
        "import os, time",
        "from tsa_ctrl.system.twin import both, in_step",
        "os.sched_getaffinity = lambda _: {0, 1}",
    )
    return subprocess.Popen([sys.executable, "-c", "\n".join([*head, *lines])], stdout=subprocess.PIPE, text=True)


def test_the_copy_says_nothing() -> None:
    with run("in_step(lambda leads: print('once', flush=True) or both(os.getpid, os.getpid))") as process:
        assert process.communicate(timeout=60.0)[0] == "once\n"


def test_a_process_that_is_killed_takes_the_other_along() -> None:
    """However it is killed."""
    with run(
        "def there(out):",
        "    os.write(out, f'{os.getpid()}\\n'.encode())",
        "    time.sleep(60)",
        "out = os.dup(1)",
        "in_step(lambda leads: both(lambda: time.sleep(60), lambda: there(out)))",
    ) as process:
        assert process.stdout is not None
        other = int(process.stdout.readline())
        assert is_there(other)
        process.kill()
        process.wait()
        deadline = time.monotonic() + 20.0
        while is_there(other) and time.monotonic() < deadline:
            time.sleep(0.02)
        assert not is_there(other)
