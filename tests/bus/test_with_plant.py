"""The master against the simulated drive, encoder and torque sensor: another process, on a real vcan."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.bus.nodes import axis_nodes
from tsa_ctrl.bus.drive.bring_up import bring_up
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.live.prove import prove
from tsa_ctrl.bus.live.rig import Rig
from tsa_ctrl.bus.settings import BusSettings, SupervisionSettings
from tsa_ctrl.bus.wire.connect import open_bus
from tsa_ctrl.safety.shut_down import shut_down
from tsa_ctrl.safety.supervisor import Cause, Phase, Request, Supervisor

pytestmark = [pytest.mark.vcan, pytest.mark.hil]

ROOT = Path(__file__).parents[2]
PERIOD = 0.004  # s; a test machine may be slow
START = 120.0  # s; the plant's first start on a machine compiles


class Plant:
    """The plant's process; `restart` is a power cycle of all its nodes."""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        command = [sys.executable, "-m", "tsa_ctrl", "plant", "config/plant.toml"]
        self.process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        end = time.monotonic() + START
        while "ready" not in self.process.stdout.readline():
            assert self.process.poll() is None, "the plant ended"
            assert time.monotonic() < end

    def restart(self) -> None:
        self.kill()
        self.start()

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()


class Master:
    """A loop without a control law."""

    def __init__(self, channel: str) -> None:
        self.settings = BusSettings(channel=channel)
        self.axes = [axis_nodes(rpdo_timeout=0.5, host_timeout=1.0)]
        self.profiles = [DriveProfile()]
        self.bus = open_bus(self.settings)
        self.supervisor = Supervisor(SupervisionSettings(tolerated_misses=25))
        self.configure()

    def configure(self) -> None:
        bring_up(self.bus, self.settings, self.axes, self.profiles, PERIOD)
        if not hasattr(self, "rig"):
            self.rig = Rig(self.bus, self.settings, self.axes, self.profiles)
            self.axis = self.rig.axes[0]
            self.begin = time.monotonic()
        self.rig.start()
        prove(self.rig, PERIOD, 25)

    def cycle(self, request: Request, torque: float) -> None:
        self.begin = self.rig.wait(max(self.begin + PERIOD, time.monotonic()))
        self.rig.sync(self.begin)
        self.rig.collect(self.begin + 0.8 * PERIOD)
        controlword, permitted, _ = self.supervisor.update(self.axis.image, self.begin, request)
        self.axis.command(controlword, torque if permitted else 0.0)
        self.rig.heartbeat(self.begin)

    def run_until(
        self, reached: Callable[[], bool], request: Request, torque: float = 0.0, seconds: float = 10.0
    ) -> None:
        end = time.monotonic() + seconds
        while not reached():
            assert time.monotonic() < end, f"{self.supervisor.phase}: {self.supervisor.fault}"
            self.cycle(request, torque)

    def enable(self) -> None:
        for _ in range(3):
            self.cycle(Request.DISABLE, 0.0)
        self.run_until(lambda: self.supervisor.phase is Phase.ENABLED, Request.ENABLE)


@pytest.fixture
def plant() -> Iterator[Plant]:
    made = Plant()
    yield made
    made.kill()


@pytest.fixture
def master(plant: Plant, vcan: str) -> Iterator[Master]:
    made = Master(vcan)
    yield made
    shut_down(made.rig, PERIOD)
    made.bus.close()


def test_torque_goes_out_comes_back_and_ends(master: Master) -> None:
    master.enable()
    image = master.axis.image
    master.run_until(lambda: abs(image.tau_m - 0.08) < 0.01, Request.ENABLE, torque=0.08)
    master.run_until(lambda: abs(image.tau_m) < 0.01, Request.ENABLE)
    master.run_until(lambda: master.supervisor.phase is Phase.STANDBY, Request.DISABLE)
    assert shut_down(master.rig, PERIOD) == []


def test_power_cycle_latches_and_only_a_bring_up_with_a_reset_leads_back(master: Master, plant: Plant) -> None:
    master.enable()
    plant.kill()
    master.run_until(lambda: master.supervisor.phase is Phase.FAULT, Request.ENABLE, torque=0.05)
    plant.start()
    master.begin = time.monotonic()
    master.run_until(lambda: master.supervisor.needs_bring_up, Request.ENABLE, torque=0.05)
    assert {fault.cause for fault in master.supervisor.faults} & {Cause.HEARTBEAT_LOST, Cause.BOOT_UP}
    for _ in range(20):
        master.cycle(Request.RESET, 0.05)
    assert master.supervisor.phase is Phase.FAULT
    master.configure()
    master.supervisor.configured(master.axis.image)
    master.cycle(Request.DISABLE, 0.0)
    master.run_until(lambda: master.supervisor.phase is Phase.STANDBY, Request.RESET)
    master.enable()
