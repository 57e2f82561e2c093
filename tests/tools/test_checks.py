"""bench/checks: what is wrong is wrong there, times count from it, and work beyond the set-point's is summed up."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tools.bench.checks import AT, FAULTS, Wrong, cell, file_of, judged, trial
from tsa_ctrl.daemon.events import Event
from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.safety.limiter import Reason
from tsa_ctrl.virtual.result import AxisResult


def test_only_what_is_wrong_differs_from_the_truth() -> None:
    right, short = file_of(Wrong("clear"), False), file_of(Wrong(lever=2.0), False)
    assert right.pretension_slope == pytest.approx(NOMINAL.pretension_slope)
    assert short.pretension_slope == pytest.approx(NOMINAL.pretension_slope / 2.0)
    assert (short.tendon_stiffness, short.pretension) == (NOMINAL.tendon_stiffness, NOMINAL.pretension)
    assert file_of(Wrong("clear"), True).axial_stiffness_uncertainty < NOMINAL.axial_stiffness_uncertainty
    assert all(file_of(wrong, False).lever > NOMINAL.diameter / 2.0 for wrong in FAULTS.values())


def made_up(fault_at: float | None) -> AxisResult:
    """2 s in which the joint turns at 2 rad/s and is given 0.1 N*m too much from 1.2 s on; the motor gives 0.5 N*m."""
    t = np.arange(0.0, 2.0, 1e-3)
    reason = np.where(t < 0.1, Reason.DISABLED.value, 0.0)
    motor = np.full(t.shape, 0.5)
    if fault_at is not None:
        motor[t > fault_at + 0.0105] = 0.0
    log = {"t": t, "limit_reason": reason, "tau_j_des": np.zeros_like(t)}
    truth = {"clock": t + 5.0, "tau_m": motor, "tau_j": 0.1 * (t >= 1.2), "omega_j": np.full(t.shape, 2.0)}
    return AxisResult("joint", log, truth, 5.0, 0.0, 1.9, ())


def test_times_and_work_count_from_the_fault_until_the_torque_is_off() -> None:
    events = [Event(0, 0.5, "joint", "before", False), Event(1, 1.3, "joint", "weak", False)]
    found = judged(made_up(None), events, AT)
    assert (found["words"], found["off"]) == ("weak", None)
    assert found["told"] == pytest.approx(0.3, abs=2e-3)
    assert found["given"] == pytest.approx(1e3 * 0.1 * 2.0 * 0.7, rel=0.01)
    assert found["given_until_told"] == pytest.approx(1e3 * 0.1 * 2.0 * 0.1, rel=0.02)
    found = judged(made_up(1.4), [*events, Event(2, 1.4, "joint", "latched", True)], AT)
    assert (found["words"], found["told"]) == ("latched", pytest.approx(0.3, abs=2e-3))
    assert found["off"] == pytest.approx(0.411, abs=2e-3)
    assert found["given"] == pytest.approx(1e3 * 0.1 * 2.0 * 0.211, rel=0.02)
    assert cell(found) == "0.30 / 0.41; 42"


def test_what_is_wrong_from_the_first_torque_on_counts_from_there() -> None:
    found = judged(made_up(None), [Event(0, 0.5, "joint", "stretch", False)], FAULTS["k_t half of the file's"].at)
    assert found["told"] == pytest.approx(0.4, abs=2e-3)
    assert FAULTS["the same, lever twice the file's"].at == AT


@pytest.mark.slow
@pytest.mark.parametrize("sensors", ["encoder", "sensor"])
def test_a_zero_that_jumps_is_told_and_ends_the_torque(sensors: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Told in the next cycle, and the joint has got next to nothing by then."""
    name = "joint encoder's zero jumps by 0.1 rad"
    monkeypatch.setitem(FAULTS, name, dataclasses.replace(FAULTS[name], after=0.1))
    row = trial(name, "weight", sensors)
    assert row["told"] < 0.005
    assert row["told"] < row["off"] < 0.02
    assert row["given"] < 1.0


@pytest.mark.slow
def test_a_stiffness_that_is_not_the_files_is_told_without_a_torque_sensor(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tendons half as stiff: the term is taken back before the joint got the guard's 3 mJ and a period more."""
    name = "k_t half of the file's"
    monkeypatch.setitem(FAULTS, name, dataclasses.replace(FAULTS[name], after=0.3))
    row = trial(name, "weight")
    assert row["told"] is not None
    assert row["given"] < 3.2
