"""Import files with several clocks, without a clock, with dates, with footers or with several sheets."""

from __future__ import annotations

import importlib
import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.log.logs import import_log, understood
from tsa_ctrl.cli import log_import
from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.table import read_table

N = 400
T = np.arange(N) * 0.01
MOTOR, JOINT = np.sin(3.0 * T), 0.5 * np.cos(2.0 * T)
Numbers = NDArray[np.float64]


def h5(path: Path, groups: dict[str, dict[str, Numbers]]) -> Path:
    with importlib.import_module("h5py").File(path, "w") as file:
        for group, columns in groups.items():
            for name, values in columns.items():
                file[f"{group}/{name}"] = values
                if "torque" in name:
                    file[f"{group}/{name}"].attrs["unit"] = "Nm"
    return path


def mat(path: Path, content: dict[str, Any]) -> Path:
    scipy_io: Any = importlib.import_module("scipy.io")
    scipy_io.savemat(path, content)
    return path


def workbook(path: Path, sheets: dict[str, list[tuple[Any, ...]]]) -> Path:
    book = importlib.import_module("openpyxl").Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
    book.save(path)
    return path


@pytest.mark.parametrize(("step", "start", "shift"), [(1, 0, 0.003), (2, 0, 0.0), (2, 0, 0.0007), (1, 50, 0.0)])
@pytest.mark.parametrize("kind", ["h5", "mat"])
def test_groups_with_their_own_time_are_interpolated_on_one_clock(
    kind: str, step: int, start: int, shift: float, tmp_path: Path
) -> None:
    """The second group has another rate, another offset, or another start with the same number of rows."""
    first, second = slice(0, N - start), slice(start, None, step)
    time, torque = T[second] + shift, JOINT[second]
    if kind == "h5":
        groups = {
            "run/drive": {"time_s": T[first], "motor_torque": MOTOR[first]},
            "run/sensor": {"time_s": time, "joint_torque": torque},
        }
        path = h5(tmp_path / "x.h5", groups)
    else:
        path = mat(tmp_path / "x.mat", {"t": T[first], "tau_m": MOTOR[first], "sens": {"t": time, "tau_j": torque}})
    columns = understood(path).columns
    t = columns["t"]
    np.testing.assert_allclose(columns["tau_j"], np.interp(t, time, torque), atol=1e-9)
    np.testing.assert_allclose(columns["tau_m"], np.interp(t, T, MOTOR), atol=1e-9)
    assert t[0] >= time[0]
    assert t[-1] <= time[-1] + 1e-9


def test_groups_with_equal_clocks_are_not_interpolated(tmp_path: Path) -> None:
    groups = {
        "drive": {"time_ms": 1e3 * T, "motor_torque": MOTOR},
        "sensor": {"time_s": T, "joint_torque": JOINT},
    }
    done = understood(h5(tmp_path / "x.h5", groups))
    assert {column.name: column.source for column in done.mapped}["t"] == "drive/time_ms"
    np.testing.assert_array_equal(done.columns["tau_j"], JOINT)


def test_a_structure_for_each_signal_has_one_clock(tmp_path: Path) -> None:
    signals = {"tau_m": {"time": T, "data": MOTOR}, "tau_j": {"time": T, "data": JOINT}}
    done = understood(mat(tmp_path / "x.mat", {"out": signals}), yes=True)
    np.testing.assert_array_equal(done.columns["tau_j"], JOINT)


@pytest.mark.parametrize("label", ["signal", "Name", "channel", ""])
def test_the_elements_of_a_structure_array_have_their_own_clocks(label: str, tmp_path: Path) -> None:
    """Without a field of names, the number of the element distinguishes the columns."""
    fields = [("time", object), ("value", object), *([(label, object)] if label else [])]
    rows = [("tau_m", T, MOTOR), ("tau_j", T[::2] + 0.003, JOINT[::2])]
    array = np.array([(t, x, *([name] if label else [])) for name, t, x in rows], dtype=fields)
    path = mat(tmp_path / "x.mat", {"log": array})
    given = () if label else ("tau_m=log.1.value|N*m", "tau_j=log.2.value|N*m")
    ((done,), _) = log_import.understand_all([path], None, given, True)
    t = done.columns["t"]
    np.testing.assert_allclose(done.columns["tau_m"], np.interp(t, T, MOTOR), atol=1e-9)
    np.testing.assert_allclose(done.columns["tau_j"], np.interp(t, T[::2] + 0.003, JOINT[::2]), atol=1e-9)


