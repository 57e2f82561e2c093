"""Parquet files of another program and unreadable ones. pyarrow 26 wrote the two files next to this file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.table import read_table

HERE = Path(__file__).parent


def test_numbers_of_every_width_are_read_nulls_as_nan_and_the_rest_is_left_out() -> None:
    table = read_table(HERE / "of_pyarrow.parquet")
    assert table.columns["t"].tolist() == [0.0, 0.001, 0.002]
    np.testing.assert_array_equal(table.columns["cycle"], [1.0, 2.0, np.nan])
    np.testing.assert_array_equal(table.columns["tau_m"], [1.5, np.nan, 2.5])
    assert table.left_out == ("note", "pair", "on")
    assert all(column.dtype == np.float64 and column.flags.writeable for column in table.columns.values())


def test_wanted_columns_alone_are_read() -> None:
    assert list(read_table(HERE / "of_pyarrow.parquet", ("t", "tau_m", "omega_j")).columns) == ["t", "tau_m"]


def test_a_name_with_the_letters_of_a_pattern_is_a_name(tmp_path: Path) -> None:
    odd = tmp_path / "run *[1]' ?.parquet"
    odd.write_bytes((HERE / "of_pyarrow.parquet").read_bytes())
    assert len(read_table(odd)) == 3
    csv = tmp_path / "run *[1]' ?.csv"
    csv.write_text("t,tau_m\n0,1\n1,2\n")
    assert len(read_table(csv)) == 2


@pytest.mark.parametrize(
    ("name", "wanted", "said"),
    [
        ("twice.parquet", None, "column t appears twice; rename or remove one"),
        ("of_pyarrow.parquet", ("t", "note"), "column note is VARCHAR, not a number; convert it"),
    ],
)
def test_what_is_no_table_of_numbers_is_one_line(name: str, wanted: tuple[str, ...] | None, said: str) -> None:
    with pytest.raises(UsageError) as error:
        read_table(HERE / name, wanted)
    assert str(error.value) == f"{HERE / name}: {said}"


def test_a_cut_file_is_one_line(tmp_path: Path) -> None:
    cut = tmp_path / "cut.parquet"
    for kept in (0, 3, 700, 2200):
        cut.write_bytes((HERE / "of_pyarrow.parquet").read_bytes()[:kept])
        with pytest.raises(UsageError) as error:
            read_table(cut)
        assert str(error.value).startswith(f"{cut}: is not a readable Parquet file (")
        assert "\n" not in str(error.value)
        assert "/dev/fd" not in str(error.value)
