"""Test the whole loop on serial lines, with drive and encoder behind a serial CAN adapter, and a load cell."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from tests.sensors.adapters import AdapterPair
from tests.sensors.lines import Line
from tsa_ctrl.demo import rig
from tsa_ctrl.demo.outcome import course_of
from tsa_ctrl.demo.rig import BusChoice, gait
from tsa_ctrl.identify.dataset import load_log
from tsa_ctrl.log.table import read_table
from tsa_ctrl.system.process_supervisor import daemon, plant

RATE = 100.0  # Hz; ten frames per cycle pass two Python processes
SECONDS = 6.0
LOAD_CELL = """
[[axis.serial]]
quantity = "t1"
port = "{port}"
pattern = '^(?P<value>\\S+) (?P<unit>\\w+)$'
unit = "kgf"
scale = 9.80665
rate = 20
timeout = 2.0
"""


@pytest.mark.hil
@pytest.mark.slow
def test_torque_is_controlled_and_a_load_cell_is_logged_over_pseudo_terminals(tmp_path: Path) -> None:
    cell = Line(tmp_path / "cell")
    end = threading.Event()

    def send() -> None:
        while not end.wait(0.05):
            cell.send(b"4.5 kgf\r\n")

    thread = threading.Thread(target=send)
    with AdapterPair() as (ours, theirs):
        tables = rig.controller(BusChoice("slcan", ours), "with", RATE, "nominal.toml", 0.95)
        rig.write(tmp_path, gait(), rig.plant(BusChoice("slcan", theirs), "full"), {"with": tables})
        controller = tmp_path / "controller-with.toml"
        controller.write_text(controller.read_text() + LOAD_CELL.format(port=cell.path))
        thread.start()
        try:
            with plant(tmp_path):
                summary = daemon(tmp_path, "with", SECONDS, lambda share: None)
        finally:
            end.set()
            thread.join()
            cell.unplug()
    assert not summary["failed"]
    course = course_of(tmp_path, summary, SECONDS)
    columns = read_table(course.log).columns
    ratio = rig.NOMINAL.joint_pulley_radius / rig.NOMINAL.motor_pulley_radius
    friction = ratio * float(np.sqrt(np.nanmean(np.square(columns["friction_term"]))))  # the error without compensation
    assert course.rms < 0.6 * friction
    t1 = columns["t1"]
    assert np.nanmax(t1) == np.nanmin(t1) == pytest.approx(4.5 * 9.80665)
    assert np.mean(np.isfinite(t1)) > 0.9
    assert load_log(course.log).rate == pytest.approx(RATE)
