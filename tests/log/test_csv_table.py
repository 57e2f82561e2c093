"""CSV files of any dialect are read into columns. Other files give a one-line error."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log import csv_table
from tsa_ctrl.log.csv_table import read_csv

PLAIN = "t,tau_m\n0,1.5\n0.001,-2.5\n"


def written(tmp_path: Path, content: str | bytes, name: str = "x.csv") -> Path:
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


SAME = [
    PLAIN,
    PLAIN.rstrip("\n"),
    PLAIN.replace("\n", "\r\n"),
    PLAIN.replace(",", ";"),
    PLAIN.replace(",", "\t"),
    PLAIN.replace(",", " , "),
    "\ufeff" + PLAIN,
    "# recorded on a bench\n#\n" + PLAIN,
    PLAIN.replace("\n", "\n\n \t\n"),
    PLAIN.replace("\n", "\r\n\r\n"),
    PLAIN + ",\n,\n",
    PLAIN.replace("t,tau_m", '"t","tau_m"').replace("1.5", '"1.5"'),
    PLAIN.replace("0.001", "1E-3").replace("-2.5", "-25e-1"),
    "t,,tau_m,\n0,,1.5,\n0.001,,-2.5,\n",  # spreadsheets export empty columns without a name
]


def test_every_way_to_write_the_same_table_reads_the_same(tmp_path: Path) -> None:
    """A reader may change the columns."""
    expected = {"t": [0.0, 0.001], "tau_m": [1.5, -2.5]}
    paths = [written(tmp_path, content, f"{n}.csv") for n, content in enumerate(SAME)]
    for path in (*paths, written(tmp_path, gzip.compress(PLAIN.encode()), "x.csv.gz")):
        columns, _, _ = read_csv(path)
        assert {name: columns[name].tolist() for name in expected} == expected, path
        columns["tau_m"] *= 2.0


NO_TABLES = [
    (b"", "is empty"),
    (b" \n\n", "is empty"),
    (b"\x00\x01\x02", "is not text"),
    (PLAIN.encode("utf-16"), "is UTF-16"),
    (PLAIN.replace("\n", "\r").encode(), "lone carriage return"),
    (b"t,\xe4\xf6\n1,2\n", "line 1 is not UTF-8"),
    (b"0,1\n2,3\n", "line 1 has numbers where the header is expected"),
    (b"t,tau_m,t\n0,1,2\n", "column t appears twice"),
    (b"t,tau_m\n0,1\n2\n", "row 2 (line 3) has 1 field(s) where the header has 2"),
    (b"t,tau_m\n0,1\n2,3,4\n", "row 2 (line 3) has 3 field(s)"),
    (b"t,tau_m\n0,1,1,5\n", "a decimal comma"),
    (b"t;tau_m\n0,5;1,5\n", "found '0,5' where a number is needed (a decimal comma"),
    (b"# x\nt,tau_m\n0,1\n1,oops\n", "column tau_m, row 2 (line 4): found 'oops'"),
    (b"t,tau_m\n0,0x10\n", "found '0x10'"),
    (b"t,tau_m\n0,1d\n", "found '1d'"),
    (b't,tau_m\n0,"1\n', "row 1 (line 2) has an unclosed quote"),
]


def test_what_is_no_table_of_numbers_is_one_line(tmp_path: Path) -> None:
    for content, said in NO_TABLES:
        path = written(tmp_path, content)
        with pytest.raises(UsageError) as error:
            read_csv(path, ("t", "tau_m"))
        assert said in str(error.value)
        assert str(path) in str(error.value)
        assert "\n" not in str(error.value)


def test_a_damaged_compressed_file_is_one_line(tmp_path: Path) -> None:
    packed = gzip.compress(PLAIN.encode() * 20)
    for content, words in ((packed[:30], "ends early"), (packed[:-4], "ends early"), (PLAIN, "is damaged")):
        with pytest.raises(UsageError, match=f"compressed file {words}"):
            read_csv(written(tmp_path, content, "x.csv.gz"))


def test_text_in_a_column_that_nobody_asked_for_is_left_out_but_is_an_error_in_a_signal(tmp_path: Path) -> None:
    """An empty field of a signal is NaN."""
    columns, left_out, _ = read_csv(written(tmp_path, 't,tau_m,note\n0,,"hello, you"\n1,2,\n'))
    assert (list(columns), left_out) == (["t", "tau_m"], ["note"])
    assert np.isnan(columns["tau_m"][0])
    with pytest.raises(UsageError, match="column tau_m, row 1"):
        read_csv(written(tmp_path, "t,tau_m\n0,high\n"))


def test_a_column_may_turn_from_numbers_to_text_late(tmp_path: Path) -> None:
    """The column is not required, so it is left out although its first 300,000 values are numbers."""
    columns, left_out, _ = read_csv(written(tmp_path, "t,note\n" + "0,1\n" * 300_000 + "1,late\n"))
    assert (list(columns), left_out, len(columns["t"])) == (["t"], ["note"], 300_001)


def test_odd_numbers_read_as_float_reads_them(tmp_path: Path) -> None:
    """Examples are halfway between two doubles, subnormal, too large, or lack digits on one side of the point."""
    for entry in ("9007199254740993", "2.2250738585072011e-308", "1e400", "+.5", "1.", "nan", "-0.0", "1_000"):
        columns, _, _ = read_csv(written(tmp_path, f"t,tau_m\n0,{entry}\n"))
        assert repr(columns["tau_m"][0].item()) == repr(float(entry))


@given(
    table=hnp.arrays(np.float64, st.tuples(st.integers(1, 40), st.integers(2, 4)), elements=st.floats(allow_nan=False)),
    text=st.sampled_from([repr, "{:.17g}".format, "{:+.16e}".format, " {} ".format]),
    delimiter=st.sampled_from([",", ";", "\t"]),
    end=st.sampled_from(["\n", "\r\n"]),
    empty=st.integers(0, 3),
)
def test_every_number_reads_back_as_float_does_with_and_without_duckdb(
    tmp_path_factory: pytest.TempPathFactory,
    table: np.ndarray,
    text: Callable[[float], str],
    delimiter: str,
    end: str,
    empty: int,
) -> None:
    """An empty field is NaN. Small files are read without DuckDB."""
    names = ["a", "b", "c", "d"][: table.shape[1]]
    table[0, 1:][empty : empty + 1] = np.nan
    rows = [["" if x != x else text(x) for x in row] for row in table.tolist()]
    path = written(tmp_path_factory.mktemp("csv"), end.join([delimiter.join(row) for row in [names, *rows]] + [""]))
    for small in (csv_table.SMALL, 0):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(csv_table, "SMALL", small)
            columns, _, _ = read_csv(path, names)
        for i, name in enumerate(names):
            np.testing.assert_array_equal(columns[name], table[:, i])