def test_trials_in_a_structure_array_are_not_mixed_without_a_question(tmp_path: Path) -> None:
    array = np.array([(T, MOTOR), (T[:30], JOINT[:30])], dtype=[("t", object), ("tau_m", object)])
    with pytest.raises(UsageError, match=r"tau_m may be 'trial\.1\.tau_m', 'trial\.2\.tau_m'"):
        understood(mat(tmp_path / "x.mat", {"trial": array}))


def test_the_time_of_a_structure_applies_to_the_structures_in_it(tmp_path: Path) -> None:
    parts = np.array([(MOTOR,), (JOINT,)], dtype=[("values", object)])
    content = {"log": {"time": T, "signals": parts}, "short": np.arange(5.0)}
    ((done,), _) = log_import.understand_all(
        [mat(tmp_path / "x.mat", content)], None, ("tau_m=log.signals.values.1|N*m", "t=log.time|s"), False
    )
    np.testing.assert_array_equal(done.columns["tau_m"], MOTOR)


def test_a_column_without_a_time_belongs_to_the_only_clock_of_its_length(tmp_path: Path) -> None:
    content = {
        "fast": {"t": T, "tau_m": MOTOR},
        "slow": {"t": T[::2], "q_j": JOINT[::2]},
        "tau_j": JOINT[::2],
        "gains": np.arange(7.0),
    }
    done = understood(mat(tmp_path / "x.mat", content))
    np.testing.assert_allclose(done.columns["tau_j"], done.columns["q_j"])
    assert done.left == ["gains"]


def test_a_column_that_fits_two_clocks_is_not_imported(tmp_path: Path) -> None:
    content = {"a": {"t": T, "tau_m": MOTOR}, "b": {"t": T + 0.05, "q_j": JOINT}, "tau_j": JOINT}
    done = understood(mat(tmp_path / "x.mat", content))
    assert set(done.columns) == {"t", "tau_m", "q_j"}
    assert done.left == ["tau_j"]


def test_dropped_columns_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.savez(tmp_path / "x.npz", t=T, tau_m=MOTOR, tau_j=JOINT[:-1], gains=np.arange(3.0))
    assert import_log(str(tmp_path / "x.npz"), "--out", str(tmp_path / "out")) == 0
    assert "not imported: 'tau_j', 'gains'" in capsys.readouterr().out
    assert import_log(str(tmp_path / "x.npz"), "--out", str(tmp_path / "out"), "--json") == 0
    assert json.loads(capsys.readouterr().out)["not_taken"] == ["tau_j", "gains"]


@pytest.mark.parametrize(
    ("stamps", "seconds"),
    [
        (["01.05.2024 09:59:50", "01.05.2024 09:59:50.5", "1.5.2024 10:00:00"], [0.0, 0.5, 10.0]),
        (["31.12.2024 23:59:59,5", "01.01.2025 00:00:00"], [0.0, 0.5]),
        (["23:59:59", "23:59:59.5", "00:00:00.25", "00:00:01"], [0.0, 0.5, 1.25, 2.0]),
        (["59:59.500", "00:00.250", "00:01.000"], [0.0, 0.75, 1.5]),
        (["11:59:59 AM", "12:00:01 PM", "1:00:00 PM"], [0.0, 2.0, 3601.0]),
        (["12/31/2024 11:59:59.5 PM", "1/1/2025 12:00:00 AM"], [0.0, 0.5]),
        (["31/12/2024 23:59:59.5", "01/01/2025 00:00:00"], [0.0, 0.5]),
        (["2024/03/31 01:59:59.5", "2024/03/31 03:00:00"], [0.0, 3600.5]),  # no change to summer time
        (["10:00:00", "NaT", "10:00:02"], [0.0, 2.0]),
        (["12:00:00:250", "12:00:00:750"], [0.0, 0.5]),
        (["0 days 23:59:39.5", "0 days 23:59:59.5", "1 days 00:00:00"], [0.0, 20.0, 20.5]),  # as pandas writes it
    ],
)
def test_dates_and_times_of_day_become_seconds(stamps: list[str], seconds: list[float], tmp_path: Path) -> None:
    rows = "".join(f"{stamp};{i}\n" for i, stamp in enumerate(stamps))
    (tmp_path / "x.csv").write_text(f"Zeit;motor torque [Nm]\n{rows}")
    done = understood(tmp_path / "x.csv")
    assert done.mapped[0].unit == "date"
    np.testing.assert_allclose(done.columns["t"], seconds, atol=1e-6)


def test_a_date_whose_month_is_not_clear_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("Zeit;tau_m\n03/04/2024 23:59:59;1\n03/05/2024 00:00:00;2\n")
    with pytest.raises(UsageError, match="line 3: '03/05/2024 00:00:00' may have the month or the day first"):
        understood(tmp_path / "x.csv")


