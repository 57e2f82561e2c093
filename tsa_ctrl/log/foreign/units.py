"""Units of foreign columns, and the unit that a foreign name states.

A unit is parsed by a grammar, so that each spelling of a unit has the same value. A unit is a product of factors with
exponents, divided by further products. Factors are joined by a sign, by a space or by nothing (Nm, N·m, N*m, N-m, N m).
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import lru_cache

DATE = "date"  # the unit of a column of dates and times

_G, _POUND, _INCH, _TURN, _DEGREE = 9.80665, 0.45359237, 0.0254, 2.0 * math.pi, math.pi / 180.0  # SI
_FORCE, _MASS, _LENGTH, _TIME, _ANGLE = "force", "mass", "length", "time", "angle"
_PREFIXES = {"m": 1e-3, "c": 1e-2, "d": 1e-1, "k": 1e3, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "n": 1e-9}
# Dimension, spellings, SI per unit, and the permitted prefixes. A mass in a torque is a weight: kg·cm is kgf·cm.
_BASES: tuple[tuple[str, str, float, str], ...] = (
    (_FORCE, "N newton newtons", 1.0, "m k u µ μ"),
    (_FORCE, "kgf", _G, ""),
    (_FORCE, "gf", 1e-3 * _G, ""),
    (_FORCE, "lbf lbsf", _POUND * _G, ""),
    (_FORCE, "ozf", _POUND / 16.0 * _G, ""),
    (_MASS, "kg kp", _G, ""),
    (_MASS, "g", 1e-3 * _G, ""),
    (_MASS, "lb lbs pound pounds", _POUND * _G, ""),
    (_MASS, "oz ounce ounces", _POUND / 16.0 * _G, ""),
    (_LENGTH, "m meter meters metre metres", 1.0, "m c d u µ μ"),
    (_LENGTH, "in inch inches", _INCH, ""),
    (_LENGTH, "ft foot feet", 12.0 * _INCH, ""),
    (_TIME, "s sec secs second seconds sek", 1.0, "m u µ μ n"),
    (_TIME, "millisecond milliseconds", 1e-3, ""),
    (_TIME, "microsecond microseconds", 1e-6, ""),
    (_TIME, "nanosecond nanoseconds", 1e-9, ""),
    (_TIME, "min minutes", 60.0, ""),
    (_TIME, "h hr hours", 3600.0, ""),
    (_ANGLE, "rad radian radians", 1.0, "m u µ μ"),
    (_ANGLE, "deg degs degree degrees ° º grad gradi grados graus degré degrés", _DEGREE, "m"),  # "Grad" is German
    (_ANGLE, "arcmin", _DEGREE / 60.0, ""),
    (_ANGLE, "arcsec", _DEGREE / 3600.0, ""),
    (_ANGLE, "gon", _TURN / 400.0, ""),
    (_ANGLE, "rev revs revolution revolutions turn turns U tr giri", _TURN, "m"),
)
_FACTORS: dict[str, tuple[float, Counter[str]]] = {
    prefix + word: (_PREFIXES.get(prefix, 1.0) * scale, Counter({dimension: 1}))
    for dimension, words, scale, prefixes in _BASES
    for prefix in ("", *prefixes.split())
    for word in words.split()
}
_FACTORS["min"] = 60.0, Counter({_TIME: 1})
_FACTORS |= {
    word: (scale, Counter({_ANGLE: 1, _TIME: -1}))
    for word, scale in (("rpm", _TURN / 60), ("mrpm", _TURN / 60e3), ("krpm", 1e3 * _TURN / 60), ("rps", _TURN))
}
_FACTORS |= {"dps": (_DEGREE, Counter({_ANGLE: 1, _TIME: -1})), "Hz": (_TURN, Counter({_ANGLE: 1, _TIME: -1}))}
_LOWER = {word.lower(): factor for word, factor in _FACTORS.items()}
# Dimensions of each SI unit of our columns.
_DIMENSIONS: dict[str, tuple[dict[str, int], ...]] = {
    "s": ({_TIME: 1},),
    "N*m": ({_FORCE: 1, _LENGTH: 1}, {_MASS: 1, _LENGTH: 1}),
    "rad": ({_ANGLE: 1},),
    "rad/s": ({_ANGLE: 1, _TIME: -1},),
    "rad/s^2": ({_ANGLE: 1, _TIME: -2},),
    "N": ({_FORCE: 1},),
}
_TEMPERATURES = {"degC": 1.0, "°C": 1.0, "ºC": 1.0, "℃": 1.0, "deg C": 1.0, "Celsius": 1.0, "C": 1.0, "K": 1.0,
                 "°F": 5 / 9, "degF": 5 / 9, "F": 5 / 9}  # fmt: skip
SHIFT = {"K": -273.15, "°F": -160 / 9, "degF": -160 / 9, "F": -160 / 9}  # degC, added after the scale
QUANTITIES = (*_DIMENSIONS, "degC")
EXAMPLES = {  # for messages
    "s": "s, ms, us, ns, min, h, date", "N*m": "N*m, Nm, mN*m, N*cm, kgf*cm, lbf*in, ozf*in", "rad": "rad, deg, rev",
    "rad/s": "rad/s, deg/s, rpm, rev/s", "rad/s^2": "rad/s^2, deg/s^2", "N": "N, mN, kN, kgf, lbf",
    "degC": "degC, K, degF",
}  # fmt: skip
LEVER_ARM = {"N", "N*m"}  # units of quantities between which a lever arm or a pulley radius converts, as scale
# Units that depend on the device need `scale`.
DEVICE_UNITS = {"a": "N*m per A", "ma": "N*m per mA", "%": "SI per %", "permille": "SI per mille",
                "‰": "SI per mille", "counts": "rad per count", "cnt": "rad per count", "inc": "rad per increment",
                "v": "SI per V", "mv": "SI per mV", "digits": "SI per digit"}  # fmt: skip

_DIVIDED = re.compile(r"\s*/\s*|[ _]per[ _]")
_JOINED = re.compile(r"\s*[·⋅•∙*×._]\s*|\s*[-‐‑](?=[^\W\d_])\s*|\s+")
_TOKEN = re.compile(r"([^\W\d_]+|°)(?:\^?(-?\d))?")
_RAISED = str.maketrans("⁻−¹²³", "--123")


@lru_cache(maxsize=4096)
def scale_of(unit: str, si: str) -> float | None:
    """Return the value of one `unit` in the SI unit `si`, or None if `unit` does not measure this quantity.

    A date measures time in s. A temperature has an additional offset in `SHIFT`.
    """
    if si == "degC":
        return _TEMPERATURES.get(unit.replace("_", " "))
    if unit == si or (si, unit) == ("s", DATE):
        return 1.0
    for text in (unit, re.sub(r"[ _]", "/", unit.strip(), count=1)):  # rad_s and rad_s2 in a name without slashes
        scale, dimensions = _parsed(text)
        if si == "rad/s" and dimensions == {_TIME: -1} and math.isclose(scale, 1.0 / 60.0):
            return scale * _TURN  # 1/min and r/min count turns, but 1/s may count radians
        if dimensions in _DIMENSIONS.get(si, ()):
            return scale
    return None


def _parsed(unit: str) -> tuple[float, dict[str, int]]:
    """Return the SI value of a unit and the exponent of each of its dimensions, none if it cannot be parsed."""
    scale, dimensions = 1.0, Counter[str]()
    for place, product in enumerate(_DIVIDED.split(unit.strip().translate(_RAISED))):
        if place == 0 and product in ("", "1", "r"):
            continue
        tokens = _JOINED.split(product)
        for token in tokens:
            found = _TOKEN.fullmatch(token)
            factors = None if found is None else _factors(found[1], len(tokens) > 1)
            if found is None or factors is None:
                return 1.0, {}
            exponent = int(found[2] or "1")
            for i, (value, own) in enumerate(factors, start=1):
                power = (exponent if i == len(factors) else 1) * (1 if place == 0 else -1)
                scale *= value**power
                for dimension, count in own.items():
                    dimensions[dimension] += count * power
    return scale, {dimension: count for dimension, count in dimensions.items() if count}


def _factors(word: str, joined: bool) -> list[tuple[float, Counter[str]]] | None:
    """Return the factor that a word is, or the force and the length that it consists of, or None.

    Letters in another case are accepted if the word has one case (RPM, nm) or starts with a capital (Rad), because the
    case distinguishes mNm from MNm. A single letter must be joined to another factor (n_m).
    """
    one_case = (joined or len(word) > 1) and word in (word.lower(), word.upper(), word.capitalize())
    for table, text in ((_FACTORS, word), (_LOWER, word.lower() if one_case else "")):
        if text in table:
            return [table[text]]
        for i in range(1, len(text)):
            pair = [table[part] for part in (text[:i], text[i:]) if part in table]
            dimensions = {dimension for _, own in pair for dimension in own}
            if len(pair) == 2 and dimensions in ({_FORCE, _LENGTH}, {_MASS, _LENGTH}):
                return pair
    return None


def quantities_of(unit: str) -> frozenset[str]:
    """Return the SI units of the quantities that `unit` can measure; empty for a device unit or an unknown unit."""
    return frozenset(si for si in QUANTITIES if scale_of(unit, si) is not None)


def is_known(unit: str) -> bool:
    """Return True if `unit` converts to SI, or converts with a scale that depends on the device."""
    return bool(quantities_of(unit)) or unit.lower() in DEVICE_UNITS


def are_units(cells: Sequence[str]) -> bool:
    """Return True if all cells are units; "-" and "1" count as units next to others."""
    known = [is_known(cell) for cell in cells if cell not in ("-", "1")]
    return any(known) and all(known)


def needs_scale(unit: str, si: str) -> bool:
    """Return True if a scale of the device is required to convert `unit` to the SI unit `si`."""
    return scale_of(unit, si) is None


_BRACKETS = re.compile(r"[\[(<{]\s*([^\[\](){}<>]+?)\s*[\])>}]")


def brackets_in(source: str) -> list[tuple[str, tuple[int, int]]]:
    """Return the content and the position of each pair of brackets in a name, except numbers such as "(2)"."""
    return [(found[1], found.span()) for found in _BRACKETS.finditer(source) if not found[1].isdigit()]


def tails_of(source: str) -> Iterator[tuple[str, str]]:
    """Yield a name without the known unit at its end, and the unit, the longest unit first.

    The unit follows a space, a slash or an underscore, and has up to three words: torque_lbf_in, speed_rev_per_min.
    """
    for words, word in ((3, "[^ _]+"), (2, "[^ _]+"), (1, "[^ _]+"), (1, "[^ _/]+")):  # the last: "Motor torque/mNm"
        found = re.search(rf"[ _/]({word}(?:[ _]{word}){{{words - 1}}})$", source.strip())
        if found is not None and (quantities_of(found[1]) if words > 1 else is_known(found[1])):
            bare = source.strip()[: found.start()]
            yield re.sub(r"[ _]in$|[,;:]$", "", bare), found[1]  # "Moment in mNm", "Moment, mNm"
