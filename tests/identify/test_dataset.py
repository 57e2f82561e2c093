"""Preparation of a log: accepted input, derived columns with notes, and one-line errors."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.log.logs import HEADER, motion, records
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.admit import admit
from tsa_ctrl.identify.dataset import Dataset, load_log, load_logs, matches
from tsa_ctrl.log.convert import convert
from tsa_ctrl.log.mcap_file import McapFile
from tsa_ctrl.log.process import LogHeader
from tsa_ctrl.model.parameters import GearedDrive, load_model
from tsa_ctrl.model.signals import hold_direction

N = 400
T = np.arange(N) * 1e-3
CONFIG = Path(__file__).resolve().parents[2] / "config"
ONE = LogHeader(axes=("hip",), rate=1000.0, started=0.0)

Columns = dict[str, NDArray[np.float64]]


def columns(**changed: NDArray[np.float64] | None) -> Columns:
    """Return a good log. `changed` replaces columns, and None removes a column."""
    good: dict[str, NDArray[np.float64] | None] = {"t": T, **motion(N), **changed}
    return {name: values for name, values in good.items() if values is not None}


def with_value(name: str, row: int, value: float) -> Columns:
    changed = columns()[name].copy()
    changed[row] = value
    return columns(**{name: changed})


def as_csv(path: Path, table: Columns) -> Path:
    rows = np.column_stack(list(table.values())).tolist()
    path.write_text(",".join(table) + "\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows))
    return path


def test_every_kind_of_file_gives_the_same_columns(tmp_path: Path) -> None:
    table = columns()
    as_csv(tmp_path / "a.csv", table)
    convert(tmp_path / "a.csv", tmp_path / "a.parquet")
    log = McapFile(tmp_path / "a.mcap", ONE)
    log.write([records(N, **{name: values for name, values in table.items() if name != "t"})])
    log.finish()
    for name in ("a.csv", "a.parquet", "a.mcap"):
        found = load_log(tmp_path / name)
        assert found.rate == pytest.approx(1000.0)
        for column, values in table.items():
            np.testing.assert_allclose(found[column], values, rtol=0.0, atol=1e-12)


def test_a_log_is_traced_by_the_hash_of_its_file(tmp_path: Path) -> None:
    path = as_csv(tmp_path / "a.csv", columns())
    found = load_log(path)
    assert (found.name, found.sha256) == ("a.csv", hashlib.sha256(path.read_bytes()).hexdigest())


def test_a_good_log_needs_no_notes() -> None:
    found = Dataset.from_arrays(columns())
    assert (found.notes, found.derived, len(found)) == ((), frozenset(), N)
    assert found.seconds == pytest.approx(0.399)


def test_a_burst_without_numbers_is_a_hole() -> None:
    """The log is split into two pieces, and the note names the first row of the hole."""
    table = columns()
    values = table["tau_j"].copy()
    values[150:190] = np.nan
    found = Dataset.from_arrays({**table, "tau_j": values})
    assert np.isfinite(found["tau_j"]).all()
    assert found["t"][0] >= T[190]
    assert any("40 rows lack a number, the first from row 151 on" in note for note in found.notes)


@pytest.mark.parametrize("name", ["tau_m", "tau_j", "omega_j", "q_j"])
@pytest.mark.parametrize("factor", [10.0, 100.0])
@pytest.mark.parametrize("length", [1, 3])
def test_short_spikes_are_replaced_and_counted(name: str, factor: float, length: int) -> None:
    """Two spikes may be close together. An angle may have much smaller spikes."""
    table = columns(q_j=-np.cos(5.0 * T) / 5.0, omega_j=np.sin(5.0 * T))
    spiked, size = table[name].copy(), np.std(table[name])
    for place in (100, 102 + length, 300):
        spiked[place : place + length] += factor * size * (0.05 if name == "q_j" else 1.0)
    found = Dataset.from_arrays({**table, name: spiked})
    np.testing.assert_allclose(found[name], table[name], atol=0.08 * np.ptp(table[name]))
    told = f"column {name} has 3 spikes of up to {length} sample{'s' * (length > 1)}, {3 * length} samples in all, the"
    assert any(note.startswith(f"{told} first at row 101") for note in found.notes)


@pytest.mark.parametrize("name", ["tau_m", "tau_j", "q_j"])
def test_strict_rejects_spikes_with_their_first_row(tmp_path: Path, name: str) -> None:
    table = columns(q_j=-np.cos(5.0 * T) / 5.0, omega_j=np.sin(5.0 * T))
    assert not load_log(as_csv(tmp_path / "good.csv", table), strict=True).notes
    spiked = table[name].copy()
    spiked[100] += 20.0 * np.std(spiked)
    path = as_csv(tmp_path / "a.csv", {**table, name: spiked})
    with pytest.raises(UsageError, match=rf"a.csv: column {name} has 1 spike.* row 101.*--strict allows no repair"):
        load_log(path, strict=True)


def test_a_torque_with_too_many_spikes_is_rejected() -> None:
    table = columns()
    spiked = table["tau_m"].copy()
    spiked[50::20] += 20.0 * np.std(spiked)
    with pytest.raises(UsageError, match=r"tau_m has .* spikes of up to 1 sample, .* at most 3% can be replaced"):
        Dataset.from_arrays({**table, "tau_m": spiked})


def test_noise_pulses_and_jumps_are_no_spikes() -> None:
    """A contact of the joint, plain noise, and an encoder that slipped are kept."""
    random = np.random.default_rng(1)
    pulse = 0.01 * np.sin(5.0 * T)
    pulse[200:230] += np.hanning(30)
    jump = 0.5 * np.sin(5.0 * T) + np.where(T[N // 2] < T, 0.4, 0.0)
    made = columns(tau_m=random.normal(size=N), tau_j=pulse, q_j=jump, omega_j=None)
    found = Dataset.from_arrays(made)
    for name in ("tau_m", "tau_j", "q_j"):
        np.testing.assert_array_equal(found[name], made[name])


def test_an_angle_that_is_wrapped_to_one_turn_is_unwrapped() -> None:
    angle = 3.0 + 2.0 * np.sin(2.0 * np.pi * 3.0 * T)
    speed = 12.0 * np.pi * np.cos(2.0 * np.pi * 3.0 * T)
    wrapped = (angle + np.pi) % (2.0 * np.pi) - np.pi
    found = Dataset.from_arrays(columns(q_j=wrapped, omega_j=speed, q_m=None, omega_m=None))
    np.testing.assert_allclose(np.diff(found["q_j"]), np.diff(angle), atol=1e-9)
    assert any("column q_j is wrapped" in note for note in found.notes)


def test_the_angle_of_another_joint_is_unwrapped_too() -> None:
    angle = 3.0 + np.sin(2.0 * np.pi * 3.0 * T)
    found = Dataset.from_arrays(columns(**{"q_j.hip": (angle + np.pi) % (2.0 * np.pi) - np.pi}))
    np.testing.assert_allclose(np.diff(found["q_j.hip"]), np.diff(angle), atol=1e-9)


def test_a_column_without_any_value_is_absent() -> None:
    found = Dataset.from_arrays(columns(theta=np.full(N, np.nan)))
    assert "theta" not in found
    assert found.notes == ("column theta is empty and taken as absent",)


class TestDerivedVelocity:
    def test_how_and_at_what_cost_is_said(self) -> None:
        t = np.arange(8000) * 1e-3
        count = 2.0 * np.pi / 4096.0
        q = np.round(np.sin(5.0 * t) / count) * count
        found = Dataset.from_arrays({"t": t, "tau_m": np.cos(t), "q_j": q})
        assert found.derived == {"omega_j"}
        said = re.search(
            r"omega_j is derived from q_j: zero-phase low-pass at (\S+) Hz.* error (\S+) rad/s RMS", found.notes[0]
        )
        assert said is not None
        actual = float(np.std((found["omega_j"] - 5.0 * np.cos(5.0 * t))[500:-500]))
        assert actual / 2.0 < float(said[2]) < 2.0 * actual

    def test_the_low_pass_may_be_asked_for(self) -> None:
        found = Dataset.from_arrays(columns(omega_j=None, q_j=np.sin(5.0 * T)), cutoff=12.0)
        assert "12 Hz, as asked for" in found.notes[0]

    def test_noise_at_a_reversal_makes_one_turn_of_it(self) -> None:
        """At a slow reversal, a coarse encoder gives one change of direction, near the extremum."""
        t = np.arange(6000) * 1e-3
        rng = np.random.default_rng(5)
        q = 0.4 * np.sin(0.5 * np.pi * t) + 0.02 * np.sin(40.0 * t) * (np.abs((t % 2.0) - 1.0) > 0.5)
        count = 2.0 * np.pi / 2000.0
        noisy = np.round((q + 0.5 * count * rng.standard_normal(len(t))) / count) * count
        sigma = hold_direction(Dataset.from_arrays({"t": t, "tau_m": q, "q_j": noisy})["omega_j"])
        turns = 1e-3 * np.flatnonzero(np.diff(sigma))
        near = turns[np.abs(turns - 3.0) < 0.3]
        assert len(near) == 1
        assert abs(near[0] - 3.0) < 0.1

    def test_a_joint_at_rest_has_no_velocity(self) -> None:
        q = np.concatenate([np.full(1000, 0.2), 0.2 + 1e-4 * np.arange(1000), np.full(1000, 0.3)])
        count = 2.0 * np.pi / 4000.0
        q = np.round(q / count) * count
        t = np.arange(3000) * 1e-3
        found = Dataset.from_arrays({"t": t, "tau_m": np.cos(t), "q_j": q})
        assert set(found["omega_j"][:700].tolist()) == {0.0}
        assert set(found["omega_j"][2400:].tolist()) == {0.0}

    @pytest.mark.parametrize("back", [True, False])
    def test_a_joint_that_stands_has_no_velocity_and_turns_in_the_middle_of_the_rest(self, back: bool) -> None:
        """The joint slides, rests for 1 s and slides back or on. The direction changes half way, or not at all."""
        way = 0.05 * np.sin(0.5 * np.pi * np.arange(1000) * 1e-3)
        q = np.concatenate([way, np.full(1000, way[-1]), way[::-1] if back else 2.0 * way[-1] - way[::-1]])
        count = 2.0 * np.pi / 4000.0
        found = Dataset.from_arrays({"t": np.arange(3000) * 1e-3, "tau_m": q, "q_j": np.round(q / count) * count})
        sigma = hold_direction(found["omega_j"])
        turns = np.flatnonzero(np.diff(sigma))
        assert sigma[0] == 1.0
        assert len(turns) == back
        assert np.all(np.abs(turns - 1500) < 20)
        if not back:
            assert set(found["omega_j"][1300:1700].tolist()) == {0.0}

    def test_a_measured_velocity_is_kept(self) -> None:
        omega = 5.0 * np.cos(5.0 * T) + 0.1
        found = Dataset.from_arrays(columns(omega_j=omega, q_j=np.sin(5.0 * T)))
        np.testing.assert_array_equal(found["omega_j"], omega)

    def test_an_acceleration_that_was_recorded_is_taken(self) -> None:
        alpha = np.cos(3.0 * T)
        found = Dataset.from_arrays(columns(acceleration_j=alpha))
        np.testing.assert_array_equal(found.signals().acceleration, alpha)
        assert found.notes == ()


class TestJitter:
    @pytest.mark.parametrize("share", [0.02, 0.18])
    def test_a_little_is_resampled_and_reported(self, share: float) -> None:
        t = T + np.random.default_rng(3).uniform(-share, share, N) * 1e-3
        found = Dataset.from_arrays({"t": t, "tau_m": np.sin(5.0 * t), "omega_j": np.cos(5.0 * t)})
        assert f"time jitters by {found.jitter:.1%}" in found.notes[0]
        assert 0.9 * share < found.jitter < 1.1 * share
        assert np.ptp(np.diff(found["t"])) < 1e-12
        assert np.max(np.abs(found["tau_m"] - np.sin(5.0 * found["t"]))) < 0.005

    @pytest.mark.parametrize("share", [0.45])
    def test_more_is_resampled_with_its_share_and_by_strict_an_error_with_the_row(
        self, tmp_path: Path, share: float
    ) -> None:
        t = T + np.random.default_rng(3).uniform(-share, share, N) * 1e-3
        path = as_csv(tmp_path / "a.csv", {"t": t, "tau_m": np.sin(5.0 * t), "omega_j": np.cos(5.0 * t)})
        found = load_log(path)
        off = float(np.mean(np.abs(np.diff(t) * 1e3 - 1.0) > 0.2))
        assert f"of 399 steps of time ({off:.2%}) are off by more than 20%" in found.notes[0]
        assert found.rate == pytest.approx(1000.0, rel=1e-3)
        assert np.max(np.abs(found["tau_m"] - np.sin(5.0 * found["t"]))[1:-1]) < 1e-4
        with pytest.raises(UsageError, match=r"column t, row \d+.*: a step of .* at most 20% off is allowed"):
            load_log(path, strict=True)


class TestTablesAsTheyCome:
    """Time stamps of tables that no real-time loop wrote.

    The correction is right and reported with its share of rows.
    """

    @staticmethod
    def table(t: NDArray[np.float64]) -> Columns:
        return {"t": t, "tau_m": np.sin(2.0 * t), "omega_j": np.cos(2.0 * t)}

    def test_one_late_row_of_a_serial_bus(self) -> None:
        t = np.arange(1124) / 187.3
        t[912] += 0.34 / 187.3
        found = Dataset.from_arrays(self.table(t))
        assert "2 of 1123 steps of time (0.18%) are off" in found.notes[0]
        assert "the most at row 914" in found.notes[0]
        assert np.max(np.abs(found["tau_m"] - np.sin(2.0 * found["t"]))) < 1e-4

    def test_one_lost_sample(self) -> None:
        found = Dataset.from_arrays(self.table(np.delete(T, 200)))
        assert found.notes == ("1 samples (0.25%) that the file lacks are filled by straight lines",)
        assert (len(found), found.rate) == (N, pytest.approx(1000.0, rel=1e-9))
        assert np.max(np.abs(found["omega_j"] - np.cos(2.0 * T))) < 1e-5

    @pytest.mark.parametrize(
        ("t", "words"),
        [
            (np.full(N, 5.0), "column t: all 400 times are 5 s; log the time of each row with more digits"),
            (0.128 * np.arange(24_001), r"of a log of 3072 s .*t seems to be in milliseconds.*or cut the log"),
            (
                (np.arange(100)[:, None] + np.arange(20) * 1e-3).ravel(),
                r"column t, row \d+: a step of .*99 such gap\(s\) leave 1% of the rows",
            ),
            (
                np.concatenate([T, T]),
                r"column t, row 401: time 0 s does not increase .*sort the rows by time$",
            ),
        ],
        ids=["constant", "slow log of hours", "mostly holes", "time that runs back"],
    )
    def test_time_that_cannot_be_right_is_an_error(self, t: NDArray[np.float64], words: str) -> None:
        with pytest.raises(UsageError, match=words):
            Dataset.from_arrays(self.table(t))

    def test_a_wrong_unit_behind_a_lost_sample_comes_with_the_row_of_the_file(self) -> None:
        table = self.table(np.delete(T, np.arange(200, 205)))
        table["tau_m"][300:330] = 600.0
        table["tau_m"][302] = 800.0
        with pytest.raises(UsageError, match=r"column tau_m, row 303: 800 N\*m cannot be right"):
            Dataset.from_arrays(table)

    def test_a_slow_steady_log(self, tmp_path: Path) -> None:
        path = as_csv(tmp_path / "a.csv", self.table(0.128 * np.arange(500)))
        assert load_log(path).rate == pytest.approx(7.8125)
        with pytest.raises(UsageError, match="t seems to be in milliseconds"):
            load_log(path, strict=True)

    def test_doubled_stamps_are_one_row(self, tmp_path: Path) -> None:
        whole = np.arange(800) * 0.5e-3
        path = as_csv(tmp_path / "a.csv", {**self.table(whole), "t": np.floor(whole * 1e3 + 1e-6) * 1e-3})
        found = load_log(path)
        assert (len(found), found.rate) == (400, pytest.approx(1000.0))
        assert (
            "400 of 800 rows (50.00%) with the time stamp of the previous row were averaged, the first at row 2 "
            "(line 3)" in found.notes[0]
        )
        assert np.max(np.abs(found["tau_m"] - np.sin(2.0 * (found["t"] + 0.25e-3)))) < 1e-6
        with pytest.raises(UsageError, match="remove duplicates"):
            load_log(path, strict=True)

    def test_holes_split_a_log(self, tmp_path: Path) -> None:
        t = np.arange(8000) * 1e-3
        kept = (t < 3.0) | ((t > 3.5) & (t < 3.6)) | (t > 4.0)
        path = as_csv(tmp_path / "a.csv", self.table(t[kept]))
        first, second = load_logs([path])
        assert [first.name, second.name] == ["a.csv#1", "a.csv#2"]
        assert (first["t"][-1], second["t"][0]) == (pytest.approx(2.999), pytest.approx(4.001))
        assert "time has 2 gaps" in first.notes[0]
        assert "used as 2 pieces, 99 rows (1.39%) in shorter pieces are left out" in first.notes[0]
        longest = load_log(path)
        assert (longest.name, len(longest)) == ("a.csv", len(second))
        assert "of them the longest is used" in longest.notes[-1]
        assert [matches(second.name, pattern) for pattern in ("a.csv", "a*", "b*")] == [True, True, False]

    def test_a_row_behind_a_hole_has_the_files_number(self, tmp_path: Path) -> None:
        t = np.arange(4000) * 1e-3
        table = {name: np.delete(values, np.arange(1500, 2000)) for name, values in self.table(t).items()}
        table["tau_m"][2499] = np.nan
        with pytest.raises(UsageError, match=r"column tau_m, row 2500 \(line 2501\)"):
            load_logs([as_csv(tmp_path / "a.csv", table)])

    @pytest.mark.slow
    @given(lost=st.sets(st.integers(1, 1998), max_size=200), noise=st.floats(0.0, 0.4), seed=st.integers(0, 99))
    @settings(max_examples=30, deadline=None)
    def test_whatever_is_lost_or_late_the_signal_stays(self, lost: set[int], noise: float, seed: int) -> None:
        t = 5e-3 * (np.arange(2000) + np.random.default_rng(seed).uniform(-noise, noise, 2000))
        t = np.delete(t, sorted(lost))
        found = Dataset.from_arrays(self.table(t))
        # the resampled grid may end half a step beyond the last row
        inside = (found["t"] >= t[0]) & (found["t"] <= t[-1])
        assert np.max(np.abs(found["tau_m"] - np.sin(2.0 * found["t"]))[inside]) < 3e-3


class TestDaemonLog:
    @staticmethod
    def recorded(path: Path, keep: NDArray[np.int64], strict: bool = False, **changed: NDArray[np.float64]) -> Dataset:
        log = McapFile(path, ONE)
        log.write([records(N, **{**motion(N), **changed})[keep]])
        log.finish()
        return load_log(path, strict)

    @pytest.mark.parametrize(
        ("lost", "silent", "first", "rows", "said"),
        [
            pytest.param([100, 200, 201], [], 0, N, "3 cycles (0.75%) that the daemon skipped are filled", id="cycles"),
            pytest.param([], [50, 51, 90], 0, N, "3 cycles", id="single values"),
            pytest.param([], range(20), 20, N - 20, "the first 20 rows", id="before the devices report"),
            pytest.param(range(100, 150), [], 150, N - 150, "100 rows are left out", id="long gap"),
            pytest.param([], range(101, 150), 150, N - 150, "150 rows are left out", id="silent device"),
        ],
    )
    def test_what_is_missing_is_filled_or_left_out_and_said(
        self, tmp_path: Path, lost: list[int], silent: list[int], first: int, rows: int, said: str
    ) -> None:
        """Beyond a long gap, the longest stretch is used."""
        torque = motion(N)["tau_m"]
        torque[list(silent)] = np.nan
        keep = np.setdiff1d(np.arange(N), list(lost))
        found = self.recorded(tmp_path / "x.mcap", keep, tau_m=torque)
        assert len(found) == rows
        assert found["t"][0] == pytest.approx(T[first])
        assert said in found.notes[0]
        for name in ("tau_m", "tau_j"):
            assert np.max(np.abs(found[name] - motion(N)[name][first : first + rows])) < 1e-4

        if "the first" not in said:
            with pytest.raises(UsageError, match=r"(filled|left out).*; --strict allows no repair"):
                self.recorded(tmp_path / "y.mcap", keep, strict=True, tau_m=torque)

    @pytest.mark.parametrize("rows", [1, 9])
    def test_a_few_complete_rows_are_no_log(self, tmp_path: Path, rows: int) -> None:
        late = np.where(np.arange(N) < N - rows, np.nan, 0.5)
        with pytest.raises(UsageError, match=f"holds {rows} rows; at least 10 are needed"):
            self.recorded(tmp_path / "x.mcap", np.arange(N), tau_m=late)

    def test_a_wrong_unit_comes_with_the_row_of_the_log(self, tmp_path: Path) -> None:
        torque = np.where((T < 0.02) | np.isin(np.arange(N), (50, 51)), np.nan, 0.5)
        torque[300:305] = 600.0, 700.0, 800.0, 700.0, 600.0
        with pytest.raises(UsageError, match=r"column tau_m, row 301: 800 N\*m cannot be right"):
            self.recorded(tmp_path / "x.mcap", np.delete(np.arange(N), (100, 101)), tau_m=torque)

    @pytest.mark.parametrize(("until", "kept"), [(0.1, True), (0.3, False)])
    def test_a_load_cell_that_was_silent_most_of_the_time_is_taken_as_absent(
        self, tmp_path: Path, until: float, kept: bool
    ) -> None:
        found = self.recorded(tmp_path / "x.mcap", np.arange(N), t1=np.where(until > T, np.nan, 40.0))
        assert ("t1" in found) is kept
        assert len(found) == (N - 100 if kept else N)
        assert ("column t1 has a value in only" in found.notes[0]) is not kept

    def test_several_axes_want_a_name(self, tmp_path: Path) -> None:
        log = McapFile(tmp_path / "x.mcap", HEADER)
        log.write([records(N, **motion(N)), records(N, **motion(N))])
        log.finish()
        with pytest.raises(UsageError, match="select one"):
            load_log(tmp_path / "x.mcap")
        assert len(load_log(f"{tmp_path / 'x.mcap'}:knee")) == N


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (columns(t=None), "column t is missing (found: tau_m, tau_j, omega_j); add it"),
        ({"time": T, "motor torque": T}, "(found: time, motor torque); add it; tsa log import reads the tables"),
        (columns(tau_m=None, Tau_M=T), "is 'Tau_M' meant? rename it"),
        (columns(omega_j=None), "column omega_j or q_j is missing"),
        (with_value("tau_m", 16, np.nan), "column tau_m, row 17: found no number"),
        (with_value("omega_j", N - 1, np.inf), "column omega_j, row 400: found inf"),
        (with_value("t", 3, np.nan), "column t, row 4: found no number"),
        (with_value("t", 50, 0.01), "column t, row 51: time 0.01 s does not increase"),
        (columns(tau_m=np.full(N, np.nan)), "column tau_m has no value in any row"),
        ({name: values[:4] for name, values in columns().items()}, "holds 4 rows; at least 10"),
        (columns(t=1e3 * T), "t seems to be in milliseconds"),
        (columns(t=T / 3600.0), "t seems to be in minutes or hours"),
        (columns(tau_m=1000.0 * motion(N)["tau_m"]), "it seems to be in N*mm"),
        (columns(temperature=np.full(N, 293.0)), "it seems to be in kelvin"),
        (columns(q_j=np.degrees(-np.cos(5.0 * T) / 5.0)), "q_j seems to be in degrees"),
        (
            columns(q_j=-np.cos(5.0 * T) / 5.0, omega_j=np.degrees(np.sin(5.0 * T))),
            "omega_j seems to be in degrees/s",
        ),
    ],
)  # fmt: skip
def test_a_bad_log_is_one_line(tmp_path: Path, table: Columns, said: str) -> None:
    with pytest.raises(UsageError) as error:
        Dataset.from_arrays(table, "log")
    assert said in str(error.value)
    with pytest.raises(UsageError) as error:
        load_log(as_csv(tmp_path / "bad.csv", table))
    message = str(error.value)
    assert message.startswith(str(tmp_path / "bad.csv"))
    assert "\n" not in message


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (columns(omega_j=None, q_j=30.0 * np.sin(40.0 * T)), "column q_j swings over"),
        (columns(**{"q_j.hip": 10.0 * np.sin(40.0 * T)}), r"column q_j.hip swings over 20 rad.* in degrees"),
        (columns(omega_j=400.0 * np.sin(5.0 * T)), "omega_j, t = 0.314 s: 400 rad/s cannot be right"),
    ],
)
def test_tendons_move_no_joint_as_fast_as_a_motor(table: Columns, said: str) -> None:
    """A joint behind a gear has no such limit."""
    with pytest.raises(UsageError, match=said):
        admit(Dataset.from_arrays(table), load_model(CONFIG / "actuator.toml"))
    geared = GearedDrive(9.0)
    admit(Dataset.from_arrays(table).completed_for(geared), geared)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("x.csv", b"", "is empty"),
        ("x.csv", b"t,tau_m,tau_j,omega_j\n", "holds 0 rows"),
        ("x.txt", b"t\n", "unknown kind of log"),
        ("x.mcap", b"", "is empty"),
        ("missing.csv", None, "no such file"),
    ],
)
def test_a_bad_file_is_one_line(tmp_path: Path, name: str, content: bytes | None, said: str) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(UsageError, match=said):
        load_log(tmp_path / name)


@pytest.mark.parametrize("text", [["a"] * N, np.array(["1.0"] * N), np.array([None, "x"] * (N // 2), dtype=object)])
def test_a_column_of_text_is_one_line_if_a_model_needs_it(text: object) -> None:
    with pytest.raises(
        UsageError, match=r"log: column tau_j is no array of numbers \(.*\); give numbers in SI"
    ) as error:
        Dataset.from_arrays({**columns(), "tau_j": text}, "log")  # type: ignore[dict-item]
    assert "\n" not in str(error.value)
    found = Dataset.from_arrays({**columns(), "remark": text})  # type: ignore[dict-item]
    assert found.left_out == ("remark",)


def test_a_plain_drives_shaft_is_motor_and_joint() -> None:
    found = Dataset.from_arrays({"t": T, "tau_m": np.sin(5.0 * T), "omega_m": np.cos(5.0 * T)})
    np.testing.assert_array_equal(found.signals().omega_j, found["omega_m"])


@given(
    rate=st.sampled_from([50.0, 200.0, 1000.0, 4000.0]),
    start=st.floats(0.0, 1e6),
    digits=st.integers(6, 9),
    seed=st.integers(0, 10_000),
)
@settings(max_examples=40)
def test_rounded_times_of_any_rate_are_a_uniform_log(rate: float, start: float, digits: int, seed: int) -> None:
    t = np.round(start + np.arange(300) / rate, digits)
    noise = np.random.default_rng(seed).normal(size=300)
    found = Dataset.from_arrays({"t": t, "tau_m": noise, "omega_j": noise})
    assert found.rate == pytest.approx(rate, rel=1e-5)
    assert found.jitter < 0.02
