"""Tables of other programs.

Their format is detected automatically. A one-line error requests the information that a table lacks.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from tests.log.logs import import_log, understood
from tsa_ctrl.cli import log_import
from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.foreign import mapping
from tsa_ctrl.log.foreign.text import read_foreign
from tsa_ctrl.log.table import read_table
from tsa_ctrl.model.parameters import load_model
from tsa_ctrl.settings import load

GERMAN = (
    "Messung;Prüfstand 3\nDatum;31.01.2025\n\n"
    "Zeit [ms];Winkel Motor [°];Drehzahl Motor [U/min];Strom Motor [A];Temperatur [°C];Kommentar\n"
    + "".join(f"{5 * i};{1.5 * i:.2f};60,0;{0.25 * (i % 3):.3f};25,0;ok\n".replace(".", ",") for i in range(20))
)


def test_a_german_table_becomes_a_log_in_si(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The written mapping gives the same log again. The JSON object lists the imported and the omitted columns."""
    (tmp_path / "mess.txt").write_text(GERMAN, encoding="cp1252")
    given = ("--column", "tau_m=Strom Motor [A]|A*0.12", "--out", str(tmp_path / "out"), "--json")
    assert import_log(str(tmp_path / "mess.txt"), *given) == 0
    columns = read_table(tmp_path / "out/mess.csv").columns
    np.testing.assert_allclose(columns["t"], np.arange(20) * 0.005, atol=1e-12)
    np.testing.assert_allclose(columns["q_m"], np.radians(1.5 * np.arange(20)), atol=1e-12)
    np.testing.assert_allclose(columns["omega_m"], 2.0 * math.pi)
    np.testing.assert_allclose(columns["tau_m"], 0.12 * 0.25 * (np.arange(20) % 3), atol=1e-12)
    said = json.loads(capsys.readouterr().out)
    assert (said["schema"], said["rows"], said["not_taken"]) == (1, 20, ["Kommentar"])
    assert said["columns"]["tau_m"] == {"from": "Strom Motor [A]", "unit": "A", "scale": 0.12, "offset": 0.0}
    again = ("--map", str(tmp_path / "out/mess-map.toml"), "--out", str(tmp_path / "again"))
    assert import_log(str(tmp_path / "mess.txt"), *again) == 0
    assert (tmp_path / "out/mess.csv").read_bytes() == (tmp_path / "again/mess.csv").read_bytes()


def test_a_unit_of_the_device_wants_a_scale_and_says_which(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mess.txt").write_text(GERMAN, encoding="cp1252")
    assert import_log(str(tmp_path / "mess.txt"), "--out", str(tmp_path / "out")) == 2
    said = capsys.readouterr().err
    assert "give scale (N*m per A)" in said
    assert said.count("\n") == 1
    assert not (tmp_path / "out").exists()


WRONG = [
    ("tau_n=b", "did you mean 'tau_m'"),
    ("tau_m=B", "its columns are 't', 'b'"),
    ("tau_m=b|furlong", "unknown unit 'furlong'; allowed are N*m"),
    ("tau_m=b|F*2", "unit 'F' belongs to another quantity; allowed are N*m, Nm"),
    ("tau_m=b|date*2", "unit 'date' belongs to another quantity; allowed are N*m, Nm"),
    ("temperature=b|rpm*2", "unit 'rpm' belongs to another quantity; allowed are degC"),
    ("tau_m=b|A*0", "a scale other than 0"),
    ("tau_m", "write NAME=HEADER"),
]


def test_a_wrong_mapping_is_one_line_with_what_is_allowed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "x.csv").write_text("t,b\n0,1\n1,2\n")
    for column, said in WRONG:
        assert import_log(str(tmp_path / "x.csv"), "--column", column, "--out", str(tmp_path / "out")) == 2
        err = capsys.readouterr().err
        assert said in err
        assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("kind", "keys"), [("tendon_sheath", 8), ("geared_drive", 1)], ids=["tendon-sheath", "geared drive"]
)
def test_the_model_of_an_import_has_no_value_that_only_the_user_knows(kind: str, keys: int, tmp_path: Path) -> None:
    """A report with the example's radii and friction would look like one of this drive."""
    (tmp_path / "x.csv").write_text("t,tau_m,tau_j\n0,1,1\n1,2,2\n")
    assert import_log(str(tmp_path / "x.csv"), "--kind", kind, "--out", str(tmp_path / "o"), "--yes") == 0
    with pytest.raises(UsageError, match=f"{keys} values? (is|are) empty.*model.toml: actuator"):
        load_model(tmp_path / "o" / "model.toml")


