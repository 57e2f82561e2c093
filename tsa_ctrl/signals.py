"""Define every signal of an axis once: name, unit, meaning, source, and where it appears.

Log record, status, client measurements, their JSON, the charts of dashboard and live layouts, and the manual's table
are derived from this table. To add a signal, add one row.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Collection
from dataclasses import dataclass
from enum import Enum, Flag, auto
from typing import Any


class Place(Flag):
    """A place in which a signal appears."""

    INPUT = auto()  # a log of any origin may have this column
    LOG = auto()  # the daemon writes this column
    STATUS = auto()  # `tsa status`, the dashboard
    CLIENT = auto()  # `Client.measure`


class Kind(Enum):
    """The meaning of a signal's number."""

    VALUE = "value"
    CODE = "code"  # the JSON contains its name
    COUNT = "count"
    FLAG = "flag"
    AGE = "age"  # age of the PDOs of a node, which is the age of this node's values in the JSON


@dataclass(frozen=True)
class Signal:
    """One signal of an axis.

    Attributes:
        name: name of the column and of the key.
        unit: SI unit, "1" for a pure number.
        doc: description of the meaning.
        where: places in which the signal appears.
        source: attribute of `control.axis.ControlAxis`; empty for a signal that the daemon does not have.
        kind: meaning of the number.
        ages: signals with the age of this value, of which the largest applies; empty for a value of the loop itself.
        chart: title of the chart in which the dashboard and the live layouts draw the signal; empty without a chart.
    """

    name: str
    unit: str
    doc: str
    where: Place
    source: str = ""
    kind: Kind = Kind.VALUE
    ages: tuple[str, ...] = ()
    chart: str = ""

    @property
    def stepped(self) -> bool:
        """Return True if the value holds until the next sample and must not be interpolated."""
        return self.kind is not Kind.VALUE


_INPUT, _LOG, _STATUS, _CLIENT = Place.INPUT, Place.LOG, Place.STATUS, Place.CLIENT
_RECORDED = _INPUT | _LOG
_EVERYWHERE = _RECORDED | _STATUS | _CLIENT
_DRIVE, _JOINT, _SENSOR = ("drive_age",), ("joint_age",), ("sensor_age",)
_JOINT_TORQUE, _MOTOR_TORQUE = "joint torque", "motor torque"  # charts

