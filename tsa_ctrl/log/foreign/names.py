"""Determine from a foreign name which canonical column it is, by the words of the name.

A name is split into its unit and its words. Each word belongs to at most one class of the vocabulary, in English,
German, French, Italian, Spanish or Portuguese. A column requires a word of its quantity and a word of its place.
Words of errors, limits, commands and desired values exclude a measured column.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache

from tsa_ctrl.log.foreign.units import brackets_in, is_known, needs_scale, quantities_of, tails_of
from tsa_ctrl.signals import COLUMNS, INPUTS

TORQUE, CURRENT, ANGLE, SPEED, TEMPERATURE, BENDING, TIME, OTHER = (
    "torque", "current", "angle", "speed", "temperature", "bending", "time", "other quantity",
)  # fmt: skip
QUANTITIES = frozenset({TORQUE, CURRENT, ANGLE, SPEED, TEMPERATURE, BENDING, TIME, OTHER})
_SI = {TORQUE: "N*m", ANGLE: "rad", SPEED: "rad/s", TEMPERATURE: "degC", BENDING: "rad", TIME: "s"}
MOTOR, JOINT, BODY, DESIRED, COMMANDED, EXCLUDED, NEUTRAL = (
    "motor", "joint", "body part", "desired", "commanded", "excluded", "neutral",
)  # fmt: skip
_PLACES = frozenset({MOTOR, JOINT, BODY})
NO_CLOCK = "no clock"  # a duration instead of the time of a row

_CLASSES: dict[str, str] = {
    TORQUE: "torque drehmoment moment tau trq mom torq effort couple coppia par torsor binario",
    CURRENT: "current strom iq isq amps ampere courant corrente corriente",
    ANGLE: "angle winkel position pos theta phi lage angolo angulo ángulo ângulo posizione posicion posición posição",
    SPEED: "velocity speed geschwindigkeit winkelgeschwindigkeit drehzahl omega vel rpm qd dq dtheta dphi vitesse "
    "velocita velocità velocidad velocidade",
    TEMPERATURE: "temperature temperatur temp température temperatura",
    BENDING: "bending biegung biegewinkel sheath",
    TIME: "time zeit timestamp zeitstempel clock uhrzeit temps tempo tiempo",
    OTHER: "voltage spannung power leistung force kraft pressure druck energy energie frequency frequenz fieldcurrent "
    "acceleration beschleunigung accel acc qdd ddq ddtheta ddphi",
    MOTOR: "motor drive antrieb driver mot rotor input actuator aktor aktuator eingang moteur motore actionneur "
    "attuatore actuador atuador entrée entrada ingresso",
    JOINT: "joint gelenk load output abtrieb jaw last link external ext extern articulation articolazione giunto "
    "articulacion articulación articulação junta carico carga sortie uscita salida saída",
    BODY: "hip knee ankle elbow shoulder wrist finger thumb huefte hüfte knie knöchel knoechel sprunggelenk kniegelenk "
    "hüftgelenk hueftgelenk ellenbogen ellbogen schulter handgelenk daumen "
    "genou ginocchio rodilla joelho hanche anca cadera quadril cheville caviglia tobillo tornozelo coude gomito codo",
    DESIRED: "desired des setpoint soll reference ref target wanted demand consigne consigna riferimento référence "
    "referencia referência",
    COMMANDED: "command commanded cmd commande comando mando",
    EXCLUDED: "error err fehler deviation abweichung limit grenze grenzwert max min maximum minimum maximal minimal "
    "constant konstante gain ripple derivative ableitung threshold schwelle tolerance residual "
    "erreur errore erro limite écart seuil factor faktor",
    NEUTRAL: "ist mess actual act measured meas messung filtered gefiltert filt sensor signal signals value values "
    "wert werte data shaft angular encoder feedback fb",
    NO_CLOCK: "cycle sample sampling step delay dead rise settling execution zyklus abtast tot",
}
VOCABULARY: dict[str, str] = {word: kind for kind, text in _CLASSES.items() for word in text.split()}
# After one of these symbols, a word of `_LETTERS` is a place: tau_m, q_out.
_SYMBOLS = frozenset({"tau", "q", "omega", "theta", "th", "phi", "dq", "qd", "w", "trq", "iq"})
_LETTERS = {"m": MOTOR, "j": JOINT, "in": MOTOR, "out": JOINT}
_SHORT = {"q": ANGLE, "th": ANGLE, "w": SPEED}  # a quantity only directly before a motor or joint word
# A quantity at the start, if a motor or joint word follows, or no word except neutral, desired and commanded.
_FIRST = {"m": TORQUE, "n": SPEED, "i": CURRENT, "u": OTHER, "p": OTHER, "f": OTHER, "q": ANGLE, "w": SPEED}
_DERIVATIVES = {"dot": SPEED, "punkt": SPEED, "ddot": OTHER}  # the quantity that an angle before them becomes
_WHOLE = frozenset({"t", "s", "sec", "seconds"})  # time, as a whole name
_PARTS = tuple(word for word, kind in VOCABULARY.items() if len(word) >= 3 and kind != NO_CLOCK)
_MEASURED = {
    "tau_m": (frozenset({TORQUE, CURRENT}), MOTOR),
    "tau_j": (frozenset({TORQUE}), JOINT),
    "q_m": (frozenset({ANGLE}), MOTOR),
    "q_j": (frozenset({ANGLE}), JOINT),
    "omega_m": (frozenset({SPEED}), MOTOR),
    "omega_j": (frozenset({SPEED}), JOINT),
}


@lru_cache(maxsize=4096)
def _decomposed(word: str) -> tuple[str, ...] | None:
    """Return the words of the vocabulary that a compound consists of, with an optional linking "s", or None."""
    for part in _PARTS:
        if not word.startswith(part):
            continue
        rest = word[len(part) :]
        for tail in (rest, rest[1:] if rest.startswith("s") else ""):
            if tail in VOCABULARY and len(tail) >= 3:
                return part, tail
            if len(tail) > 3 and (parts := _decomposed(tail)) is not None:
                return part, *parts
    return None


def split_words(bare: str) -> list[str]:
    """Split a name without its unit into lower-case words, and compounds into the words of the vocabulary."""
    text = re.sub(r"(?i)(?<![a-z0-9])i_?s?_?q(?![a-z])", "iq", bare)
    text = re.sub(r"(?i)(?<![a-z0-9])i_s?_?d(?![a-z])", "fieldcurrent", text)
    text = re.sub(r"(?i)set[-_ ]point", "setpoint", text)
    text = re.sub(r"(?i)(theta|phi|(?<![a-z])q)(d?dot)(?![a-z])", r"\1 \2", text)
    text = re.sub(r"(?i)(?:[×*]|(?<![a-z0-9])x) ?10+(?!\d)|(?<!\d)10+ ?[x×*]", " factor ", text)  # torque*1000
    text = re.sub(r"(?i)\bdes (motor|antrieb|gelenk|abtrieb|aktor|knie)e?s\b", r"\1", text)  # German genitive
    text = re.sub(r"(?<=[^\W\d_])(?=\d)|(?<=\d)(?=[^\W\d_])", " ", text)
    text = re.sub(r"([a-zäöüß])([A-ZÄÖÜ])", r"\1 \2", text)
    text = re.sub(r"([A-ZÄÖÜ])([A-ZÄÖÜ][a-zäöüß])", r"\1 \2", text)
    words: list[str] = []
    for word in re.split(r"[\W_]+", text.lower()):
        if word:
            words += [word] if word in VOCABULARY else _decomposed(word) or [word]
    return words


def _kinds(words: list[str]) -> list[str]:
    """Return the class of each word, or "" for an unknown word."""
    kinds = [VOCABULARY.get(word, "") for word in words]
    for i, word in enumerate(words[1:], start=1):
        if word in _LETTERS and (words[i - 1] in {*_SYMBOLS, *_DERIVATIVES} or words[:i] == ["m"]):
            kinds[i] = _LETTERS[word]
    for i, word in enumerate(words[:-1]):
        if word in _SHORT and kinds[i + 1] in (MOTOR, JOINT, BODY):
            kinds[i] = _SHORT[word]
    for i, word in enumerate(words):
        angles = [j for j in range(i) if kinds[j] == ANGLE or words[j] in _SHORT]
        if word in _DERIVATIVES and angles:
            kinds[angles[-1]], kinds[i] = NEUTRAL, _DERIVATIVES[word]
    first = next((i for i, kind in enumerate(kinds) if kind != NEUTRAL), None)
    following = [] if first is None else range(first + 1, len(words))
    rest = [i for i in following if not words[i].isdigit() and kinds[i] not in (NEUTRAL, DESIRED, COMMANDED)]
    place = kinds[rest[0]] if rest else ""
    if first is not None and words[first] in _FIRST and (not rest or place in _PLACES):
        kinds[first] = _FIRST[words[first]]
    # "current" in front of another quantity is the adjective: "current motor position".
    ranked = [i for i, kind in enumerate(kinds) if kind in (TORQUE, ANGLE, SPEED)]
    if ranked and "current" in words and words.index("current") < ranked[0]:
        kinds[words.index("current")] = NEUTRAL
    return kinds


def _columns(kinds: list[str]) -> frozenset[str]:
    have = set(kinds)
    if BODY in have and MOTOR not in have:
        have.add(JOINT)  # a body part next to a motor word is the motor's place
    excluded = EXCLUDED in have
    found = set()
    if TIME in have and not excluded and NO_CLOCK not in have:
        found.add("t")
    if TORQUE in have and DESIRED in have and MOTOR not in have and not excluded:
        found.add("tau_j_des")
    if not excluded and not have & {DESIRED, COMMANDED}:
        found |= {name for name, (quantity, place) in _MEASURED.items() if quantity & have and place in have}
        if TEMPERATURE in have:
            found = (found - set(_MEASURED)) | {"temperature"}
        elif BENDING in have and not have & {TORQUE, CURRENT, SPEED, MOTOR}:
            found = (found - set(_MEASURED)) | {"theta"}
    return frozenset(found)


@dataclass(frozen=True)
class Name:
    """A foreign name with its unit and its words."""

    source: str

    @cached_property
    def split(self) -> tuple[str, str | None]:
        """Return the name without its unit, and the unit or None."""
        source = re.sub(r" \(\d+\)(?=$| \[)", "", self.source)  # the number of a repeated name
        for content, (start, end) in reversed(brackets_in(source)):
            if is_known(content) or not any(_kinds(split_words(content))):
                return (source[:start] + source[end:]).strip(), content
        named = source.strip()
        while (last := re.search(r"[ _]([^\W_]+)$", named)) and VOCABULARY.get(last[1].lower()) == NEUTRAL:
            named = named[: last.start()]  # motor_torque_mNm_filtered
        for bare, unit in () if source in INPUTS else tails_of(named):
            kinds = _kinds(split_words(bare))
            quantities = {COLUMNS[name].unit for name in _fitting(bare, unit)} | {_SI[k] for k in kinds if k in _SI}
            device = not quantities_of(unit)
            if (quantities and device) or quantities & quantities_of(unit):
                return bare, unit
            # A letter may also be a phase of a motor or a channel, and several words may belong to the name.
            if re.search("[ _]", unit):
                continue
            if unit.lower() in VOCABULARY:  # motor_rpm
                if {COLUMNS[name].unit for name in _fitting(named, None)} & quantities_of(unit):
                    return source.strip(), unit
                continue
            if len(unit) > 1 or not (quantities or f" {unit}" in source):
                return bare, unit
        return source.strip(), None

    @property
    def bare(self) -> str:
        """Return the name without its unit."""
        return self.split[0]

    @property
    def unit(self) -> str | None:
        """Return the unit that the name states, or the canonical unit of a canonical name, or None."""
        if self.split[1] is not None:
            return self.split[1]
        return None if self.canonical is None else COLUMNS[self.canonical].unit

    @cached_property
    def canonical(self) -> str | None:
        """Return the canonical name that the name is or ends with, as a component of a path, or None."""
        return _canonical(self.bare)

    @cached_property
    def columns(self) -> frozenset[str]:
        """Return the canonical columns that the name fits."""
        return _fitting(self.bare, self.split[1])

    @cached_property
    def kinds(self) -> frozenset[str]:
        """Return the classes of all words of the name."""
        return frozenset(_kinds(split_words(self.bare)))

    @property
    def is_current(self) -> bool:
        """Return True if the name is a current, which is a torque only with a scale in N*m per A."""
        return CURRENT in self.kinds and TORQUE not in self.kinds

    @property
    def unplaced(self) -> str | None:
        """Return the quantity of a measured column whose name does not state motor or joint, or None.

        All words of such a name are known: "position 1", but not "hand position".
        """
        words = split_words(self.bare)
        kinds = {kind for word, kind in zip(words, _kinds(words), strict=True) if not word.isdigit()}
        quantities = kinds - {NEUTRAL}
        if self.columns or len(quantities) != 1:
            return None
        (quantity,) = quantities
        return quantity if quantity in (TORQUE, CURRENT, ANGLE, SPEED) else None

    @property
    def is_command(self) -> bool:
        """Return True if the name is a commanded or desired torque that is not stated to be the joint's."""
        kinds = self.kinds
        return TORQUE in kinds and bool(kinds & {DESIRED, COMMANDED}) and not kinds & {EXCLUDED, JOINT, BODY}

    @property
    def unknown(self) -> int:
        """Return the number of words that are not in the vocabulary."""
        if self.bare in INPUTS or self.bare.lower() in _WHOLE:
            return 0
        return _kinds(split_words(self.bare)).count("")

    def may_be(self, column: str) -> bool:
        """Return True if nothing in the name contradicts `column`, so that a proposal can use it."""
        if self.columns:
            return column in self.columns
        if self.kinds & {EXCLUDED, DESIRED, COMMANDED}:
            return False
        unit, si = self.split[1], COLUMNS[column].unit
        if unit is not None and is_known(unit) and needs_scale(unit, si):
            return False
        own = {TIME} if column == "t" else {TORQUE}
        place = {"tau_m": JOINT, "tau_j": MOTOR}.get(column)
        return not (self.kinds & QUANTITIES) - own and place not in self.kinds


