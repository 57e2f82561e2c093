"""Send set-points over the socket in virtual time to the daemon's loop and socket server, with one clock."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.virtual.files import controller, plant, write
from tests.virtual.serving import ServedRun

BURST = 64  # values, the capacity of the command queue
DIES = 0.4  # s
RATE = 50.0  # N*m/s, of a set-point: [axis.setpoint] rate
WANTED = 1.0  # N*m


@pytest.fixture
def run(tmp_path: Path) -> Iterator[ServedRun]:
    files = write(
        tmp_path,
        controller(setpoint={"kind": "socket", "timeout": 0.2}, file={"socket": {"path": str(tmp_path / "tsa.sock")}}),
        plant(joint={"load": "held"}),
    )
    running = ServedRun(*files, seconds=0.8)
    yield running
    running.close()


def lines(values: list[float], **more: float) -> bytes:
    request = {"verb": "setpoint", "axis": "knee", **more}
    return b"".join(json.dumps({**request, "value": value}).encode() + b"\n" for value in values)


def wanted(run: ServedRun) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Run, and return time and set-point of every cycle."""
    log = run.simulate().axes[0].log
    return log["t"], log["tau_j_des"]


def test_a_burst_of_a_client_that_dies_plays_no_longer_than_its_connection(run: ServedRun) -> None:
    """The client sends 64 values at once and disconnects. The set-point falls to 0 at its rate limit."""
    sent = lines([WANTED * (n + 1) / BURST for n in range(BURST)])
    run.at(DIES, run.connected(sent, ends=True))
    t, tau_j_des = wanted(run)
    assert np.max(np.abs(tau_j_des[t > DIES])) <= 3e-3 * RATE  # one cycle upwards at most, then downwards
    assert not np.any(tau_j_des[t > DIES + 0.01])


def test_a_value_is_as_old_as_its_client_says(run: ServedRun) -> None:
    """The timestamp is 0.15 s old, so the value acts for the remaining 0.05 s of its time-out of 0.2 s."""
    run.at(DIES, lambda now: run.send(lines([WANTED], time=now - 0.15)))
    t, tau_j_des = wanted(run)
    acting = t[np.isclose(tau_j_des, WANTED)]
    assert acting[0] - DIES == pytest.approx(WANTED / RATE, abs=4e-3)
    assert acting[-1] - DIES == pytest.approx(0.05, abs=4e-3)


def test_a_value_is_in_the_command_of_the_next_cycle_at_the_latest(tmp_path: Path) -> None:
    """The value arrives at 20 moments of a period. A value between SYNC and command is in that command."""
    period, moments = 1e-3, [0.3 + n * (0.01 + 0.05e-3) for n in range(20)]
    files = write(
        tmp_path,
        controller(
            setpoint={"kind": "socket", "rate": 10_000.0},
            law={"compensation": 0.0},
            file={"socket": {"path": str(tmp_path / "tsa.sock")}},
        ),
        plant(joint={"load": "held"}),
    )
    running = ServedRun(*files, seconds=0.6)
    running.at(0.29, running.connected(lines([0.1])))
    for n, at in enumerate(moments):
        running.at(at, lambda now, n=n: running.again(lines([0.1 * (n % 2) - 0.05])))  # type: ignore[misc]
    try:
        t, tau_j_des = wanted(running)
    finally:
        running.close()
    for n, at in enumerate(moments):
        shown = t[(np.sign(tau_j_des) == (1 if n % 2 else -1)) & (t > at - period)][0]
        assert -0.6 * period < shown - at < period