_TABLE = (
    Signal("t", "s", "time", _RECORDED | _STATUS, "terms.t"),
    Signal(
        "tau_m",
        "N*m",
        "motor torque that the drive reports",
        _EVERYWHERE,
        "image.tau_m",
        ages=_DRIVE,
        chart=_MOTOR_TORQUE,
    ),
    Signal(
        "tau_j", "N*m", "measured joint torque", _EVERYWHERE, "instruments.tau_j", ages=_SENSOR, chart=_JOINT_TORQUE
    ),
    Signal("omega_j", "rad/s", "joint velocity", _EVERYWHERE, "terms.omega_j", ages=_JOINT, chart="joint velocity"),
    Signal("q_j", "rad", "joint angle", _EVERYWHERE, "terms.q_j", ages=_JOINT, chart="joint angle"),
    Signal("q_m", "rad", "motor angle", _EVERYWHERE, "image.q_m", ages=_DRIVE),
    Signal("omega_m", "rad/s", "motor velocity", _EVERYWHERE, "image.omega_m", ages=_DRIVE),
    Signal("acceleration_j", "rad/s^2", "joint acceleration", _INPUT),
    Signal("acceleration_m", "rad/s^2", "motor acceleration", _INPUT),
    Signal("theta", "rad", "wrap angle of the sheath, measured or commanded", _RECORDED, "terms.theta"),
    Signal("t1", "N", "motor-side tension of tendon a", _RECORDED, "instruments.t1"),
    Signal("t3", "N", "motor-side tension of tendon b", _RECORDED, "instruments.t3"),
    Signal("temperature", "degC", "temperature of the sheath", _RECORDED, "instruments.temperature"),
    Signal(
        "tau_j_des", "N*m", "desired joint torque, the set-point", _EVERYWHERE, "terms.tau_j_des", chart=_JOINT_TORQUE
    ),
    Signal(
        "tau_m_cmd",
        "N*m",
        "commanded motor torque, after the limiter",
        _EVERYWHERE,
        "terms.tau_m_cmd",
        chart=_MOTOR_TORQUE,
    ),
    Signal("cycle", "1", "number of the cycle, skipped ones counted", _LOG, "terms.cycle", Kind.COUNT),
    Signal("lateness", "s", "wake-up after the cycle's deadline", _LOG, "terms.lateness"),
    Signal("work", "s", "time from wake-up to the last frame sent", _LOG, "terms.work"),
    Signal("pdo_age", "s", "age of the oldest process data used", _LOG | _STATUS, "image.pdo_age"),
    Signal("missed", "1", "PDOs missed so far", _LOG | _STATUS, "image.missed", Kind.COUNT),
    Signal("state", "1", "power state of the drive, a code", _LOG | _STATUS, "terms.state", Kind.CODE, _DRIVE),
    Signal("sigma", "1", "direction of motion that the law used, -1 to 1", _LOG | _STATUS, "terms.sigma"),
    Signal(
        "friction_term",
        "N*m",
        "motor torque added for friction",
        _LOG | _STATUS,
        "law.friction_term",
        chart=_MOTOR_TORQUE,
    ),
    Signal("friction_angle", "1", "mu Theta of the law's model", _LOG | _STATUS, "estimator.friction_angle"),
    Signal("pretension", "N", "T_p of the law's model", _LOG | _STATUS, "estimator.pretension"),
    Signal("estimate_state", "1", "state of the estimator, a code", _LOG | _STATUS, "estimator.state", Kind.CODE),
    Signal(
        "limit_reason",
        "1",
        "reason why the torque is not the desired one, a code",
        _LOG | _STATUS | _CLIENT,
        "reason",
        Kind.CODE,
    ),
    Signal(
        "tau_j_stretch",
        "N*m",
        "joint torque from the tendon elongation and the motor torque",
        _LOG | _STATUS | _CLIENT,
        "joint_torque.torque",
        ages=_DRIVE + _JOINT,
        chart=_JOINT_TORQUE,
    ),
    Signal("tau_j_stretch_low", "N*m", "its 95 % band, lower end", _LOG | _STATUS, "joint_torque.low"),
    Signal("tau_j_stretch_high", "N*m", "its 95 % band, upper end", _LOG | _STATUS, "joint_torque.high"),
    Signal(
        "tau_j_model",
        "N*m",
        "joint torque from the motor torque by the model",
        _LOG | _STATUS | _CLIENT,
        "joint_torque.model.torque",
        ages=_DRIVE,
        chart=_JOINT_TORQUE,
    ),
    Signal(
        "tau_j_model_low",
        "N*m",
        "its band, lower end; at standstill the friction band",
        _LOG | _STATUS,
        "joint_torque.model.low",
    ),
    Signal("tau_j_model_high", "N*m", "its band, upper end", _LOG | _STATUS, "joint_torque.model.high"),
    Signal("late", "1", "PDOs that came after their cycle's deadline", _STATUS, "image.late", Kind.COUNT),
    Signal("repeated", "1", "PDOs that came twice in a cycle", _STATUS, "image.repeated", Kind.COUNT),
    Signal("malformed", "1", "frames of a wrong length", _STATUS, "image.malformed", Kind.COUNT),
    Signal("guard_latched", "1", "the guard keeps its back-off until a release", _STATUS, "guard.latched", Kind.FLAG),
    Signal("guard_energy", "J", "energy that the compensation has added recently", _STATUS, "guard.energy"),
    Signal("guard_back_off", "1", "factor of the compensation by the guard, 1: not reduced", _STATUS, "guard.back_off"),
    Signal("guard_count", "1", "detections of the guard so far", _STATUS, "guard.count", Kind.COUNT),
    Signal(
        "compensation_limit_share",
        "1",
        "permitted share of the model's friction term",
        _STATUS,
        "compensation_limit.share",
    ),
    Signal(
        "compensation_limit_credit",
        "J",
        "energy that the friction term may still add without proof",
        _STATUS,
        "compensation_limit.credit.left",
    ),
    Signal(
        "compensation_limit_capacity",
        "J",
        "energy credit after an enable",
        _STATUS,
        "compensation_limit.credit.capacity",
    ),
    Signal(
        "compensation_limit_withdrawn",
        "1",
        "the credit is spent, and the unproven friction term is withdrawn",
        _STATUS,
        "compensation_limit.credit.withdrawn",
        Kind.FLAG,
    ),
    Signal(
        "compensation_limit_contradicted",
        "1",
        "the joint torque sensor shows more friction than the tendon elongation permits",
        _STATUS,
        "compensation_limit.proven.contradicted",
        Kind.FLAG,
    ),
    Signal("permitted", "1", "torque is permitted", _CLIENT, "terms.permitted", Kind.FLAG),
    Signal("drive_age", "s", "time since the last PDOs of the drive", _STATUS, "terms.drive_age", Kind.AGE),
    Signal("joint_age", "s", "the same of the joint encoder", _STATUS, "terms.joint_age", Kind.AGE),
    Signal("sensor_age", "s", "the same of the torque sensor on the bus", _STATUS, "terms.sensor_age", Kind.AGE),
)
SIGNALS: dict[str, Signal] = {signal.name: signal for signal in _TABLE}