def test_an_impossible_time_of_day_is_reported_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("Zeit;tau_m\n10:00:00;1\n10:61:00;2\n")
    with pytest.raises(UsageError, match="line 3: '10:61:00' is not a date and time like"):
        understood(tmp_path / "x.csv")


@pytest.mark.parametrize("kind", ["M8", "m8"])
def test_dates_and_durations_of_a_binary_file_become_seconds(kind: str, tmp_path: Path) -> None:
    stamps = (1e6 * T).round().astype("m8[us]") + (np.datetime64("2024-01-01") if kind == "M8" else 0)
    np.savez(tmp_path / "x.npz", timestamp=stamps, motor_torque_Nm=MOTOR)
    done = understood(tmp_path / "x.npz")
    np.testing.assert_allclose(done.columns["t"], T, atol=1e-9)


@pytest.mark.parametrize(
    ("bits", "unit", "scale"), [(32, "us", 1e6), (16, "ms", 1e3), (24, "us", 1e6), (32, "s", 1.0), (16, "us", 1e6)]
)
@pytest.mark.parametrize("signed", [False, True])
def test_a_counter_of_time_that_wraps_continues(
    bits: int, unit: str, scale: float, signed: bool, tmp_path: Path
) -> None:
    """In the unit s, a program has converted a counter of microseconds."""
    ticks = (2**bits // (1 + signed) - 3000 + np.round(T * (scale if scale > 1.0 else 1e6)).astype(np.int64)) % 2**bits
    ticks = ticks - 2**bits * (ticks >= 2 ** (bits - 1)) if signed else ticks
    np.savez(tmp_path / "x.npz", time=ticks if scale > 1.0 else 1e-6 * ticks, tau_m=MOTOR)
    done = understood(tmp_path / "x.npz", f"t=time|{unit}")
    np.testing.assert_allclose(done.columns["t"], T, atol=1e-9)
    assert f"at {bits} bits" in done.notes[-1]


@pytest.mark.parametrize("end", [4.0, 60.0])
def test_two_runs_in_a_file_are_not_a_counter_that_wraps(end: float, tmp_path: Path) -> None:
    t = np.concatenate([np.arange(0.0, end, 0.01), T])
    np.savez(tmp_path / "x.npz", t=t, tau_m=np.sin(t))
    with pytest.raises(UsageError, match="the time decreases from"):
        understood(tmp_path / "x.npz")


@pytest.mark.parametrize(
    ("start", "factor", "unit"),
    [(0.0, 1.0, "s"), (0.0, 1e3, "ms"), (0.0, 1e6, "us"), (1.7e12, 1e3, "ms"), (5.0, 1e9, "ns")],
)
def test_the_unit_that_is_proposed_for_time_gives_a_possible_rate(
    start: float, factor: float, unit: str, tmp_path: Path
) -> None:
    np.savez(tmp_path / "x.npz", time=start + factor * T, tau_m=MOTOR)
    _, (proposal,) = log_import.understand_all([tmp_path / "x.npz"], None, (), True)
    assert proposal == f"t=time|{unit}"


def test_dates_and_nulls_of_parquet_are_read(tmp_path: Path) -> None:
    importlib.import_module("duckdb").execute(
        "COPY (SELECT TIMESTAMP '2024-01-01' + INTERVAL (10 * i) MILLISECOND AS timestamp, CASE WHEN i = 5 THEN NULL "
        f"ELSE i END AS motor_torque_Nm FROM range(20) r(i)) TO '{tmp_path / 'x.parquet'}' (FORMAT parquet)"
    )
    done = understood(tmp_path / "x.parquet")
    np.testing.assert_allclose(done.columns["tau_m"], np.delete(np.arange(20.0), 5))
    np.testing.assert_allclose(done.columns["t"], np.delete(np.arange(20) * 0.01, 5), atol=1e-9)


def test_units_next_to_the_values_of_a_binary_file_are_used(tmp_path: Path) -> None:
    content = {"time": {"data": 1e3 * T, "unit": "ms"}, "motor_torque": {"data": 1e3 * MOTOR, "Units": "mNm"}}
    path = h5(tmp_path / "x.h5", {"daq": {"time": 1e3 * T, "motor_moment": 1e3 * MOTOR}})
    with importlib.import_module("h5py").File(path, "a") as file:
        file["daq/time"].attrs["units"] = b"ms"
        file["daq/motor_moment"].attrs["Unit"] = np.array(["mNm"], dtype=object)
    for done in (understood(mat(tmp_path / "x.mat", {"log": content})), understood(path)):
        np.testing.assert_allclose(done.columns["t"], T, atol=1e-9)
        np.testing.assert_allclose(done.columns["tau_m"], MOTOR, atol=1e-9)


def test_values_of_a_binary_file_that_are_not_finite_are_holes(tmp_path: Path) -> None:
    np.savez(tmp_path / "x.npz", t=T, tau_m=np.concatenate([[np.inf, 9.91e37], MOTOR[2:]]))
    done = understood(tmp_path / "x.npz")
    np.testing.assert_array_equal(done.columns["tau_m"], MOTOR[2:])
    assert done.markers == {"tau_m": {"inf": 1, "9.91e+37": 1}}


def test_a_footer_is_ignored_and_counted(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("t;tau_m\n0;1\n1;2\n2;3\nEnd of recording\nMean;0.2\nMax;0.4\n")
    done = understood(tmp_path / "x.csv")
    assert done.table.ignored == 3
    np.testing.assert_array_equal(done.columns["tau_m"], [1.0, 2.0, 3.0])


def test_many_texts_at_the_end_are_reported_instead_of_ignored(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("t;tau_m\n0;1\n1;2\n" + "overload;3\n" * 11)
    with pytest.raises(UsageError, match="line 4: 'overload' is not a number"):
        understood(tmp_path / "x.csv")


def test_a_rate_replaces_a_missing_time_and_is_kept_in_the_mapping(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.savez(tmp_path / "x.npz", tau_m=MOTOR, tau_j=JOINT)
    line = (str(tmp_path / "x.npz"), "--out", str(tmp_path / "a"))
    assert import_log(*line) == 2
    assert "or --rate HZ" in capsys.readouterr().err
    assert import_log(*line, "--rate", "100") == 0
    found = read_table(tmp_path / "a/x.csv").columns
    np.testing.assert_allclose(found["t"], T, atol=1e-12)
    again = ("--map", str(tmp_path / "a/x-map.toml"), "--out", str(tmp_path / "b"))
    assert import_log(str(tmp_path / "x.npz"), *again) == 0
    assert (tmp_path / "a/x.csv").read_bytes() == (tmp_path / "b/x.csv").read_bytes()


def test_a_rate_is_rejected_next_to_a_time_column(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("Zeit [s];tau_m\n0;1\n1;2\n")
    with pytest.raises(UsageError, match=r"rate of 100 Hz is given, but the column 'Zeit \[s\]' is the time"):
        understood(tmp_path / "x.csv", rate=100.0)


def test_a_mapping_with_a_table_only_leaves_the_names_in_use(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("Zeit [s];motor torque [Nm]\n0,5;1\n1,5;2\n")
    (tmp_path / "map.toml").write_text('[table]\ndecimal = ","\n')
    done, _ = log_import.understand_all([tmp_path / "x.csv"], tmp_path / "map.toml", (), False)
    np.testing.assert_array_equal(done[0].columns["tau_m"], [1.0, 2.0])


def test_merged_titles_of_a_workbook_complete_the_names(tmp_path: Path) -> None:
    head: list[tuple[Any, ...]] = [("Test 12",), (), ("", "Motor", "", "Gelenk", "")]
    head += [("Zeit", "Moment", "Drehzahl", "Winkel", "Moment"), ("s", "mNm", "1/min", "°", "Nm")]
    rows = zip(T.tolist(), (1e3 * MOTOR).tolist(), T.tolist(), np.degrees(JOINT).tolist(), JOINT.tolist(), strict=True)
    columns = understood(workbook(tmp_path / "x.xlsx", {"Data": [*head, *rows]})).columns
    for name, values in (("tau_m", MOTOR), ("omega_m", T * np.pi / 30.0), ("q_j", JOINT), ("tau_j", JOINT)):
        np.testing.assert_allclose(columns[name], values, atol=1e-12)


def test_the_first_sheet_with_a_table_is_read_and_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [("Messung 7",), (), ("Zeit", "Motormoment"), ("s", "mNm"), *zip(T.tolist(), MOTOR.tolist(), strict=True)]
    path = workbook(tmp_path / "x.xlsx", {"Notes": [("Hello",)], "Data": rows})
    assert import_log(str(path), "--out", str(tmp_path / "out")) == 0
    assert "the table is sheet 'Data'; no table of numbers in 'Notes'" in capsys.readouterr().out
    np.testing.assert_allclose(read_table(tmp_path / "out/x.csv").columns["tau_m"], 1e-3 * MOTOR)


def test_one_row_per_signal_is_rejected_with_the_remedy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = "".join(f"{t},{name},{t}\n" for t in T.tolist() for name in ("tau_m", "tau_j"))
    (tmp_path / "x.csv").write_text(f"time,signal,value\n{rows}")
    assert import_log(str(tmp_path / "x.csv"), "--out", str(tmp_path / "out"), "--yes") == 2
    said = capsys.readouterr().err
    assert "pivot the table to one column per signal" in said
    assert said.count("\n") == 1


def test_a_message_lists_at_most_twelve_names(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "x.csv", [T, MOTOR], fmt="%.3f", delimiter=",")
    with pytest.raises(UsageError, match=f"'column 12' and {N - 12} more") as error:
        understood(tmp_path / "x.csv")
    assert len(str(error.value)) < 1500


@pytest.mark.parametrize(
    ("seconds", "fraction", "per_second"),
    [
        ("header.stamp.sec", "header.stamp.nanosec", 10**9),
        ("secs", "nsecs", 10**9),
        ("tv_sec", "tv_usec", 10**6),
        ("stamp_s", "stamp_ns", 10**9),
        ("Time (s)", "Time (ms)", 10**3),
    ],
)
def test_a_time_in_two_columns_is_put_together(seconds: str, fraction: str, per_second: int, tmp_path: Path) -> None:
    stamps = 1_700_000_000 * per_second + np.rint((T + 0.5) * per_second).astype(np.int64)
    columns = {seconds: stamps // per_second, fraction: stamps % per_second, "tau_m": MOTOR}
    rows = "\n".join(",".join(map(str, row)) for row in zip(*(c.tolist() for c in columns.values()), strict=True))
    (tmp_path / "x.csv").write_text(f"{','.join(columns)}\n{rows}\n")
    np.savez(tmp_path / "x.npz", **{name.replace(".", "_"): values for name, values in columns.items()})
    for path in (tmp_path / "x.csv", tmp_path / "x.npz"):
        done = understood(path)
        np.testing.assert_allclose(done.columns["t"], T, atol=1e-9)
        assert done.left == []
    assert import_log(str(tmp_path / "x.csv"), "--out", str(tmp_path / "a")) == 0
    again = ("--map", str(tmp_path / "a/x-map.toml"), "--out", str(tmp_path / "b"))
    assert import_log(str(tmp_path / "x.csv"), *again) == 0
    assert (tmp_path / "a/x.csv").read_bytes() == (tmp_path / "b/x.csv").read_bytes()


def test_two_times_are_not_the_parts_of_one(tmp_path: Path) -> None:
    rows = "".join(f"{t:.3f},{1e9 * t:.0f},{x}\n" for t, x in zip(T.tolist(), MOTOR.tolist(), strict=True))
    (tmp_path / "x.csv").write_text("time_s,time_ns,tau_m\n" + rows)
    with pytest.raises(UsageError, match="t may be 'time_s', 'time_ns'"):
        understood(tmp_path / "x.csv")


def test_a_frame_of_pandas_has_the_names_of_its_columns(tmp_path: Path) -> None:
    """The format "table" stores blocks of columns, with pickled names that are read without executing them."""
    for name, kind, index in (
        ("time [s]", b"float", T),
        ("time", b"datetime64[ns]", np.rint(1e9 * T).astype(np.int64)),
    ):
        table = np.zeros(
            N, dtype=[("index", index.dtype), ("values_block_0", "<f8", (2,)), ("values_block_1", "S4", (1,))]
        )
        table["index"], table["values_block_0"] = index, np.column_stack([MOTOR, JOINT])
        with importlib.import_module("h5py").File(tmp_path / "x.h5", "w") as file:
            group = file.create_group("df")
            group.attrs["pandas_type"] = np.bytes_(b"frame_table")
            group.attrs["info"] = np.bytes_(pickle.dumps({1: {}, "index": {"index_name": name}}, protocol=0))
            group["table"] = table
            for field, value in (
                ("index", kind),
                ("values_block_0", pickle.dumps(["motor torque [Nm]", "joint torque [Nm]"], protocol=0)),
                ("values_block_1", pickle.dumps(["mode"], protocol=0)),
            ):
                group["table"].attrs[f"{field}_kind"] = np.bytes_(value)
        done = understood(tmp_path / "x.h5")
        np.testing.assert_allclose(done.columns["t"], T, atol=1e-9)
        np.testing.assert_allclose(done.columns["tau_m"], MOTOR)
        np.testing.assert_allclose(done.columns["tau_j"], JOINT)
