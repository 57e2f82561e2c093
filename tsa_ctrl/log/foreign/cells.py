"""Read the cells of a column as numbers or times.

Each column determines its decimal sign from its own cells: "0,5" and "1.234,5" have a decimal comma, "1,234" alone may
be 1.234 or 1234. Texts between numbers are markers of an instrument, such as OVLD or #N/A, and become nan.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.log.foreign.units import is_known

EMPTY = frozenset({"", "nan", "-nan", "na", "n/a", "null", "none", "-"})
OVERRANGE = 9e36  # SCPI instruments write 9.9e37 for infinity and 9.91e37 for no number
_DAY = 86400.0  # s
DATES = "2025-01-31 14:25:01.5, 31.01.2025 14:25:01.5 or 14:25:01.5"  # for messages
_SPACES = " '’\u00a0\u2009\u202f"  # group thousands in addition to "." and ","
_EXPONENT = r"(?:[eEdD][+-]?\d+)?"
_NUMBER = re.compile(rf"[+-]?(?:\d+(?:[.,{_SPACES}]\d{{3}})*(?:[.,]\d*)?|[.,]\d+){_EXPONENT}$")
_MEASURED = re.compile(rf"({_NUMBER.pattern[:-1]}) ?([^\W\d_]\S*(?: \S+)?|[°%‰]\S*)$")
_GROUPED = {
    sign: re.compile(rf"[+-]?\d{{1,3}}([{other}{_SPACES}])\d{{3}}(?:\1\d{{3}})*(?:[{sign}]\d*)?{_EXPONENT}$")
    for sign, other in ((".", ","), (",", "."))
}
_UNCLEAR = re.compile(r"[+-]?[1-9]\d{0,2}([.,])\d{3}$")
_MARKER = re.compile(r"\D*$|#.*|[+-]?1[.,]#\w*$|[<>].*")  # also "1.#INF" of C programs, and "> 10.5"
_CLOCK = re.compile(r"(?:(\d{1,3}):)?(\d{1,2}):(\d\d(?:[.,:]\d+)?)(?: ?([AP])M)?$", re.I)  # or minutes and seconds
_DAYS = re.compile(r"(\d+) days?,? (\d+:.*)$")  # a duration, as pandas and Python write it
_SLASHES = re.compile(r"(\d{1,2})/(\d{1,2})/(\d{4}),? +(\d.*)$")
_GERMAN = re.compile(r"(\d{1,2})\.(\d{1,2})\.(\d{4}),? +(\d{1,2}:\d\d(?::\d.*)?)$")
_NAMED = re.compile(r"(\d{1,2})[- ]([A-Za-z]{3})[a-z]*\.?[- ](\d{4}),? +(\d{1,2}:\d\d(?::\d.*)?)$")  # of MATLAB
_MONTHS = ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"]
_ISO = re.compile(r"\d{4}([-/])\d\d\1\d\d[T ]\d\d:\d\d")


@dataclass(frozen=True)
class Values:
    """The values of a column.

    Attributes:
        values: numbers, or times in s, (n,), with nan for empty cells and markers.
        markers: number of cells for each text that is not a number.
        wrong: index of the first cell that cannot be read; None without such a cell.
        reason: description of the fault of that cell.
    """

    values: NDArray[np.float64]
    markers: Counter[str] = field(default_factory=Counter)
    wrong: int | None = None
    reason: str = ""


def bare(cell: str) -> str:
    """Return a cell without white space and quotes around its content, and without the sign of a formula ="0.5"."""
    text = cell.strip()
    return (text[1:] if text.startswith('="') else text).strip('"').strip()


def is_date(cell: str) -> bool:
    """Return True if a cell is a date with a time, or a time of day."""
    text = bare(cell)
    if found := _DAYS.match(text):
        text = found[2]
    clock = _CLOCK.match(text)
    slashes = _SLASHES.match(text)
    known = _ISO.match(text) or _GERMAN.match(text) or _NAMED.match(text) or (slashes and _CLOCK.match(slashes[4]))
    return bool(known or (clock and (clock[1] or not clock[3].isdigit())))


def measured(cell: str) -> tuple[str, str]:
    """Return the number of a cell and its unit, such as "3,2" and "Nm", or the whole content and ""."""
    text = bare(cell)
    found = None if _NUMBER.match(text) else _MEASURED.match(text)
    return (found[1], found[2]) if found and is_known(found[2]) else (text, "")


def is_number(cell: str) -> bool:
    """Return True if a cell is a number, with or without a unit, a date or a time of day."""
    return bool(_NUMBER.match(measured(cell)[0])) or is_date(cell)


def is_text(cell: str) -> bool:
    """Return True if a cell has a content that is neither a number nor a sign of a missing value."""
    return not is_number(cell) and bare(cell).lower() not in EMPTY


def decimal_of(cells: Iterable[str]) -> str:
    """Return the decimal sign of the first cell that determines it, or "" if none does.

    A group of thousands has three digits and does not follow a zero.
    """
    for cell in cells:
        text, _ = measured(cell)
        signs = [sign for sign in text if sign in ".,"]
        if not signs or not _NUMBER.match(text) or _UNCLEAR.match(text):
            continue
        if len(set(signs)) == 2:
            return signs[-1]
        if len(signs) == 1:
            return signs[0]
        return "," if signs[0] == "." else "."  # several equal signs group thousands
    return ""


def numbers(cells: Sequence[str], decimal: str, stated: bool) -> Values:
    """Return the cells as doubles.

    Args:
        cells: cells of one column.
        decimal: decimal sign of the other columns, or "" if they do not determine it.
        stated: True if the user has stated `decimal`.
    """
    texts = [bare(cell) for cell in cells]
    sign = decimal_of(texts)
    if not sign:
        unclear = {found[1]: row for row, text in reversed(list(enumerate(texts))) if (found := _UNCLEAR.match(text))}
        if unclear and not stated and not _is_settled(set(unclear), decimal, texts):
            row = min(unclear.values())
            both = texts[row].replace(",", "."), re.sub("[.,]", "", texts[row])
            return Values(np.empty(0), wrong=row, reason=f"'{texts[row]}' may be {both[0]} or {both[1]}")
        sign = decimal or next(iter(unclear), ".")

    def number(text: str) -> float:
        if _GROUPED[sign].match(text):
            text = re.sub(rf"[{'.' if sign == ',' else ','}{_SPACES}]", "", text)
        elif not _NUMBER.match(text) or ("." if sign == "," else ",") in text:
            raise ValueError(text)
        return float(text.replace(",", ".").replace("D", "e").replace("d", "e"))

    return _read(texts, number, f"is not a number with the decimal sign '{sign}'")


def _is_settled(signs: set[str], decimal: str, texts: Sequence[str]) -> bool:
    """Return True if cells such as "1,234" have only one reading next to the other cells of column and file."""
    whole = [text.lstrip("+-") for text in texts if text.lstrip("+-").isdigit()]
    if signs == {decimal}:
        return True
    if not decimal:
        return signs == {"."} and not whole  # all cells have three decimals
    return len(signs) == 1 and bool(whole) and all(len(text) <= 3 for text in whole)  # larger numbers are grouped


def overrange(values: NDArray[np.float64]) -> Values:
    """Return numbers of a binary file, with nan for infinity and for values that no measured quantity has."""
    beyond = np.abs(values) > OVERRANGE
    found = Counter(f"{value:g}" for value in values[beyond].tolist())
    return Values(np.where(beyond, np.nan, values) if found else values, found)


def times(cells: Sequence[str]) -> Values:
    """Return dates and times in s since 1970, or times of day in s since midnight of the first day."""
    texts = [bare(cell) for cell in cells]
    slashes = {row: found for row, text in enumerate(texts) if (found := _SLASHES.match(text))}
    days = {found.groups()[:3]: row for row, found in reversed(slashes.items())}
    if slashes:
        first, second = (max(int(found[i]) for found in slashes.values()) for i in (1, 2))
        if len(days) > 1 and max(first, second) <= 12:
            row = max(days.values())
            return Values(np.empty(0), wrong=row, reason=f"'{texts[row]}' may have the month or the day first")
        day, month = (1, 2) if first > 12 else (2, 1)
        for row, found in slashes.items():
            texts[row] = f"{found[day]}.{found[month]}.{found[3]} {found[4]}"
    read = _read(texts, _stamp, f"is not a date and time like {DATES}")
    if read.wrong is None:
        good = np.flatnonzero(np.isfinite(read.values))
        clocks = [_CLOCK.match(texts[i]) for i in good[[0, -1]]] if good.size else [None]
        if all(clocks):
            turn = _DAY if clocks[0] and clocks[0][1] else 3600.0  # midnight, or the full hour without hours
            read.values[good[1:]] += turn * np.cumsum(np.diff(read.values[good]) < -turn / 2)
    return read


def _read(texts: Sequence[str], convert: Callable[[str], float], fault: str) -> Values:
    """Convert texts. Markers are accepted if most texts are numbers."""
    out = np.full(len(texts), math.nan)
    markers: Counter[str] = Counter()
    first = count = 0
    for row, text in enumerate(texts):
        if text.lower() in EMPTY:
            continue
        try:
            value = convert(text.replace("−", "-"))
        except ValueError:
            if not _MARKER.match(text):
                return Values(out, wrong=row, reason=f"'{text}' {fault}")
            value = math.inf
        if abs(value) > OVERRANGE:
            first = first if markers else row
            markers[text] += 1
        else:
            out[row] = value
            count += 1
    if markers.total() >= max(count, 1):
        return Values(out, wrong=first, reason=f"'{texts[first]}' {fault}")
    return Values(out, markers)


def _stamp(text: str) -> float:
    """Return a date and time as seconds since 1970, or a time of day in seconds; raises ValueError."""
    if found := _DAYS.match(text):
        return int(found[1]) * _DAY + _stamp(found[2])
    if found := _CLOCK.match(text):
        hour, minute, second = int(found[1] or 0), int(found[2]), float(re.sub("[,:]", ".", found[3]))
        hour = hour % 12 + 12 * (found[4] in "pP") if found[4] else hour
        if minute > 59 or second >= 61.0:
            raise ValueError(text)
        return 3600.0 * hour + 60.0 * minute + second
    if (found := _NAMED.match(text)) and found[2].lower() in _MONTHS:
        text = f"{found[1]}.{_MONTHS.index(found[2].lower()) + 1}.{found[3]} {found[4]}"
    if found := _GERMAN.match(text):
        day, month, year = (int(part) for part in found.groups()[:3])
        clock = found[4] if found[4].count(":") == 2 else f"{found[4]}:00"
        return datetime(year, month, day, tzinfo=UTC).timestamp() + _stamp(clock)
    date = datetime.fromisoformat(text.replace("/", "-").replace(",", "."))
    return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()
