"""Test a fault of one of two axes, and a recovery while the other one still ramps down."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.virtual.files import Tables, controller, merged, plant, write
from tsa_ctrl import simulate_loop
from tsa_ctrl.config import load_configuration
from tsa_ctrl.errors import UsageError
from tsa_ctrl.virtual.result import Simulation

FAULT = 0.8  # s


def pair(tables: Tables) -> Tables:
    """Return the tables with a second axis, whose node ids are one higher."""
    (first,) = tables["axis"]
    nodes = {"drive": {"node_id": 2, "serial_number": 2}, "encoder": {"node_id": 33}, "torque_sensor": {"node_id": 65}}
    return tables | {"axis": [first, merged(first, {"name": "hip", **nodes})]}


def play(folder: Path, fault: str, recovery: float, seconds: float = 2.5) -> Simulation:
    still = {"joint": {"load": "held"}}
    # the RPDO timer of the drive is long, so that it does not stop the torque
    axis = {"setpoint": {"kind": "constant", "offset": 0.5}, "drive": {"rpdo_timeout": 0.5, "serial_number": 1}}
    slower = {"controller": {"rate": 500.0}}
    files = write(folder, pair(controller(file=slower, **axis)), pair(plant(**still)))
    return simulate_loop(*files, seconds, faults=[f"{fault}@{FAULT}"], changes=[f"recover=1@{recovery}"])


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["emcy", "heartbeat_lost duration=0.4"], ids=["reset", "bring-up"])
def test_a_recovery_waits_until_every_axis_has_ended_its_ramp(tmp_path: Path, fault: str) -> None:
    """The reset waits until the other drive is confirmed off. Then both axes have torque again."""
    result = play(tmp_path, fault, FAULT + (0.25 if "lost" in fault else 0.1), 4.0)
    first, other = result.axes
    start = other.truth["clock"] - other.start
    begin = next(event.t for event in result.summary.events if event.fault)
    torque = np.abs(other.truth["tau_m"])
    ramp = (start > begin + 0.01) & (start < begin + 0.28)
    assert (np.abs(np.diff(torque[ramp])) < 0.02).all()  # the torque follows the ramp without a step to 0
    assert (torque[(start > begin + 0.14) & (start < begin + 0.16)] > 0.1).all()
    assert torque[(start > begin + 0.29) & (start < begin + 0.33)].min() < 0.01
    assert result.axes[0].faults
    for axis in (first, other):
        assert axis.truth["enabled"][-1] == 0.0
        assert axis.log["tau_m_cmd"][(axis.log["t"] > 3.0) & (axis.log["t"] < 3.8)].min() > 0.2


def test_the_promise_counts_the_ramp_of_the_other_axes(tmp_path: Path) -> None:
    slower = {"controller": {"rate": 500.0, "stop_time": 0.4}}
    one, two = controller(file=slower), pair(controller(file=slower, drive={"serial_number": 1}))
    promised = [load_configuration(write(tmp_path, tables)[0]).zero_torque_within for tables in (one, two)]
    assert promised == pytest.approx([0.25, 0.65])
    two["safety"] = {"zero_torque_within": 0.6}
    with pytest.raises(
        UsageError, match=r"zero_torque_within 0.6 s is not above .* plus \[controller\] stop_time = 0.4"
    ):
        load_configuration(write(tmp_path, two)[0])
