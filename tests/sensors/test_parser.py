"""The line parser returns values of complete lines only."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tsa_ctrl.errors import UsageError
from tsa_ctrl.sensors.process import SerialSensorSettings, check
from tsa_ctrl.sensors.reader import MOST_LINE, LineParser


def settings(**changes: object) -> SerialSensorSettings:
    return SerialSensorSettings(**{"port": "/dev/null", "quantity": "tau_j", **changes})  # type: ignore[arg-type]


def parser(**changes: object) -> LineParser:
    return LineParser(settings(**changes))


def test_a_cut_throws_the_half_line_away() -> None:
    p = parser()
    p.feed(b"\n1.2")
    p.reset()
    assert p.feed(b"5\n7\n") == [7.0]


def test_scale_and_offset_make_si_units() -> None:
    assert parser(scale=9.80665, offset=-1.0).feed(b"\n2\n") == [pytest.approx(18.6133)]


def test_a_unit_is_compared() -> None:
    p = parser(pattern=r"(?P<value>[-\d.]+)\s*(?P<unit>\w+)", unit="kg")
    assert p.feed(b"\n+12 lb\n-3.5 kg\n") == [-3.5]
    assert p.rejected == 1


@pytest.mark.parametrize("line", [b"nan", b"inf", b"-1e999", b"1.2.3", b"12 34", b"\xff\xfe", b"2e4"])
def test_what_cannot_be_is_rejected_and_counted(line: bytes) -> None:
    p = parser()
    assert p.feed(b"\n" + line + b"\n") == []
    assert p.rejected == 1


def test_a_line_without_an_end_does_not_grow_for_ever() -> None:
    p = parser()
    for _ in range(100):
        assert p.feed(b"1" * MOST_LINE) == []
    assert p.feed(b"\n2\n") == [2.0]


@given(st.lists(st.binary(max_size=40), max_size=30))
def test_any_bytes_give_only_finite_values_within_bounds(chunks: list[bytes]) -> None:
    p = parser(low=-5.0, high=5.0)
    for chunk in chunks:
        assert all(math.isfinite(v) and -5.0 <= v <= 5.0 for v in p.feed(chunk))


@given(st.lists(st.floats(-100.0, 100.0), min_size=1, max_size=20), st.data())
def test_values_do_not_depend_on_how_the_bytes_arrive(values: list[float], data: st.DataObject) -> None:
    """The first line after a connection may be incomplete and is not used."""
    text = b"99\n" + b"".join(f"{v!r}\r\n".encode() for v in values)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(text)), max_size=5)))
    p = parser()
    got = [v for a, b in zip([0, *cuts], [*cuts, len(text)], strict=True) for v in p.feed(text[a:b])]
    assert got == values


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"port": "relay://1"}, 'port "relay://1": .*not known; give a device'),
        ({"pattern": "("}, "not a regular expression"),
        ({"pattern": r"\d+"}, "no group 'value'"),
        ({"unit": "kg"}, "no group 'unit'"),
        ({"scale": 0.0}, "scale is 0"),
        ({"low": 1.0, "high": 0.0}, "not below high"),
        ({"rate": 5.0, "timeout": 0.1}, "shorter than the time between"),
    ],
)
def test_contradictions_are_one_clear_line(changes: dict[str, object], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        check(settings(**changes), "controller.toml: axis 'knee'")