def signals_of(place: Place) -> tuple[Signal, ...]:
    """Return the signals that appear in `place`, in the order of the table."""
    return tuple(signal for signal in _TABLE if place & signal.where)


def names_of(place: Place) -> tuple[str, ...]:
    """Return the names of the signals that appear in `place`, in the order of the table."""
    return tuple(signal.name for signal in signals_of(place))


def row_type(name: str, place: Place) -> Any:
    """Return a named tuple type of the values in `place`, with default 0."""
    fields = names_of(place)
    return namedtuple(name, fields, defaults=[0.0] * len(fields))


COLUMNS: dict[str, Signal] = {signal.name: signal for signal in signals_of(Place.INPUT | Place.LOG)}
"""Columns of logs by name."""
INPUTS: tuple[str, ...] = names_of(Place.INPUT)
"""Columns that every command accepts in a log."""
JOINT_ANGLE = "q_j."
"""Prefix of the column of another axis' joint angle in rad, NAME following: a joint that may bend the sheath."""


def is_input(name: str) -> bool:
    """Return True if every command accepts the column `name` in a log."""
    return name in INPUTS or (name.startswith(JOINT_ANGLE) and len(name) > len(JOINT_ANGLE))


def is_selected(name: str, wanted: Collection[str] | None) -> bool:
    """Return True if `name` is selected; q_j includes the columns q_j.NAME of all joints."""
    return wanted is None or name in wanted or (name.startswith(JOINT_ANGLE) and "q_j" in wanted)


FIELDS: tuple[Signal, ...] = signals_of(Place.LOG)
"""Columns that the daemon records, in the order of its log."""
FIELD_NAMES: tuple[str, ...] = names_of(Place.LOG)
BANDED: tuple[str, ...] = tuple(name for name in names_of(Place.STATUS) if f"{name}_low" in names_of(Place.STATUS))
"""Signals of the status that lie in a band NAME_low to NAME_high."""
GROUPS: tuple[str, ...] = ("guard", "compensation_limit")
"""Objects of an axis in the status; each contains the signals whose names begin with its name."""
CHARTS: dict[str, tuple[Signal, ...]] = {
    title: tuple(signal for signal in _TABLE if signal.chart == title)
    for title in dict.fromkeys(signal.chart for signal in _TABLE if signal.chart)
}
"""Charts of an axis by title, with the signals of each."""
