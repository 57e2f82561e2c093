"""Set-points: waveforms, files, and values over the socket that expire."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import pytest

from tsa_ctrl.control.setpoint import Component, SetPoint, SetPointSettings, read_file, waveform
from tsa_ctrl.errors import UsageError

PERIOD = 1e-3


@pytest.mark.parametrize(
    ("settings", "t", "value"),
    [
        ({"kind": "constant", "offset": 0.4}, 3.0, 0.4),
        ({"kind": "sine", "offset": 0.1, "amplitude": 2.0, "frequency": 0.5}, 0.5, 2.1),
        ({"kind": "step", "amplitude": 1.0, "at": 1.0}, 0.999, 0.0),
        ({"kind": "step", "amplitude": 1.0, "at": 1.0}, 1.0, 1.0),
        ({"kind": "multi_sine", "components": (Component(amplitude=1.0, frequency=1.0, phase=math.pi / 2),)}, 1.0, 1.0),
        ({"kind": "chirp", "amplitude": 1.0, "frequency": 1.0, "end_frequency": 3.0, "duration": 2.0}, 0.0, 0.0),
    ],
)
def test_waveform(settings: dict[str, Any], t: float, value: float) -> None:
    """Each kind has its textbook value."""
    assert waveform(SetPointSettings(**settings))(t) == pytest.approx(value)


def test_chirp_ends_at_its_end_frequency() -> None:
    """The phase of a linear chirp advances by the mean frequency times its duration."""
    chirp = waveform(SetPointSettings(kind="chirp", amplitude=1.0, frequency=1.0, end_frequency=5.0, duration=10.0))
    crossings = sum(chirp(0.001 * n) < 0.0 <= chirp(0.001 * (n + 1)) for n in range(9999))
    assert crossings == pytest.approx(30, abs=1)


def test_starts_at_zero_and_keeps_to_its_rate() -> None:
    """The first values ramp from 0 at `rate`."""
    set_point = SetPoint(SetPointSettings(kind="constant", offset=1.0, rate=10.0), PERIOD)
    values = [set_point.update(PERIOD * n) for n in range(200)]
    assert values[:3] == pytest.approx([0.01, 0.02, 0.03])
    assert values[-1] == 1.0


def test_gain_scales_the_source() -> None:
    """Half the gain is half the torque."""
    set_point = SetPoint(SetPointSettings(kind="constant", offset=1.0, rate=1e4), PERIOD)
    set_point.gain = 0.5
    assert set_point.update(0.0) == 0.5


class TestTheFuture:
    """A source is a function of time: what is wanted later is known, and limited as it will be."""

    SINE = SetPointSettings(kind="sine", amplitude=0.5, frequency=2.0, rate=1e4)

    def test_acting_and_ahead_are_what_will_be_wanted(self) -> None:
        set_point = SetPoint(self.SINE, PERIOD, delay=2.5e-3, lead=6e-3, horizon=10e-3)
        source = waveform(self.SINE)
        for n in range(300):
            t = n * PERIOD
            assert set_point.update(t) == pytest.approx(source(t), abs=1e-12)
            assert set_point.acting == pytest.approx(source(t + 2.5e-3), abs=1e-4)
            assert set_point.ahead == pytest.approx(source(t + 10e-3), abs=1e-9)
            assert set_point.rate == pytest.approx(source(t + 6e-3) / PERIOD - source(t + 5e-3) / PERIOD, abs=0.2)

    def test_a_step_is_ramped_when_it_comes_and_not_before(self) -> None:
        step = SetPointSettings(kind="step", amplitude=1.0, at=0.1, rate=50.0)
        set_point = SetPoint(step, PERIOD, delay=2e-3, lead=6e-3, horizon=10e-3)
        values = [(set_point.update(n * PERIOD), set_point.acting) for n in range(200)]
        assert values[99] == pytest.approx((0.0, 0.1))
        assert values[101] == pytest.approx((0.1, 0.2))
        assert values[-1] == (1.0, 1.0)

    def test_lost_cycles_are_skipped(self) -> None:
        """After a gap the set-point is that of the time, also after one longer than what is known."""
        set_point = SetPoint(self.SINE, PERIOD, delay=2e-3, horizon=10e-3)
        source = waveform(self.SINE)
        for t in (0.0, 0.001, 0.004, 0.0052, 0.006, 0.05, 0.051):
            found = set_point.update(t)
            assert found == pytest.approx(source(t), abs=5e-3)

    def test_late_and_early_cycles_keep_the_pace(self) -> None:
        """A tenth of a period of jitter neither repeats nor skips a value in the mean."""
        set_point = SetPoint(self.SINE, PERIOD, delay=2e-3, horizon=10e-3)
        source = waveform(self.SINE)
        for n in range(2000):
            t = (n + 0.3 * math.sin(7.0 * n)) * PERIOD
            assert set_point.update(t) == pytest.approx(source(n * PERIOD), abs=8e-3)

    def test_the_socket_has_no_future(self) -> None:
        """What came acts at once: known is now."""
        set_point = SetPoint(SetPointSettings(kind="socket", rate=1e4), PERIOD, delay=2e-3, lead=5e-3, horizon=10e-3)
        set_point.receive(0.5, 0.0)
        assert set_point.update(0.001) == 0.5
        assert (set_point.acting, set_point.ahead) == (0.5, 0.5)

    def test_a_reset_forgets_it(self) -> None:
        set_point = SetPoint(self.SINE, PERIOD, delay=2e-3, horizon=10e-3)
        set_point.update(0.2)
        set_point.reset()
        assert (set_point.acting, set_point.ahead, set_point.rate) == (0.0, 0.0, 0.0)
        assert set_point.update(0.0) == 0.0


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_file_is_interpolated(tmp_path: Path) -> None:
    """Between rows linear, other columns ignored, time counted from the first row."""
    write(tmp_path / "gait.csv", "t,x,tau_j_des\n5.0,a,0.0\n5.5,b,1.0\n6.0,c,0.0\n")
    source = waveform(SetPointSettings(kind="file", file="gait.csv"), tmp_path)
    assert [source(t) for t in (0.0, 0.25, 0.5, 0.75)] == pytest.approx([0.0, 0.5, 1.0, 0.5])


def test_file_ends_at_zero_or_starts_again(tmp_path: Path) -> None:
    """After the last row the torque is 0, or the file plays again when asked to."""
    write(tmp_path / "a.csv", "t,tau_j_des\n0,0.5\n1,0.7\n")
    once = waveform(SetPointSettings(kind="file", file="a.csv"), tmp_path)
    loop = waveform(SetPointSettings(kind="file", file="a.csv", loop=True), tmp_path)
    assert once(1.01) == 0.0
    assert loop(1.5) == pytest.approx(0.6)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty"),
        ("t,tau\n0,1\n", "column 'tau_j_des' is missing"),
        ("t,tau_j_des\n0,1\n", "1 rows"),
        ("t,tau_j_des\n0,1\n1,x\n", "line 3"),
        ("t,tau_j_des\n0,1\n1\n", "line 3"),
        ("t,tau_j_des\n0,1\n1,nan\n", "line 3.*finite"),
        ("t,tau_j_des\n0,1\n0,2\n", "line 3.*does not rise"),
        ("t,tau_j_des\n0,1\n1,5000\n", "line 3.*beyond 1000"),
    ],
)
def test_bad_file_is_one_line(tmp_path: Path, text: str, words: str) -> None:
    """A file that cannot be played names itself, the column or row, and what is allowed."""
    with pytest.raises(UsageError, match=words) as caught:
        read_file(write(tmp_path / "bad.csv", text))
    assert "bad.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_file_is_named(tmp_path: Path) -> None:
    """A set-point file that is not there is named when the set-point is built."""
    with pytest.raises(UsageError, match=r"none\.csv"):
        SetPoint(SetPointSettings(kind="file", file="none.csv"), PERIOD, tmp_path)


def test_socket_value_holds_until_its_timeout_and_then_ramps_to_zero() -> None:
    """What came over the socket is used for `timeout`, then goes to 0 at the rate."""
    set_point = SetPoint(SetPointSettings(kind="socket", timeout=0.1, rate=100.0), PERIOD)
    set_point.receive(1.0, 0.0)
    values = [set_point.update(PERIOD * n) for n in range(200)]
    assert values[50] == pytest.approx(1.0)
    assert values[99] == pytest.approx(1.0)
    assert values[105] == pytest.approx(0.5)
    assert values[-1] == 0.0


@pytest.mark.parametrize(
    ("value", "t"),
    [(math.nan, 0.05), (math.inf, 0.05), (0.5, -1e-9), (0.5, math.nan), (0.5, -math.inf), (0.5, -0.1)],
)
def test_what_is_no_number_or_from_before_the_enable_ends_what_was_wanted(value: float, t: float) -> None:
    """It replaces the value before it, which nobody wants any longer either."""
    set_point = SetPoint(SetPointSettings(kind="socket", timeout=1.0, rate=1e4), PERIOD)
    set_point.receive(1.0, 0.0)
    assert set_point.update(0.01) == 1.0
    set_point.receive(value, t)
    assert set_point.update(0.06) == 0.0
    assert set_point.silent


def test_the_time_of_a_socket_value_is_its_clients() -> None:
    """One that comes 0.15 s late acts for the 0.05 s that are left of its 0.2 s."""
    set_point = SetPoint(SetPointSettings(kind="socket", timeout=0.2, rate=1e4), PERIOD)
    set_point.receive(1.0, 0.10)
    assert set_point.update(0.25) == 1.0
    assert set_point.update(0.299) == 1.0
    assert set_point.update(0.301) == 0.0


def test_reset_forgets_what_was_received() -> None:
    """After a disable an old value does not play."""
    set_point = SetPoint(SetPointSettings(kind="socket", rate=1e4), PERIOD)
    set_point.receive(1.0, 0.0)
    set_point.update(0.0)
    set_point.reset()
    assert set_point.update(0.0) == 0.0


@pytest.mark.parametrize(
    "data",
    [
        {"kind": "file"},
        {"kind": "sine", "file": "a.csv"},
        {"kind": "multi_sine"},
        {"kind": "sine", "components": [{"amplitude": 1.0, "frequency": 1.0}]},
    ],
)
def test_contradictions_are_refused(data: dict[str, Any]) -> None:
    """A file without its kind, a kind without its file or components: an error."""
    with pytest.raises(msgspec.ValidationError, match="kind"):
        msgspec.convert(data, SetPointSettings)


@pytest.mark.slow
def test_a_set_point_from_a_file_maps_no_memory_that_a_lock_would_fill(tmp_path: Path) -> None:
    """The daemon locks what is mapped: a table reader's arena of 1 GB would be taken from the actuator PC."""
    path = tmp_path / "motion.csv"
    path.write_text("t,tau_j_des\n0,0\n1,0.5\n")
    code = "import sys; from tsa_ctrl.control.setpoint import read_file; read_file(sys.argv[1])"
    code += "; print(open('/proc/self/maps').read())"
    run = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, timeout=60, check=True
    )
    ranges = re.findall(r"^([0-9a-f]+)-([0-9a-f]+) rw", run.stdout, re.MULTILINE)
    assert ranges
    assert max(int(end, 16) - int(begin, 16) for begin, end in ranges) < 256 << 20
