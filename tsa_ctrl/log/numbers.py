"""Decimal text to doubles, a block of CSV lines at a time, rounded exactly as `float()` rounds.

A decimal m 10^k is exact in one operation when m < 2^53 and abs(k) <= 22 (Clinger, "How to read floating point
numbers accurately", 1990). Longer ones go through double-double arithmetic (Dekker, 1971), whose error is under 2^-98
of the value; the rare case that this leaves open, and all that is no plain number, is handed back for `float()`.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
from numba import njit
from numpy.typing import NDArray

MAX_EXPONENT = 240  # of ten; beyond it Dekker's products may overflow or lose bits, and `float()` takes over

OK, BLANK_LINE, FIELD_COUNT = 0, 1, 2  # outcomes of `parse`


def _powers_of_ten() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """10^k for k = -MAX_EXPONENT..MAX_EXPONENT as unevaluated sums of two doubles."""
    exact = [Fraction(10) ** k for k in range(-MAX_EXPONENT, MAX_EXPONENT + 1)]
    high = np.array([float(value) for value in exact])
    low = np.array([float(value - Fraction(h)) for value, h in zip(exact, high.tolist(), strict=True)])
    return high, low


TEN_HIGH, TEN_LOW = _powers_of_ten()


@njit(cache=True, inline="always")  # type: ignore[untyped-decorator]
def _split_product(a: float, b: float) -> tuple[float, float]:
    """a b as product and its rounding error (Dekker)."""
    p = a * b
    c = 134217729.0 * a  # 2^27 + 1
    ah = c - (c - a)
    al = a - ah
    c = 134217729.0 * b
    bh = c - (c - b)
    bl = b - bh
    return p, ((ah * bh - p) + ah * bl + al * bh) + al * bl


@njit(cache=True)  # type: ignore[untyped-decorator]
def _scale(mantissa: np.uint64, exponent: int) -> tuple[float, bool]:
    """mantissa 10^exponent correctly rounded, and whether that is sure."""
    if mantissa == np.uint64(0):
        return 0.0, True
    if mantissa < np.uint64(9007199254740992) and -22 <= exponent <= 22:
        if exponent < 0:
            return float(mantissa) / TEN_HIGH[MAX_EXPONENT - exponent], True
        return float(mantissa) * TEN_HIGH[MAX_EXPONENT + exponent], True
    if exponent < -MAX_EXPONENT or exponent > MAX_EXPONENT:
        return 0.0, False
    high = float(mantissa)
    low = float(np.int64(mantissa - np.uint64(high)))  # the difference of the two is small, wrapped or not
    p, error = _split_product(high, TEN_HIGH[MAX_EXPONENT + exponent])
    rest = error + (high * TEN_LOW[MAX_EXPONENT + exponent] + low * TEN_HIGH[MAX_EXPONENT + exponent])
    value = p + rest
    left = abs(rest - (value - p))
    _, binary = math.frexp(value)
    half = math.ldexp(1.0, binary - 54)  # half a unit in the last place
    doubt = value * 3.2e-30  # 2^-98
    return value, abs(left - half) > doubt and abs(left - 0.5 * half) > doubt


@njit(cache=True)  # type: ignore[untyped-decorator]
def number(text: NDArray[np.uint8], begin: int, end: int) -> tuple[float, bool]:
    """The number in text[begin:end], and False where this is not a plain decimal number of at most 19 digits."""
    negative = False
    if begin < end and (text[begin] == 45 or text[begin] == 43):  # - +
        negative = text[begin] == 45
        begin += 1
    mantissa = np.uint64(0)
    exponent = 0
    digits = 0
    point = False
    i = begin
    while i < end:
        c = text[i]
        if 48 <= c <= 57:
            if mantissa > np.uint64(1800000000000000000):  # the next digit might leave 64 bits
                return 0.0, False
            mantissa = np.uint64(10) * mantissa + np.uint64(c - 48)
            digits += 1
            if point:
                exponent -= 1
        elif c == 46 and not point:  # .
            point = True
        else:
            break
        i += 1
    if digits == 0:
        return 0.0, False
    if i < end:
        if text[i] != 101 and text[i] != 69:  # e E
            return 0.0, False
        i += 1
        minus = False
        if i < end and (text[i] == 45 or text[i] == 43):
            minus = text[i] == 45
            i += 1
        if i == end or end - i > 4:
            return 0.0, False
        power = 0
        while i < end:
            c = text[i]
            if c < 48 or c > 57:
                return 0.0, False
            power = 10 * power + (c - 48)
            i += 1
        exponent += -power if minus else power
    value, sure = _scale(mantissa, exponent)
    return (-value if negative else value), sure


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def parse(
    text: NDArray[np.uint8],
    begin: int,
    end: int,
    delimiter: int,
    target: NDArray[np.int64],
    out: NDArray[np.float64],
    odd: NDArray[np.int64],
) -> tuple[int, int, int, int, int]:
    """Parse whole lines of text[begin:end] until `out` or `odd` is full.

    `target[field]` is the row of `out` that field goes to, -1 to skip it. What is not a plain number is listed in `odd`
    as (row, target, begin, end) and left nan in `out`. Returns lines parsed, position reached, entries of `odd`,
    outcome (OK, BLANK_LINE, FIELD_COUNT) and the number of fields of the line that ended it.
    """
    fields = target.shape[0]
    rows = 0
    odds = 0
    position = begin
    while position < end and rows < out.shape[1] and odds + fields <= odd.shape[0]:
        i = position
        if text[i] == 10 or (text[i] == 13 and i + 1 < end and text[i + 1] == 10):
            return rows, position, odds, BLANK_LINE, 0
        field = 0
        while True:
            a = i
            if text[i] == 34:  # a quoted field may hold delimiters
                i += 1
                while i < end and text[i] != 34 and text[i] != 10:
                    i += 1
            while i < end and text[i] != delimiter and text[i] != 10:
                i += 1
            if field < fields and target[field] >= 0:
                b = i
                while a < b and (text[a] == 32 or text[a] == 34 or text[a] == 9):
                    a += 1
                while b > a and (text[b - 1] == 32 or text[b - 1] == 13 or text[b - 1] == 34 or text[b - 1] == 9):
                    b -= 1
                value, plain = number(text, a, b)
                if plain:
                    out[target[field], rows] = value
                else:
                    out[target[field], rows] = math.nan
                    odd[odds, 0] = rows
                    odd[odds, 1] = target[field]
                    odd[odds, 2] = a
                    odd[odds, 3] = b
                    odds += 1
            field += 1
            last = i >= end or text[i] == 10
            i += 1
            if last:
                break
        if field != fields:
            return rows, position, odds, FIELD_COUNT, field
        position = i
        rows += 1
    return rows, position, odds, OK, 0
