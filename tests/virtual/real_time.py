"""Run the same files as processes on a vcan in real time, and in virtual time with the same wake-up times.

Torque noise and sensor noise are off, so that the runs differ in timing only. On a shared machine the loop wakes late,
skips cycles and loses answers, and the daemon's log records this. The lockstep run wakes at the same times, and loses
the answers of the same cycles.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.virtual.files import Tables, controller, plant, write
from tsa_ctrl.config import load_configuration
from tsa_ctrl.errors import BusError
from tsa_ctrl.log.table import read_table
from tsa_ctrl.plant.process import check
from tsa_ctrl.system.process_supervisor import daemon
from tsa_ctrl.system.process_supervisor import plant as plant_process
from tsa_ctrl.virtual.result import Simulation
from tsa_ctrl.virtual.simulation import Run

SECONDS = 4.0  # two periods of the set-point
FADED_IN = 0.3  # s, end of the fade-in
TIMES = np.arange(FADED_IN, SECONDS - 0.1, 1e-3)  # s since the enable, at which torques are compared
TRIES = 4  # for a machine that is too busy for the nodes to answer at startup
PATIENT: dict[str, Any] = {
    "drive": {"rpdo_timeout": 1.0, "host_timeout": 2.0, "heartbeat_timeout": 4.0},
    "encoder": {"heartbeat_timeout": 4.0},
    "torque_sensor": {"heartbeat_timeout": 4.0},
}
LOADS: dict[str, Tables] = {
    "imposed": {"joint": {"load": "imposed"}},
    "held": {"joint": {"load": "held"}},
    "spring": {"joint": {"load": "spring", "stiffness": 2.0}},
}

FloatArray = NDArray[np.float64]


def files(folder: Path, vcan: str, load: str, rate: float) -> tuple[Path, Path]:
    """Write controller and plant for both runs."""
    tables = controller(
        **PATIENT,
        setpoint={"kind": "sine", "amplitude": 1.0, "frequency": 0.5},
        file={
            "controller": {"rate": rate, "after_fault": "exit"},
            "bus": {
                "channel": vcan,
                "supervision": {"tolerated_misses": 100, "tolerated_drops": 100, "lost_share": 1.0},
            },
            "realtime": {"allow_without": True},
            "log": {"folder": "."},
            "socket": {"path": "tsa.sock"},
        },
    )
    quiet = {"drive": {"torque_noise": 0.0}, "torque_sensor": {"noise": 0.0}, "tendon": {"kind": "distributed"}}
    paths = write(folder, tables, {"bus": {"channel": vcan}, **plant(**quiet, **LOADS[load])})
    (folder / "controller-run.toml").write_text(paths[0].read_text(encoding="utf-8"), encoding="utf-8")
    return paths


def in_real_time(folder: Path) -> tuple[Any, dict[str, FloatArray]]:
    """Run plant and daemon as processes on the vcan, and return the plant's truth and the daemon's log.

    Raises:

    BusError: The machine is too busy for the nodes to answer at startup.
    """
    found: BusError | None = None
    for _ in range(TRIES):
        try:
            with plant_process(folder, "truth.csv"):
                summary = daemon(folder, "run", SECONDS, lambda share: None)
        except BusError as error:
            found = error
            continue
        truth = np.genfromtxt(folder / "truth.csv", delimiter=",", names=True)
        return truth, read_table(folder / str(summary["log"])).columns
    assert found is not None
    raise found


def woken_as(log: dict[str, FloatArray], paths: tuple[Path, Path], rate: float) -> Simulation:
    """Run in virtual time with the wake-up times and the lost answers of `log`."""
    run = Run(load_configuration(paths[0]), check(paths[1]), SECONDS)
    wait, faults = run.rig.wait, run.machine.axes[0].transmit.values()
    cycle = 0

    def waiting(until: float) -> float:
        nonlocal cycle
        if not run.loop.start:
            return wait(until)
        while cycle < log["t"].size and log["t"][cycle] < until - run.loop.start - 0.5 / rate:
            cycle += 1
        if cycle == log["t"].size:
            return wait(until)
        for each in faults:
            each.loss = float(log["pdo_age"][cycle] > 0.0)
        awake = run.loop.start + log["t"][cycle] + log["lateness"][cycle]
        cycle += 1
        return wait(max(until, awake))

    run.rig.wait = waiting  # type: ignore[method-assign]
    try:
        return run.play([], [], lambda share: None)
    finally:
        run.close()


def torque_since_enable(truth: Any) -> FloatArray:
    """Return the delivered torque (N*m) at `TIMES`."""
    begin = int(np.argmax(truth["enabled"] > 0.0))
    return np.interp(TIMES, truth["t"] - truth["t"][begin], truth["tau_j"])


def in_time(log: dict[str, FloatArray], rate: float) -> float:
    """Return the share of the cycles that were on time and had all answers, 1."""
    return 1.0 - float(np.mean((log["pdo_age"] > 0.0) | (log["lateness"] > 0.1 / rate)))