@pytest.mark.parametrize(
    ("column", "values"),
    [
        ("temperature=b|degF", [-155 / 9, -50 / 3]),
        ("temperature=b|V*20", [20.0, 40.0]),
        ("tau_j=b|N*0.05", [0.05, 0.1]),  # a load cell on a lever arm of 50 mm
    ],
)
def test_a_unit_of_the_quantity_a_device_or_a_lever_arm_is_converted(
    column: str, values: list[float], tmp_path: Path
) -> None:
    (tmp_path / "x.csv").write_text("t,b\n0,1\n1,2\n")
    name, settings = mapping.parse_column(column)
    (found,) = mapping.resolve(read_foreign(tmp_path / "x.csv"), {name: settings}, "x")
    np.testing.assert_allclose(found.values(read_foreign(tmp_path / "x.csv")), values)


def test_what_is_no_table_is_refused_in_words(tmp_path: Path) -> None:
    for data, said in (
        (b"", "is empty"),
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "is not text"),
        (b"just words\nand more words\n", "no row of numbers|only one column"),
        (b"# by hand\nt,tau_m\n0,1\n1,zwei\n", "column 'tau_m', line 4: 'zwei'"),
    ):
        (tmp_path / "x.csv").write_bytes(data)
        with pytest.raises(UsageError, match=said):
            read_foreign(tmp_path / "x.csv").numbers("tau_m")


@pytest.mark.parametrize(("line", "rows"), [(1, 30_000), (2, 30_000), (3, 30_000), (3, 10), (300, 30_000)])
def test_an_open_quote_is_named_by_its_line(line: int, rows: int, tmp_path: Path) -> None:
    """Any number of rows after the quote would be part of one field."""
    lines = ["t;tau_m", *(f"{i};{i}" for i in range(rows + line))]
    lines[line - 1] = '"' + lines[line - 1]
    (tmp_path / "x.csv").write_text("\n".join(lines))
    with pytest.raises(UsageError, match=f"line {line}: a quote .* is not closed"):
        read_foreign(tmp_path / "x.csv")


