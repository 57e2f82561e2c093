"""Third-party stacks: a drive on durand with this package's master, and the plant with python-canopen's BaseNode402."""

from __future__ import annotations

import time
from pathlib import Path

import canopen
import pytest
from canopen.profiles.p402 import BaseNode402

from tests.drives.rig import PERIOD, STILL, Foreign, Recording, running
from tests.plant.bench import plant_file
from tsa_ctrl.bus.drive.bring_up import bring_up
from tsa_ctrl.bus.drive.profile import DriveProfile
from tsa_ctrl.bus.live.rig import Rig, check_startup
from tsa_ctrl.bus.settings import AxisNodes, BusSettings, DriveSettings, SupervisionSettings
from tsa_ctrl.plant.process import eds_files
from tsa_ctrl.safety.supervisor import Supervisor

durand_drive = pytest.importorskip("tests.drives.durand_drive")

# The drive has no watchdog, so it is accepted only with require_watchdog = false.
AXIS = AxisNodes(name="knee", drive=DriveSettings(node_id=3, require_watchdog=False))


class OnDurand(Foreign):
    """The master of `Foreign` with a drive on durand."""

    def __init__(self) -> None:
        self.wire = Recording()
        self.durand = durand_drive.Durand(self.wire)
        self.settings = BusSettings(interface="virtual")
        self.profile = DriveProfile()
        self.axis = AXIS
        self.rig: Rig | None = None

    def start_up(self) -> None:
        bring_up(self.wire.host, self.settings, [self.axis], [self.profile], PERIOD)
        self.supervisor = Supervisor(SupervisionSettings(), reports_following=True, shows_late=False, rate=1000.0)
        self.rig = Rig(self.wire.host, self.settings, [self.axis], [self.profile])
        self.rig.start()
        check_startup(self.rig, PERIOD)


def test_a_drive_on_durand_comes_up_pulls_stops_and_comes_up_again() -> None:
    master = OnDurand()
    for _ in range(2):
        master.start_up()
        drive = master.durand.drive
        assert drive.get(0x6060) == 10
        assert [drive.get(0x1600, number) for number in (0, 1, 2)] == [2, 0x60400010, 0x60710010]
        master.enable(0.3)
        assert drive.get(0x6077) == 300
        assert master.rig is not None
        assert master.rig.axes[0].image.tau_m == pytest.approx(0.3)
        assert master.stop() == []
        assert (drive.get(0x6041), drive.get(0x6077)) == (0x0250, 0)


def test_a_master_on_python_canopen_enables_the_plant_and_pulls(tmp_path: Path) -> None:
    """BaseNode402 uses the EDS of `tsa plant --eds` for states, mode, target torque by SDO, fault and fault reset."""
    path = plant_file(tmp_path, f"[[axis]]\nname = 'joint'\n{STILL}")
    ((eds, content),) = eds_files(path, tmp_path / "drive.eds")
    eds.write_text(content, encoding="latin-1")
    network = canopen.Network()
    with running(path) as (channel, machine), network.connect(interface="virtual", channel=channel):
        node = BaseNode402(1, str(eds))
        network.add_node(node)
        node.sdo.RESPONSE_TIMEOUT = 2.0
        assert node.sdo[0x1018][1].raw == 0x0F0F
        node.nmt.state = "PRE-OPERATIONAL"
        node.setup_402_state_machine()
        node.nmt.state = "OPERATIONAL"
        _eventually(lambda: node.state == "SWITCH ON DISABLED")
        for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED"):
            node.state = state
            assert node.state == state
        node.sdo[0x6060].raw = 10
        assert node.sdo[0x6061].raw == 10
        node.sdo[0x6071].raw = 250
        drive = machine.axes[0].drive
        node.state = "OPERATION ENABLED"
        _eventually(lambda: abs(drive.command.torque - 0.25) < 1e-9)
        drive.fault(0x2310)
        _eventually(lambda: node.state == "FAULT")
        node.sdo[0x6040].raw = 0x00
        node.sdo[0x6040].raw = 0x80
        _eventually(lambda: node.state == "SWITCH ON DISABLED")
        assert drive.command.torque == 0.0


def _eventually(reached: object, seconds: float = 5.0) -> None:
    assert callable(reached)
    end = time.monotonic() + seconds
    while not reached():
        assert time.monotonic() < end
        time.sleep(0.01)
