"""Test set-points: waveforms, files, and socket values that expire."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from tsa_ctrl.control.setpoint import SetPoint, largest, read_file, waveform
from tsa_ctrl.control.settings import Component, SetPointSettings
from tsa_ctrl.errors import UsageError

PERIOD = 1e-3


@pytest.mark.parametrize("offset", [0.0, 0.4])
@pytest.mark.parametrize(
    "frequencies",
    [
        (0.5, 0.51, 200.0),  # in phase only after 50 s, with 20 000 samples of the fastest sine in 2.5 s
        (0.3, 0.7, 1.1),
        (0.1234567, 0.7654321),  # a common period of 116 days
        (1.0,),
    ],
)
def test_the_largest_value_is_never_below_the_peak(offset: float, frequencies: tuple[float, ...]) -> None:
    """The sines begin opposite to each other. The bound is at most 1.2 % above the peak, or all amplitudes."""
    phases = [math.pi / 2.0 * (-1) ** n for n in range(len(frequencies))]
    parts = tuple(Component(amplitude=0.5, frequency=f, phase=p) for f, p in zip(frequencies, phases, strict=True))
    settings = SetPointSettings(kind="multi_sine", offset=offset, components=parts)
    t = np.arange(round(37.0 * max(frequencies) * 60.0)) / (37.0 * max(frequencies))
    sines = (0.5 * np.sin(2.0 * math.pi * f * t + p) for f, p in zip(frequencies, phases, strict=True))
    peak = np.abs(offset + sum(sines)).max()
    found = largest(settings)
    assert peak <= found
    assert found <= 1.012 * peak or found == offset + 0.5 * len(parts)


def test_gain_scales_the_source() -> None:
    """Half the gain gives half the torque."""
    set_point = SetPoint(SetPointSettings(kind="constant", offset=1.0, rate=1e4), PERIOD)
    set_point.gain = 0.5
    assert set_point.update(0.0) == 0.5


class TestTheFuture:
    """Tests of future set-points, which are known because a source is a function of time."""

    SINE = SetPointSettings(kind="sine", amplitude=0.5, frequency=2.0, rate=1e4)

    def test_acting_and_ahead_are_what_will_be_wanted(self) -> None:
        set_point = SetPoint(self.SINE, PERIOD, delay=2.5e-3, lead=6e-3, horizon=10.5e-3)
        source = waveform(self.SINE)
        for n in range(300):
            t = n * PERIOD
            assert set_point.update(t) == pytest.approx(source(t), abs=1e-12)
            assert set_point.acting == pytest.approx(source(t + 2.5e-3), abs=1e-4)
            assert set_point.ahead == pytest.approx(source(t + 10.5e-3), abs=1e-4)
            assert set_point.rate == pytest.approx(source(t + 6e-3) / PERIOD - source(t + 5e-3) / PERIOD, abs=0.2)

    def test_a_step_is_ramped_when_it_comes_and_not_before(self) -> None:
        step = SetPointSettings(kind="step", amplitude=1.0, at=0.1, rate=50.0)
        set_point = SetPoint(step, PERIOD, delay=2e-3, lead=6e-3, horizon=10e-3)
        values = [(set_point.update(n * PERIOD), set_point.acting) for n in range(200)]
        assert values[99] == pytest.approx((0.0, 0.1))
        assert values[101] == pytest.approx((0.1, 0.2))
        assert values[-1] == (1.0, 1.0)

    def test_late_and_early_cycles_keep_the_pace(self) -> None:
        """With a jitter of 0.3 periods, each cycle gets the value for its nominal time."""
        set_point = SetPoint(self.SINE, PERIOD, delay=2e-3, horizon=10e-3)
        source = waveform(self.SINE)
        for n in range(500):
            t = (n + 0.3 * math.sin(7.0 * n)) * PERIOD
            assert set_point.update(t) == pytest.approx(source(n * PERIOD), abs=8e-3)

    def test_the_socket_has_no_future(self) -> None:
        """A received value is active immediately, and the future values are equal to it."""
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


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty"),
        ("t,tau\n0,1\n", "column 'tau_j_des' is missing"),
        ("t,tau_j_des\n0,1\n", "too few rows"),
        ("t,tau_j_des\n0,1\n1,x\n", "line 3"),
        ("t,tau_j_des\n0,1\n1\n", "line 3"),
        ("t,tau_j_des\n0,1\n1,nan\n", "line 3.*finite"),
        ("t,tau_j_des\n0,1\n0,2\n", "line 3.*does not increase"),
        ("t,tau_j_des\n0,0\n1,-1000.1\n2,1001\n", r"row 2 \(line 3\): -1000.1 N\*m is beyond 1000; give"),
    ],
)
def test_bad_file_is_one_line(tmp_path: Path, text: str, words: str) -> None:
    """The error has one line and contains the file name and the problem."""
    with pytest.raises(UsageError, match=words) as caught:
        read_file(write(tmp_path / "bad.csv", text))
    assert "bad.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_file_is_named(tmp_path: Path) -> None:
    """The error occurs when the set-point is constructed, and it contains the file name."""
    with pytest.raises(UsageError, match=r"none\.csv"):
        SetPoint(SetPointSettings(kind="file", file="none.csv"), PERIOD, tmp_path)


@pytest.mark.parametrize(
    ("value", "t"),
    [(math.nan, 0.05), (math.inf, 0.05), (0.5, -1e-9), (0.5, math.nan), (0.5, -math.inf), (0.5, -0.1)],
)
def test_what_is_no_number_or_from_before_the_enable_ends_what_was_wanted(value: float, t: float) -> None:
    """An invalid value, or one from before the enable, ends the valid value before it."""
    set_point = SetPoint(SetPointSettings(kind="socket", timeout=1.0, rate=1e4), PERIOD)
    set_point.receive(1.0, 0.0)
    assert set_point.update(0.01) == 1.0
    set_point.receive(value, t)
    assert set_point.update(0.06) == 0.0
    assert set_point.silent


def test_the_time_of_a_socket_value_is_its_clients() -> None:
    """A value that arrives 0.15 s late is active for the remaining 0.05 s of its timeout of 0.2 s."""
    set_point = SetPoint(SetPointSettings(kind="socket", timeout=0.2, rate=1e4), PERIOD)
    set_point.receive(1.0, 0.10)
    assert set_point.update(0.25) == 1.0
    assert set_point.update(0.299) == 1.0
    assert set_point.update(0.301) == 0.0


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
    """A file without its kind is rejected, and so is a kind without its file or components."""
    with pytest.raises(msgspec.ValidationError, match="kind"):
        msgspec.convert(data, SetPointSettings)


def test_every_waveform_is_what_its_settings_say_at_any_time() -> None:
    times = [0.013 * n for n in range(400)]
    assert waveform(SetPointSettings(kind="constant", offset=0.4))(3.0) == 0.4
    sine = waveform(SetPointSettings(kind="sine", offset=0.1, amplitude=0.7, frequency=1.3))
    assert [sine(t) for t in times] == pytest.approx([0.1 + 0.7 * math.sin(2.0 * math.pi * 1.3 * t) for t in times])
    both = (Component(amplitude=0.4, frequency=0.9, phase=0.3), Component(amplitude=0.2, frequency=2.1, phase=-1.0))
    multi = waveform(SetPointSettings(kind="multi_sine", offset=-0.2, components=both))
    assert [multi(t) for t in times] == pytest.approx(
        [-0.2 + 0.4 * math.sin(math.tau * 0.9 * t + 0.3) + 0.2 * math.sin(math.tau * 2.1 * t - 1.0) for t in times]
    )
    chirp = waveform(
        SetPointSettings(kind="chirp", offset=0.2, amplitude=0.5, frequency=0.5, end_frequency=2.5, duration=4.0)
    )
    phases = [math.tau * (0.5 * (t % 4.0) + 0.25 * (t % 4.0) ** 2) for t in times]  # rises by 0.5 Hz per s
    assert [chirp(t) for t in times] == pytest.approx([0.2 + 0.5 * math.sin(phase) for phase in phases])
    step = waveform(SetPointSettings(kind="step", offset=0.2, amplitude=0.5, at=1.0))
    assert [step(t) for t in (0.0, 0.999, 1.0, 5.0)] == [0.2, 0.2, 0.7, 0.7]
    with pytest.raises(UsageError, match="has no waveform"):
        waveform(SetPointSettings(kind="socket"))


def test_a_file_at_its_rows_before_and_after_them(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", "t,x,tau_j_des\n2,a,0.5\n3,b,0.7\n5,c,-0.3\n")  # other columns are ignored
    once = waveform(SetPointSettings(kind="file", file="a.csv", offset=0.1), tmp_path)
    loop = waveform(SetPointSettings(kind="file", file="a.csv", offset=0.1, loop=True), tmp_path)
    for source in (once, loop):
        found = [source(t) for t in (-1.0, 0.0, 0.5, 1.0, 2.0, 3.0)]
        assert found == pytest.approx([0.6, 0.6, 0.7, 0.8, 0.3, -0.2])
    assert [once(t) for t in (3.001, 100.0)] == [0.0, 0.0]
    assert [loop(t) for t in (3.5, 7.0)] == pytest.approx([0.7, 0.8])


def test_a_file_may_say_as_much_as_a_setting(tmp_path: Path) -> None:
    assert read_file(write(tmp_path / "a.csv", "t,tau_j_des\n0,1000\n1,-1000\n")) == ([0.0, 1.0], [1000.0, -1000.0])


def test_a_socket_value_counts_for_its_timeout_to_the_last_bit_and_the_rate_is_its_slope() -> None:
    set_point = SetPoint(SetPointSettings(kind="socket", timeout=0.25, rate=100.0), 0.125)  # 12.5 N*m per period
    set_point.receive(20.0, 0.0)
    assert [set_point.update(t) for t in (0.0, 0.125)] == [12.5, 20.0]
    assert (set_point.rate, set_point.silent) == (60.0, False)
    assert (set_point.update(0.25), set_point.rate, set_point.silent) == (20.0, 0.0, False)
    assert (set_point.update(0.375), set_point.rate, set_point.silent) == (7.5, -100.0, True)
    assert (set_point.acting, set_point.ahead) == (7.5, 7.5)
    set_point.gain = -0.5
    set_point.receive(4.0, 0.5)
    assert set_point.update(0.5) == -2.0
    set_point.reset()
    assert (set_point.silent, set_point.value, set_point.gain) == (False, 0.0, -0.5)
    assert set_point.update(0.0) == 0.0
    assert set_point.silent


def test_a_rate_that_is_reached_exactly_is_no_jump() -> None:
    for way in (1.0, -1.0):
        set_point = SetPoint(SetPointSettings(kind="constant", offset=way, rate=4.0), 0.125)
        assert [set_point.update(0.125 * n) for n in range(4)] == [way * 0.5, way, way, way]


def ramp(folder: Path, **times: float) -> SetPoint:
    """Return a set-point that is a ramp of 1 N*m/s with a period of an eighth of a second."""
    write(folder / "ramp.csv", "t,tau_j_des\n0,0\n100,100\n")
    return SetPoint(SetPointSettings(kind="file", file="ramp.csv", rate=1.0), 0.125, folder, **times)


@pytest.mark.parametrize("time", ["delay", "lead", "horizon"])
def test_what_is_known_of_the_future_is_as_long_as_the_longest_of_its_times(time: str, tmp_path: Path) -> None:
    set_point = ramp(tmp_path, **{time: 0.5})
    for n in range(1, 20):
        assert set_point.update(0.125 * n) == pytest.approx(0.125 * n)
        assert set_point.ahead == pytest.approx(0.125 * n + 0.5)
        assert set_point.acting == pytest.approx(0.125 * n + (0.5 if time == "delay" else 0.0))
        assert set_point.rate == pytest.approx(1.0)


@pytest.mark.parametrize(("late", "periods"), [(0.45, 1), (0.5, 1), (0.55, 2), (4.3, 5), (5.3, 6), (5.55, 6.55)])
def test_a_cycle_that_is_late_by_more_than_half_a_period_is_the_next_one(
    late: float, periods: float, tmp_path: Path
) -> None:
    """A cycle gets its own value if it is late by up to half a period, and otherwise the value of the next period.

    Lateness beyond the known future restarts the set-point at the current time.
    """
    set_point = ramp(tmp_path, delay=0.5)
    set_point.update(0.125)
    assert set_point.update(0.125 * (1.0 + late)) == pytest.approx(0.125 * periods)


@pytest.mark.parametrize("gap", [1, 2, 5, 6, 7, 20])
def test_after_a_gap_the_limited_set_point_goes_on_from_what_was_known(gap: int) -> None:
    """Within the known future, the value is the same as without the gap.

    Beyond it, the value continues from the last known one at the rate.
    """
    settings = SetPointSettings(kind="step", amplitude=10.0, at=0.0, rate=4.0)
    one, other = (SetPoint(settings, 0.125, delay=0.5) for _ in range(2))
    one.update(0.0)
    for n in range(gap + 1):
        other.update(0.125 * n)
    assert one.update(0.125 * gap) == pytest.approx(other.value if gap <= 6 else 3.5)


@pytest.mark.slow
def test_a_set_point_from_a_file_maps_no_memory_that_a_lock_would_fill(tmp_path: Path) -> None:
    """Reading a set-point file maps no writable memory range of 256 MiB or more.

    The daemon locks its memory, and the arena of a table reader would occupy 1 GB.
    """
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


def test_no_gain_takes_the_set_point_beyond_its_limit() -> None:
    for gain in (-2.0, 2.0):
        point = SetPoint(SetPointSettings(kind="socket", rate=10_000.0), 1e-3, limit=1.5)
        point.gain = gain
        point.receive(1.0, 0.0)
        assert point.update(0.0) == math.copysign(1.5, gain)