def _components(bare: str) -> list[str]:
    return [part.strip() for part in re.split(r"[/.]", bare) if part.strip()]


def _canonical(bare: str) -> str | None:
    if bare in INPUTS:
        return bare
    parts = _components(bare)
    while len(parts) > 1 and set(_kinds(split_words(parts[-1]))) == {NEUTRAL}:
        parts.pop()
    if len(parts) < 2 or parts[-1] not in INPUTS or _is_of_commands(parts[:-1]):
        return None
    others = _columns(_kinds(split_words(" ".join(parts)))) - {parts[-1]}
    return None if parts[-1] == "theta" and others else parts[-1]


def _is_of_commands(folders: list[str]) -> bool:
    return bool({EXCLUDED, DESIRED, COMMANDED} & set(_kinds(split_words(" ".join(folders)))))


def _fitting(bare: str, unit: str | None) -> frozenset[str]:
    """Return the columns that a name without its unit fits. If there are several, the unit decides if it can.

    "T" before a place is a torque or a temperature. If all words are places, the unit states the quantity.
    """
    found = _fitting_by_words(bare, unit)
    if not found and (short := re.match(r"T(?![a-z])", bare)):
        readings = [_fitting_by_words(quantity + " " + bare[short.end() :], unit) for quantity in ("tau", TEMPERATURE)]
        found = readings[0] | readings[1] if readings[0] else found
    quantities = quantities_of(unit or "")
    kinds = _kinds([word for word in split_words(bare) if not word.isdigit()])
    if not found and len(quantities) == 1 and set(kinds) & _PLACES and set(kinds) <= {*_PLACES, NEUTRAL}:
        found = _columns([*kinds, *(kind for kind, si in _SI.items() if si in quantities and kind != BENDING)])
    if len(found) > 1 and quantities:
        found = frozenset(name for name in found if COLUMNS[name].unit in quantities) or found
    return found


def _fitting_by_words(bare: str, unit: str | None) -> frozenset[str]:
    """Return the columns that the words of a name fit. In a path, the last component decides if it fits alone."""
    canonical = _canonical(bare)
    if canonical is not None:
        return frozenset({canonical})
    parts = _components(bare)
    for part in [parts[-1]] if parts else []:
        if part.lower() in _WHOLE and (unit is None or not is_known(unit) or not needs_scale(unit, "s")):
            return frozenset({"t"})
        found = _columns(_kinds(split_words(part)))
        if found and not (len(parts) > 1 and _is_of_commands(parts[:-1])):
            return found
    return _columns(_kinds(split_words(bare)))


def is_time(source: str) -> bool:
    """Return True if a name is a time and no other column."""
    return Name(source).columns == {"t"}


def listed(names: Iterable[str], most: int = 12) -> str:
    """Return quoted names with commas; after `most` names, the number of the others."""
    every = list(names)
    more = f" and {len(every) - most} more" if len(every) > most else ""
    return ", ".join(f"'{name}'" for name in every[:most]) + more
