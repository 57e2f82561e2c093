"""The record of one cycle of one axis: what the loop leaves for the log, by name."""

from __future__ import annotations

from typing import NamedTuple

from tsa_ctrl.log.columns import BY_NAME, Column


class Record(NamedTuple):
    """One row of the daemon's log, units and meanings as in `columns`; all are stored as float64, nan is not there."""

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
