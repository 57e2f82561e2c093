"""Conversion of logs to tables and back."""

from __future__ import annotations

import os
import resource
from pathlib import Path

import duckdb
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tests.log.logs import HEADER, records, write_log
from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.convert import convert, write_last
from tsa_ctrl.log.mcap_file import McapFile
from tsa_ctrl.log.process import LogHeader
from tsa_ctrl.log.table import read_table

ONE = LogHeader(axes=("hip",), rate=1000.0, codes=HEADER.codes, started=0.0)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "run.mcap"
    write_log(path)
    return path


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.slow
@given(
    values=hnp.arrays(np.float64, st.tuples(st.integers(2, 30), st.just(3)), elements=st.floats(allow_infinity=False)),
    ending=st.sampled_from([".csv", ".csv.gz", ".parquet"]),
)
@settings(max_examples=60)
def test_a_table_holds_the_log_to_the_last_bit(
    tmp_path_factory: pytest.TempPathFactory, values: np.ndarray, ending: str
) -> None:
    folder = tmp_path_factory.mktemp("convert")
    signals = {"tau_m": values[:, 0], "tau_j": values[:, 1], "pdo_age": values[:, 2]}
    file = McapFile(folder / "x.mcap", ONE)
    file.write([records(len(values), **signals)])
    file.finish()
    convert(folder / "x.mcap", folder / f"y{ending}")
    expected = read_table(f"{folder / 'x.mcap'}:hip").columns
    found = read_table(folder / f"y{ending}").columns
    assert list(found) == [name for name in expected if name != "state"]
    for name, column in found.items():
        np.testing.assert_array_equal(column, expected[name])


def test_several_axes_give_one_file_each_and_a_named_axis_the_very_file(log: Path, tmp_path: Path) -> None:
    shares: list[float] = []
    written = convert(log, tmp_path / "out" / "table.csv.gz", shares.append)
    assert names(tmp_path / "out") == ["table_hip.csv.gz", "table_knee.csv.gz"]
    assert [file.path.name for file in written] == names(tmp_path / "out")
    assert (shares, shares[-1]) == (sorted(shares), 1.0)
    convert(log, tmp_path / "tables")
    assert names(tmp_path / "tables") == ["run_hip.csv", "run_knee.csv"]
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    (part,) = convert(f"{cut}:knee", tmp_path / "knee.csv")
    assert "was cut off" in part.notes[0]
    found = read_table(tmp_path / "knee.csv").columns["tau_m"].tolist()
    assert found in ([1.0] * 100, [1.0] * 200)


def test_a_state_is_written_as_its_name_or_number_and_empty_columns_are_left_out(log: Path, tmp_path: Path) -> None:
    """A column without numbers is left out where a table of numbers is converted."""
    convert(f"{log}:hip", tmp_path / "x.csv")
    convert(f"{log}:hip", tmp_path / "x.parquet")
    head, first, *_ = (tmp_path / "x.csv").read_text().splitlines()
    assert (head, first) == ("t,tau_m,omega_j,cycle,state", "0.0,0.0,1.0,0,operation_enabled")
    found = duckdb.connect().execute(f"SELECT state, typeof(tau_m) FROM '{tmp_path / 'x.parquet'}' LIMIT 1").fetchone()
    assert found == ("operation_enabled", "DOUBLE")
    (written,) = convert(tmp_path / "x.csv", tmp_path / "y.parquet")
    assert written.notes == ("columns without numbers are left out: state",)
    file = McapFile(tmp_path / "unknown.mcap", ONE)
    file.write([records(2, state=5.0)])
    file.finish()
    convert(tmp_path / "unknown.mcap", tmp_path / "unknown.csv")
    assert (tmp_path / "unknown.csv").read_text().splitlines()[1] == "0.0,0,5"


def test_a_value_that_is_not_there_is_null_in_parquet(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("t,tau_m\n0,\n1,2\n")
    convert(tmp_path / "x.csv", tmp_path / "x.parquet")
    assert duckdb.connect().execute(f"SELECT tau_m FROM '{tmp_path / 'x.parquet'}'").fetchall() == [(None,), (2.0,)]


def test_a_place_that_cannot_be_used_is_one_line(log: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    places = {"x.txt": "unknown kind of file", "file/x.csv": "cannot be written", "file/x.parquet": "cannot be written"}
    for out, said in places.items():
        with pytest.raises(UsageError, match=said):
            convert(f"{log}:hip", tmp_path / out)


def test_a_log_without_records_or_onto_itself_is_not_converted(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text("t,tau_m\n0,1\n")
    with pytest.raises(UsageError, match="which is read"):
        convert(path, path)
    assert path.read_text() == "t,tau_m\n0,1\n"
    McapFile(tmp_path / "x.mcap", ONE).finish()
    with pytest.raises(UsageError, match="contains no records"):
        convert(tmp_path / "x.mcap", tmp_path / "y.csv")


def test_a_failed_conversion_leaves_what_was_there(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "x.csv"
    out.write_text("old\n")

    def refuse(*_: object, **__: object) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(UsageError, match="No space left on device"):
        convert(f"{log}:hip", out)
    assert out.read_text() == "old\n"
    assert names(tmp_path) == ["run.mcap", "x.csv"]


@pytest.mark.parametrize("missing", [1, 3000])
def test_the_last_part_of_a_log_is_whole_or_absent(log: Path, tmp_path: Path, missing: int) -> None:
    """A limit of the file size acts like a full disk, while the indices or the records are written."""
    (tmp_path / "out").mkdir()
    out = tmp_path / "out/last.mcap"
    assert write_last(log, out, 0.2) == pytest.approx(0.2)
    size = out.stat().st_size
    out.unlink()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size - missing, before[1]))
    try:
        with pytest.raises(UsageError, match=r"last\.mcap: cannot be written \(File too large\); choose another place"):
            write_last(log, out, 0.2)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert names(tmp_path / "out") == []