def test_a_quoted_field_may_have_a_line_break(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text('t;"motor torque\n[Nm]"\n0;1\n1;2\n')
    np.testing.assert_array_equal(read_foreign(tmp_path / "x.csv").numbers("motor torque[Nm]"), [1.0, 2.0])


def test_a_separator_is_one_character_other_than_a_quote(tmp_path: Path) -> None:
    for separator in ("ab", '\\"', "\\n"):
        (tmp_path / "map.toml").write_text(f'[table]\nseparator = "{separator}"\n')
        with pytest.raises(UsageError, match="one character"):
            load(tmp_path / "map.toml", mapping.MapFile)


N = 40
TIME, TORQUE = np.arange(N) * 0.01, 1.5 * np.sin(0.2 * np.arange(N))
PAIRS = list(zip(TIME.tolist(), TORQUE.tolist(), strict=True))


def imported(path: Path, text: str, encoding: str = "utf-8") -> log_import.Understood:
    path.write_bytes(text.encode(encoding))
    return understood(path)


def comma(value: float, digits: int = 6) -> str:
    return f"{value:.{digits}f}".replace(".", ",")


def grouped(value: float, group: str, decimal: str) -> str:
    return f"{value:,.3f}".translate(str.maketrans(",.", group + decimal))


MARKERS = ["OVLD", "OVR", "---", "#N/A", "Inf", "-INF", "#DIV/0!", "1.#INF", "9,9E+37", "-9,90000E37", "> 10,5", "∞"]


@pytest.mark.parametrize("marker", MARKERS)
def test_a_marker_instead_of_a_number_is_a_hole_and_is_reported_once(
    marker: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    values = [marker if i in (0, 5, 6) else comma(x) for i, x in enumerate(TORQUE)]
    rows = "".join(f"{comma(t)};{x}\n" for t, x in zip(TIME, values, strict=True))
    done = imported(tmp_path / "x.csv", "t;Motormoment [Nm]\n" + rows)
    np.testing.assert_allclose(done.columns["tau_m"], np.delete(TORQUE, [0, 5, 6]), atol=1e-6)
    assert done.markers == {"Motormoment [Nm]": {marker: 3}}
    assert import_log(str(tmp_path / "x.csv"), "--out", str(tmp_path / "out")) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert said.count(f"column 'Motormoment [Nm]' has 3 cells without a number ('{marker}')") == 1


def test_first_rows_of_markers_are_no_names(tmp_path: Path) -> None:
    rows = "".join(f"{t};{'OVLD;OVLD' if i < 4 else f'{x};{x}'}\n" for i, (t, x) in enumerate(PAIRS))
    np.testing.assert_array_equal(imported(tmp_path / "x.csv", "t;tau_m;tau_j\n" + rows).columns["tau_m"], TORQUE[4:])


def test_a_column_of_words_and_a_damaged_number_are_rejected_with_their_line(tmp_path: Path) -> None:
    for cell, rows in (("low", range(1, 30)), ("1.2.3", (7,)), ("12 Nm", (7,)), ("1_000", (7,)), ("0,5", (7,))):
        text = "".join(f"{t:.3f};{cell if i in rows else x}\n" for i, (t, x) in enumerate(PAIRS))
        with pytest.raises(UsageError, match=f"column 'tau_m', line {rows[0] + 2}: '{cell}' is not a number"):
            imported(tmp_path / "x.csv", "t;tau_m\n" + text)


@pytest.mark.parametrize(("separator", "quote"), [(",", '"'), (";", '"'), (";", ""), ("\t", "")])
@pytest.mark.parametrize(
    ("group", "decimal"), [("", ","), (".", ","), ("'", "."), ("’", "."), ("\u202f", ","), ("\xa0", ","), (",", ".")]
)
def test_decimal_commas_and_grouped_thousands(
    separator: str, quote: str, group: str, decimal: str, tmp_path: Path
) -> None:
    values = 1e3 * (TORQUE + 1.0)
    cells = [grouped(value, group or "_", decimal).replace("_", "") for value in values]
    if group == "," and not quote:
        return
    rows = "".join(f"{t:.3f}{separator}{quote}{cell}{quote}\n" for t, cell in zip(TIME, cells, strict=True))
    done = imported(tmp_path / "x.csv", f"t{separator}Motormoment [mNm]\n{rows}")
    np.testing.assert_allclose(done.columns["tau_m"], TORQUE + 1.0, atol=1e-6)


@pytest.mark.parametrize("separator", [";", "\t", "|", " "])
def test_a_decimal_comma_is_no_separator(separator: str, tmp_path: Path) -> None:
    """It also divides each line into an equal number of fields."""
    rows = "".join(separator.join((comma(t), comma(x), "7", comma(-x, 3))) + "\n" for t, x in PAIRS)
    names = separator.join(("t [s]", "M_Motor [Nm]", "x", "M_Gelenk [Nm]"))
    done = imported(tmp_path / "x.csv", f"Rate{separator}1000\n{names}\n{rows}")
    np.testing.assert_allclose(done.columns["tau_m"], TORQUE, atol=1e-6)
    np.testing.assert_allclose(done.columns["tau_j"], -TORQUE, atol=1e-3)


def test_quoted_decimal_commas_may_end_with_a_separator(tmp_path: Path) -> None:
    rows = "".join(f'"{comma(t)}","{comma(x)}",\n' for t, x in PAIRS)
    done = imported(tmp_path / "x.csv", f'"t","tau_m"\n{rows}')
    np.testing.assert_allclose(done.columns["tau_m"], TORQUE, atol=1e-6)


def test_three_digits_after_a_comma_are_read_by_the_other_cells(tmp_path: Path) -> None:
    """Next to "0,5" they are decimals, next to 999 in a table with points they are thousands, or else not clear."""
    near = imported(tmp_path / "x.csv", '"t","tau_m"\n"0","0,5"\n"1","1,234"\n')
    np.testing.assert_array_equal(near.columns["tau_m"], [0.5, 1.234])
    thousands = imported(tmp_path / "x.csv", '"t [ms]","tau_m"\n"999","0.5"\n"1,000","0.5"\n')
    np.testing.assert_allclose(thousands.columns["t"], [0.0, 1e-3])
    unclear = '"t","tau_m"\n"0","999"\n"1","1,234"\n'
    with pytest.raises(UsageError, match=r"line 3: '1,234' may be 1.234 or 1234; .* give \[table\] decimal"):
        imported(tmp_path / "x.csv", unclear)
    (tmp_path / "map.toml").write_text('[table]\ndecimal = "."\n')
    (done,), _ = log_import.understand_all([tmp_path / "x.csv"], tmp_path / "map.toml", (), False)
    np.testing.assert_array_equal(done.columns["tau_m"], [999.0, 1234.0])


def test_commas_as_separator_and_as_decimal_sign_are_rejected(tmp_path: Path) -> None:
    rows = "".join(f"{comma(t)},{comma(x)}\n" for t, x in PAIRS)
    with pytest.raises(UsageError, match="line 2 has 4 fields below 2 names: the comma separates the fields and the"):
        imported(tmp_path / "x.csv", "t,tau_m\n" + rows)


ROWS = "".join(f"{t:.6f};{1e3 * x:.6f};25.0\n" for t, x in PAIRS)
HEADS = {
    "units with 1": "time;motor torque;temperature\ns;mNm;1\n",
    "units after a slash": "t / s;Motormoment / mNm;T / °C\n",
    "units after in": "t in s;Motormoment in mNm;x\n",
    "three lines": "CH1;CH2;CH3\nZeit;Motormoment;Temperatur\ns;mNm;°C\n",
    "groups": "Antrieb;;\nZeit [s];Moment [mNm];Temperatur [°C]\n",
    "metadata of equal width": "% rate;100;Hz\n% file;a;b\nt;motor torque [mNm];x\n",
    "comment sign": "# t;motor torque [mNm];x\n",
    "separator line": "sep=;\nt;motor torque [mNm];x\n",
    "numbers of the columns": "1;2;3\nt;motor torque [mNm];x\n",
    "names with commas": '"t, s";"Motor torque, mN.m";x\n',
    "unnamed index": "t;motor torque [mNm];\n",
    "units above the names": "s;mNm;°C\ntime;motor torque;temperature\n",
    "a slash after a space": "time/s;Motor torque/mNm;x\n",
}


@pytest.mark.parametrize("head", HEADS.values(), ids=HEADS)
@pytest.mark.parametrize("end", ["", ";"])
def test_lines_of_names_titles_and_units(head: str, end: str, tmp_path: Path) -> None:
    """Each row may end with a separator, with or without one in the lines of names."""
    rows = ROWS.replace("\n", end + "\n") + "# end of file\n"
    columns = imported(tmp_path / "x.csv", head + rows).columns
    np.testing.assert_allclose(columns["t"], TIME, atol=1e-6)
    np.testing.assert_allclose(columns["tau_m"], TORQUE, atol=1e-6)


def test_a_title_does_not_change_a_name_that_identifies_a_column(tmp_path: Path) -> None:
    head = ";Antrieb;;\nZeit [s];Moment [Nm];Winkel [rad];Gelenkmoment [Nm]\n"
    done = imported(tmp_path / "x.csv", head + "".join(f"{t};{x};0.5;{-x}\n" for t, x in PAIRS))
    assert done.table.names == ("Zeit [s]", "Antrieb Moment [Nm]", "Antrieb Winkel [rad]", "Gelenkmoment [Nm]")
    np.testing.assert_array_equal(done.columns["tau_j"], -TORQUE)


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        ("# t tau_m\n" + "".join(f"{t:.9e} {x:.9e}\n" for t, x in PAIRS), "utf-8"),
        (" Time [s]   Motor Torque [Nm]\n" + "".join(f"{t:9.4f} {x:16.9f}\n" for t, x in PAIRS), "utf-8"),
        ("t tau_m\n" + "".join(f"{t:.9E} {x:.9E}\n".replace("E", "D") for t, x in PAIRS), "utf-8"),
        ("t\ttau_m\n" + "".join(f"{comma(t, 9)}\t{comma(x, 9)}\n" for t, x in PAIRS), "utf-16"),
        ("t;tau_m\r" + "".join(f"{t:.9f};{x:.9f}\r" for t, x in PAIRS), "utf-16-le"),
        ("t;tau_m\r\n" + "".join(f"{comma(t)};{comma(x, 9)}\r\n" for t, x in PAIRS), "utf-16-be"),
        ("t,tau_m\n" + "".join(f'="{t:.9f}",="{x:.9f}"\n' for t, x in PAIRS), "utf-8"),
        ("| t | tau_m |\n|---|--:|\n" + "".join(f"| {t:.9f} | {x:.9f} |\n" for t, x in PAIRS), "utf-8"),
        (
            "\n".join(",".join([name, *(f"{v:.9f}" for v in s)]) for name, s in (("t", TIME), ("tau_m", TORQUE))),
            "utf-8",
        ),
        ("Zeit [µs];Moment Antrieb [N·m]\n" + "".join(f"{1e6 * t};{x}\n" for t, x in PAIRS), "cp1252"),
    ],
)
def test_white_space_exponents_and_encodings(text: str, encoding: str, tmp_path: Path) -> None:
    columns = imported(tmp_path / "x.txt", text, encoding).columns
    np.testing.assert_allclose(columns["t"], TIME, atol=1e-8)
    np.testing.assert_allclose(columns["tau_m"], TORQUE, atol=1e-8)


