"""The course of one run of the daemon: what its log holds between the fade-in and the stop."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.log.table import read_table

STOP_MARGIN = 0.05  # s before the end of a run: the stop may have begun
STRETCH = "tau_j_stretch"
LEAST_CYCLES = 100  # with torque: less shows nothing


def read_course(
    log: str | Path,
    names: Collection[str],
    fade_in: float,
    seconds: float,
    cause: str = "",
    by_stretch: bool = False,
) -> dict[str, NDArray[np.float64]]:
    """Columns `names` of an axis, `t` in s since the enable, and tau_j_des, tau_j; `seconds` of torque after `fade_in`.

    Cycles that were lost, or without joint torque, are just not there. Raises BusError when it holds too little torque
    (`cause`: why the run ended), UsageError when the joint torque sensor sent nothing. `by_stretch`: tau_j is that of
    the tendons' stretch, for a rig without the sensor.
    """
    columns = read_table(
        log, {"t", "tau_j_des", "tau_m_cmd", "tau_j", *([STRETCH] if by_stretch else []), *names}
    ).columns
    if by_stretch:
        columns = {**columns, "tau_j": columns.get(STRETCH, np.full(len(columns["t"]), np.nan))}
        if not np.isfinite(columns["tau_j"]).any():
            raise BusError(f"{log}: the tendons' stretch told no joint torque; see the run's events")
    t = columns["t"]
    active = np.flatnonzero((columns["tau_j_des"] != 0.0) | (columns["tau_m_cmd"] != 0.0))
    if not active.size:
        raise BusError(f"{log}: holds no torque" + (f"; {cause}" if cause else "; look into the log"))
    known = np.isfinite(columns.get("tau_j", np.full(len(t), np.nan)))
    if not known.any():
        raise UsageError(f"{log}: the joint torque sensor sent nothing; check [axis.torque_sensor] or its line")
    enabled = float(t[active[0]])
    chosen = (t >= enabled + fade_in) & (t <= enabled + seconds - STOP_MARGIN) & known
    if np.count_nonzero(chosen) < LEAST_CYCLES:
        raise BusError(f"{log}: holds too little torque" + (f"; {cause}" if cause else "; look into the log"))
    part = {name: values[chosen] for name, values in columns.items()}
    return {**part, "t": part["t"] - enabled}
