"""Define the record of one cycle of one axis, which the loop writes to the log, and the columns of logs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple


@dataclass(frozen=True)
class Column:
    """Describe one column of a log; `stepped` values hold until the next sample and are never interpolated."""

    name: str
    unit: str
    doc: str
    stepped: bool = False


SIGNALS: tuple[Column, ...] = (
    Column("t", "s", "time"),
    Column("tau_m", "N*m", "motor torque that the drive reports"),
    Column("tau_j", "N*m", "joint torque measured"),
    Column("omega_j", "rad/s", "joint velocity"),
    Column("q_j", "rad", "joint angle"),
    Column("q_m", "rad", "motor angle"),
    Column("omega_m", "rad/s", "motor velocity"),
    Column("acceleration_j", "rad/s^2", "joint acceleration"),
    Column("acceleration_m", "rad/s^2", "motor acceleration"),
    Column("theta", "rad", "sheath bending angle, measured or commanded"),
    Column("t1", "N", "motor-side tension of tendon a"),
    Column("t3", "N", "motor-side tension of tendon b"),
    Column("temperature", "degC", "temperature of the sheath"),
    Column("tau_j_des", "N*m", "joint torque wanted: the set-point"),
    Column("tau_m_cmd", "N*m", "motor torque commanded, after the limiter"),
)
"""Columns that every command accepts in a log."""

CYCLE: tuple[Column, ...] = (
    Column("cycle", "1", "number of the cycle, skipped ones counted", stepped=True),
    Column("lateness", "s", "wake-up after the cycle's deadline"),
    Column("work", "s", "time from wake-up to the last frame sent"),
    Column("pdo_age", "s", "age of the oldest process data used"),
    Column("missed", "1", "PDOs missed so far", stepped=True),
    Column("state", "1", "power state of the drive, a code", stepped=True),
    Column("sigma", "1", "direction of motion as the law used it, -1 to 1"),
    Column("friction_term", "N*m", "motor torque added for friction"),
    Column("friction_angle", "1", "mu Theta of the law's model"),
    Column("pretension", "N", "T_p of the law's model"),
    Column("estimate_state", "1", "state of the estimator, a code", stepped=True),
    Column("limit_reason", "1", "what the limiter did, a code", stepped=True),
    Column("tau_j_stretch", "N*m", "joint torque from the tendons' stretch and the motor torque"),
    Column("tau_j_stretch_low", "N*m", "its 95 % band, lower end"),
    Column("tau_j_stretch_high", "N*m", "its 95 % band, upper end"),
    Column("tau_j_model", "N*m", "joint torque from the motor torque by the model"),
    Column("tau_j_model_low", "N*m", "its band, lower end: the friction's at standstill"),
    Column("tau_j_model_high", "N*m", "its band, upper end"),
)
"""Columns that the daemon records in addition to the signals."""

BY_NAME: dict[str, Column] = {column.name: column for column in SIGNALS + CYCLE}
SIGNAL_NAMES: tuple[str, ...] = tuple(column.name for column in SIGNALS)


class Record(NamedTuple):
    """Hold one row of the daemon's log, units and meanings as in `FIELDS`; all are float64, nan for a missing value."""

    t: float
    tau_m: float
    tau_j: float
    omega_j: float
    q_j: float
    q_m: float
    omega_m: float
    theta: float
    t1: float
    t3: float
    temperature: float
    tau_j_des: float
    tau_m_cmd: float
    cycle: float
    lateness: float
    work: float
    pdo_age: float
    missed: float
    state: float  # code
    sigma: float
    friction_term: float
    friction_angle: float
    pretension: float
    estimate_state: float  # code
    limit_reason: float  # code
    tau_j_stretch: float
    tau_j_stretch_low: float
    tau_j_stretch_high: float
    tau_j_model: float
    tau_j_model_low: float
    tau_j_model_high: float


FIELD_NAMES: tuple[str, ...] = Record._fields
FIELDS: tuple[Column, ...] = tuple(BY_NAME[name] for name in FIELD_NAMES)
