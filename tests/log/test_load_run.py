"""Loading the part of a run between the fade-in and the stop, and errors for unusable runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.log.logs import HEADER, records
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.log.mcap_file import McapFile
from tsa_ctrl.log.table import load_run


def log_of(path: Path, tau_j: float = 1.0, torque_from: int = 1000, count: int = 4000) -> str:
    """Write a log at 1 kHz with torque from one cycle on. Return its path with the axis hip."""
    wanted = np.where(np.arange(count) >= torque_from, 0.5, 0.0)
    file = McapFile(path, HEADER)
    file.write([records(count, tau_j_des=wanted, tau_m_cmd=wanted, tau_j=tau_j, q_j=0.1), records(0)])
    file.finish()
    return f"{path}:hip"


def test_it_begins_after_the_fade_in_and_ends_before_the_stop(tmp_path: Path) -> None:
    found = load_run(log_of(tmp_path / "a.mcap"), ("q_j",), fade_in=0.2, seconds=2.0)
    assert found["t"][0] == pytest.approx(0.2, abs=1e-9)
    assert found["t"][-1] == pytest.approx(1.95, abs=1.1e-3)
    assert set(found) >= {"t", "tau_j_des", "tau_j", "q_j"}


def test_without_torque_the_cause_is_named(tmp_path: Path) -> None:
    with pytest.raises(BusError, match="contains no torque; stale PDO"):
        load_run(log_of(tmp_path / "a.mcap", torque_from=9999), (), 0.2, 2.0, cause="stale PDO")


def test_too_little_torque_is_said(tmp_path: Path) -> None:
    with pytest.raises(BusError, match="too few cycles with torque"):
        load_run(log_of(tmp_path / "a.mcap", torque_from=3900), (), 0.2, 2.0)


def test_a_sensor_that_sent_nothing_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="joint torque sensor sent no data"):
        load_run(log_of(tmp_path / "a.mcap", tau_j=np.nan), (), 0.2, 2.0)
