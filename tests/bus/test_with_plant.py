"""Test the master with the simulated drive, encoder and torque sensor in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.bus.nodes import axis_nodes
from tests.plant.bench import plant_file
from tsa_ctrl.bus.drive.bring_up import bring_up
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.live.rig import Rig, check_startup
from tsa_ctrl.bus.settings import BusSettings, SupervisionSettings
from tsa_ctrl.plant.machine import Machine
from tsa_ctrl.plant.settings import load_plant
from tsa_ctrl.safety.causes import Cause
from tsa_ctrl.safety.shut_down import shut_down
from tsa_ctrl.safety.supervisor import Phase, Request, Supervisor
from tsa_ctrl.virtual.lockstep import Wire

PERIOD = 0.004  # s


class Plant:
    """The plant on the other end of the bus. It sends nothing while its nodes are off."""

    def __init__(self, folder: Path) -> None:
        self.wire = Wire(bitrate=1e6)
        self.machine = Machine(load_plant(plant_file(folder)), self.wire.plant, self.wire.plant.clock)
        self.wire.attach(self.machine)
        self.start()

    def start(self) -> None:
        for node in self.machine.nodes:
            node.boot(self.wire.now)

    def kill(self) -> None:
        for node in self.machine.nodes:
            node.power_off()


class Master:
    """A loop without a control law."""

    def __init__(self, wire: Wire) -> None:
        self.settings = BusSettings()
        self.axes = [axis_nodes(rpdo_timeout=0.5, host_timeout=1.0)]
        self.profiles = [DriveProfile()]
        self.bus = wire.host
        self.supervisor = Supervisor(SupervisionSettings(tolerated_misses=25))
        self.configure()

    def configure(self) -> None:
        bring_up(self.bus, self.settings, self.axes, self.profiles, PERIOD)
        if not hasattr(self, "rig"):
            self.rig = Rig(self.bus, self.settings, self.axes, self.profiles)
            self.axis = self.rig.axes[0]
            self.begin = self.bus.clock()
        self.rig.start()
        check_startup(self.rig, PERIOD, 25)

    def cycle(self, request: Request, torque: float) -> None:
        self.begin = self.rig.wait(self.begin + PERIOD)
        self.rig.sync(self.begin)
        self.rig.collect(self.begin + 0.8 * PERIOD)
        controlword, permitted, _ = self.supervisor.update(self.axis.image, self.begin, request)
        self.axis.command(controlword, torque if permitted else 0.0)
        self.rig.heartbeat(self.begin)

    def run_until(
        self, reached: Callable[[], bool], request: Request, torque: float = 0.0, seconds: float = 10.0
    ) -> None:
        end = self.bus.clock() + seconds
        while not reached():
            assert self.bus.clock() < end, f"{self.supervisor.phase}: {self.supervisor.fault}"
            self.cycle(request, torque)

    def enable(self) -> None:
        for _ in range(3):
            self.cycle(Request.DISABLE, 0.0)
        self.run_until(lambda: self.supervisor.phase is Phase.ENABLED, Request.ENABLE)


@pytest.fixture
def plant(tmp_path: Path) -> Plant:
    return Plant(tmp_path)


@pytest.fixture
def master(plant: Plant) -> Iterator[Master]:
    made = Master(plant.wire)
    yield made
    shut_down(made.rig, PERIOD)


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