@pytest.mark.parametrize("stamp", ["12:00:0{0:.0f}", "{0:.0f}", "{0:.1f}"])
def test_a_time_of_coarse_resolution_is_rejected(stamp: str, tmp_path: Path) -> None:
    rows = "".join(f"{stamp.format(0.01 * i)};{x}\n" for i, x in enumerate(TORQUE))
    with pytest.raises(UsageError, match=r"of 40 rows have the time of the row above.*--rate HZ"):
        imported(tmp_path / "x.csv", "t;tau_m\n" + rows)


@pytest.mark.parametrize("name", ["tau_m", "Motormoment [Nm]"])
def test_a_repeated_name_is_a_question(name: str, tmp_path: Path) -> None:
    rows = "".join(f"{t};{x};{-x}\n" for t, x in PAIRS)
    with pytest.raises(UsageError) as error:
        imported(tmp_path / "x.csv", f"t;{name};{name}\n{rows}")
    assert f"tau_m may be '{name}', '{name} (2)'" in str(error.value)


def test_a_time_that_decreases_is_rejected_with_its_line(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"column t, line 4: the time decreases from 1 s to 0\.5 s"):
        imported(tmp_path / "x.csv", "t;tau_m\n0;1\n1;2\n0.5;3\n")


def test_a_sparse_column_is_omitted_instead_of_the_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = "".join(f"{t};{x};{25 if i % 10 == 0 else ''}\n" for i, (t, x) in enumerate(PAIRS))
    (tmp_path / "x.csv").write_text("t;tau_m;temperature\n" + rows)
    assert import_log(str(tmp_path / "x.csv"), "--out", str(tmp_path / "out")) == 0
    assert "column 'temperature' has a number in 10% of the rows and is omitted" in capsys.readouterr().out
    np.testing.assert_array_equal(read_table(tmp_path / "out/x.csv").columns["tau_m"], TORQUE)


