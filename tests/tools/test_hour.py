"""The log of an hour: a minute again and again, without a jump where it begins anew."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tools.bench.hour import repeated, write_log
from tsa_ctrl.log.table import read_table


def minute() -> dict[str, np.ndarray]:
    t = np.arange(60_000) / 1000.0
    angle = np.sin(2.1 * t) + 0.6 * np.sin(0.83 * t)
    velocity = 2.1 * np.cos(2.1 * t) + 0.498 * np.cos(0.83 * t)
    return {"t": t, "q_j": angle, "omega_j": velocity, "tau_m": np.sign(velocity) + 0.1 * angle}


def test_nothing_jumps_where_it_begins_anew() -> None:
    whole = repeated(minute(), 200.0)
    assert len(whole["t"]) == 200_000
    assert float(np.max(np.abs(np.diff(whole["t"]) - 1e-3))) < 1e-9
    for name in ("q_j", "omega_j"):
        step = float(np.max(np.abs(np.diff(minute()[name]))))
        assert float(np.max(np.abs(np.diff(whole[name])))) < 5.0 * step < 0.1 * float(np.ptp(whole[name]))


def test_the_daemons_log_of_it_holds_the_same(tmp_path: Path) -> None:
    whole = repeated(minute(), 61.5)
    write_log(tmp_path / "log.mcap", whole)
    table = read_table(tmp_path / "log.mcap")
    assert table.recorded
    for name, values in whole.items():
        np.testing.assert_array_equal(table.columns[name], values)
