"""bench/bending and bench/trend: errors of the two steps that are meant, false alarms counted of what only scatters."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tools.bench.bending import FOLLOWED, SECONDS, TIGHTER, error, report, tensioned
from tools.bench.trend import DAYS, WEAR, cells, false_alarms
from tsa_ctrl.demo.motion import PERIOD
from tsa_ctrl.demo.rig import NOMINAL
from tsa_ctrl.identify.quantity import Quantity
from tsa_ctrl.identify.trend import Run, judged
from tsa_ctrl.safety.limiter import Reason
from tsa_ctrl.virtual.result import AxisResult


def axis(until: float) -> AxisResult:
    """10 mN*m too much, and 30 from `FOLLOWED` on; the torque ends at `until`."""
    t = np.arange(0.0, SECONDS, 1e-3)
    reason = np.where(t < until, 0.0, Reason.DISABLED.value)
    wrong = np.where(t < FOLLOWED, 0.01, 0.03)
    log = {"t": t, "lateness": 0.0 * t, "limit_reason": reason, "tau_j_des": 0.0 * t}
    return AxisResult("joint", log, {"clock": t, "tau_j": wrong}, 0.0, 0.1, SECONDS, ())


def test_the_error_is_that_of_two_steps_and_none_where_the_torque_ended() -> None:
    assert error(axis(SECONDS), FOLLOWED) == pytest.approx(30.0)
    assert error(axis(SECONDS), FOLLOWED - 2 * PERIOD) == pytest.approx(10.0)
    assert math.isnan(error(axis(FOLLOWED + 1.0), FOLLOWED))


def test_the_path_gets_longer_as_is_said() -> None:
    model = tensioned(NOMINAL, 0.4)
    rise = model.pretension_slope * 0.4 * model.bending_angle
    assert rise == pytest.approx(TIGHTER * model.pretension)


def test_the_last_column_is_the_stretchs_error_over_the_sensors(capsys: pytest.CaptureFixture[str]) -> None:
    rows = [
        {
            "rig": n,
            "centre": 0.5,
            "sensor_before": 5.0,
            "stretch_before": 6.0,
            "sensor": 10.0,
            "stretch": s,
            "faults": [],
        }
        for n, s in enumerate((9.0, 12.0, 20.0))
    ]
    report(rows)
    lines = capsys.readouterr().out.splitlines()
    last = {line.split()[1]: line.split()[-2] for line in lines if line.count("│") > 3}
    assert (last["1"], last["median"], last["worst"]) == ("1.20", "1.20", "2.00")


def runs(values: np.ndarray) -> list[Run]:
    return [
        Run(f"day{n}.mcap", str(n), math.nan, {"axial_stiffness": Quantity(v, v, v, "N")})
        for n, v in enumerate(values.tolist())
    ]


def test_days_of_two_kinds_give_alarms_and_days_that_scatter_next_to_none() -> None:
    rng = np.random.default_rng(4)
    told, of = false_alarms(runs(6e4 * (1.0 + 0.1 * rng.standard_normal(20))), 100)
    assert (of, told <= 6) == (100, True)
    told, _ = false_alarms(runs(6e4 * (1.0 + 0.5 * (np.arange(DAYS + 1) > 0)) + rng.standard_normal(DAYS + 1)), 100)
    assert told == 0  # one day alone is no lasting change
    (change,) = judged(runs(np.array([1.0, 1.001, 1.002, 1.0, 1.001, 0.8, 0.801, 0.8]))).changes
    assert cells(change)[:2] == ("axial stiffness", "day5")
    assert not WEAR["nothing"]
