"""Test the reading process on a pseudo-terminal pair: noise, partial lines, silence, unplugging, end of the daemon."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.sensors.lines import PATIENCE, Line, wait_for
from tests.system.test_parent import alive
from tsa_ctrl.sensors.process import NOTHING, LineState, SerialSensors, SerialSensorSettings, Slots


@pytest.fixture
def line(tmp_path: Path) -> Iterator[Line]:
    made = Line(tmp_path / "tty")
    yield made
    with contextlib.suppress(OSError):
        made.unplug()


def settings(line: Line, **changes: object) -> SerialSensorSettings:
    return SerialSensorSettings(port=str(line.path), quantity="tau_j", timeout=0.2, rate=20.0, **changes)  # type: ignore[arg-type]


@contextlib.contextmanager
def sensors(*each: SerialSensorSettings) -> Iterator[SerialSensors]:
    made = SerialSensors(each)
    try:
        yield made
    finally:
        made.close()


def test_a_value_arrives_with_its_time(line: Line) -> None:
    with sensors(settings(line, scale=2.0)) as read:
        wait_for(lambda: read.reader(0)(time.monotonic()) == 3.0, lambda: line.send(b"1.5\r\n"))
        reading = read.reading(0)
        assert reading.state is LineState.READING
        assert 0.0 <= time.monotonic() - reading.time < PATIENCE


def test_a_silent_line_gives_nan_after_its_time_out(line: Line) -> None:
    with sensors(settings(line)) as read:
        wait_for(lambda: read.reading(0).count > 2, lambda: line.send(b"1\n"))
        wait_for(lambda: read.reading(0).state is LineState.SILENT)
        assert math.isnan(read.reader(0)(time.monotonic()))


def test_noise_is_counted_and_never_becomes_a_value(line: Line) -> None:
    with sensors(settings(line, low=-10.0, high=10.0)) as read:
        wait_for(lambda: read.reading(0).count > 0, lambda: line.send(b"1\n"))
        wait_for(lambda: read.reading(0).rejected >= 20, lambda: line.send(b"\xf3\x00garb\n99\n1e"))
        value = read.reading(0).value
        assert value == 1.0


def test_an_unplugged_line_is_lost_and_comes_back(line: Line) -> None:
    with sensors(settings(line)) as read:
        wait_for(lambda: read.reading(0).count > 0, lambda: line.send(b"1\n"))
        line.unplug()
        wait_for(lambda: read.reading(0).state is LineState.LOST)
        assert math.isnan(read.reader(0)(time.monotonic() + 1.0))
        line.plug()
        wait_for(lambda: read.reader(0)(time.monotonic()) == 2.0, lambda: line.send(b"2\n"))


def test_a_sensor_that_is_asked_gets_its_request(line: Line) -> None:
    with sensors(settings(line, request="READ?\n")) as read:
        os.set_blocking(line.ours, False)

        def answer() -> None:
            with contextlib.suppress(BlockingIOError):
                if b"READ?" in os.read(line.ours, 100):
                    line.send(b"0.25\n")

        wait_for(lambda: read.reader(0)(time.monotonic()) == 0.25, answer)


def test_two_sensors_do_not_mix(tmp_path: Path) -> None:
    a, b = Line(tmp_path / "a"), Line(tmp_path / "b")
    with sensors(settings(a), settings(b)) as read:

        def both() -> None:
            a.send(b"1\n")
            b.send(b"2\n")

        wait_for(lambda: min(read.reading(0).count, read.reading(1).count) > 3, both)
        assert (read.reading(0).value, read.reading(1).value) == (1.0, 2.0)
    a.unplug()
    b.unplug()


def test_the_reader_ends_when_the_daemon_is_killed(line: Line) -> None:
    program = (
        "import sys, time\nfrom tsa_ctrl.sensors.process import SerialSensors\n"
        "from tsa_ctrl.sensors.process import SerialSensorSettings\n"
        f"s = SerialSensors([SerialSensorSettings(port={str(line.path)!r}, quantity='t1')])\n"
        "print(s._children[0].pid, flush=True)\ntime.sleep(60)\n"
    )
    daemon = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
    assert daemon.stdout is not None
    child = int(daemon.stdout.readline())
    daemon.send_signal(signal.SIGKILL)
    daemon.wait()
    wait_for(lambda: not alive(child))


def test_a_new_slot_holds_nothing() -> None:
    slots = Slots(2)
    assert math.isnan(slots.fresh(1, 0.0, 1.0))
    assert slots.read(1).state is NOTHING.state
    slots.close()