def test_a_text_column_named_like_a_column_of_the_daemon_is_left_out(tmp_path: Path) -> None:
    assert imported(tmp_path / "x.csv", "t;tau_m;state\n0;1;RUN\n1;2;RUN\n").left == ["state"]


@pytest.mark.parametrize("separator", [";", "\t", ","])
@pytest.mark.parametrize("space", [" ", ""])
@pytest.mark.parametrize("sign", [".", ","])
def test_units_inside_the_cells_are_used(separator: str, space: str, sign: str, tmp_path: Path) -> None:
    quote = '"' if separator == "," else ""
    rows = [(f"{1e3 * t:.3f}{space}ms", f"{1e3 * x:.6f}{space}mNm", f"{x:.6f}{space}Nm") for t, x in PAIRS]
    text = "".join(separator.join(f"{quote}{cell}{quote}" for cell in row).replace(".", sign) + "\n" for row in rows)
    done = imported(tmp_path / "x.csv", separator.join(("time", "motor torque", "tau_j")) + "\n" + text)
    np.testing.assert_allclose(done.columns["t"], TIME, atol=1e-9)
    np.testing.assert_allclose(done.columns["tau_m"], TORQUE, atol=1e-6)
    np.testing.assert_allclose(done.columns["tau_j"], TORQUE, atol=1e-6)
    assert {column.name: column.unit for column in done.mapped} == {"t": "ms", "tau_m": "mNm", "tau_j": "Nm"}


def test_a_unit_that_changes_inside_a_column_is_rejected_with_the_line(tmp_path: Path) -> None:
    rows = "".join(f"{t:.3f};{x:.4f} {'mNm' if i == 7 else 'Nm'}\n" for i, (t, x) in enumerate(PAIRS))
    with pytest.raises(UsageError, match=r"column 'tau_m', line 9: '1\.4782 mNm' is not a number in the unit of all"):
        imported(tmp_path / "x.csv", "t;tau_m\n" + rows)


def test_rows_of_a_timetable_with_numbers_texts_and_flags(tmp_path: Path) -> None:
    """MATLAB's writetimetable writes durations with a unit, and dates with the name of the month."""
    rows = "".join(
        f"{t:.3f} sec,{'NaN' if i == 5 else x},hold,{'true' if i % 2 else 'false'},01-Mar-2025 12:00:00\n"
        for i, (t, x) in enumerate(PAIRS)
    )
    done = imported(tmp_path / "x.csv", "Time,tau_m,Mode,Enabled,Started\n" + rows)
    np.testing.assert_allclose(done.columns["t"], np.delete(TIME, 5), atol=1e-9)
    np.testing.assert_allclose(done.columns["tau_m"], np.delete(TORQUE, 5), atol=1e-9)
    assert done.left == ["Mode", "Enabled", "Started"]
    dated = "".join(f"{1 + i // 20:02d}-Mar-2025 12:00:{i % 20:02d}.5,{x}\n" for i, (_, x) in enumerate(PAIRS[:20]))
    assert imported(tmp_path / "x.csv", "Time,tau_m\n" + dated).columns["t"][-1] == pytest.approx(19.0)
