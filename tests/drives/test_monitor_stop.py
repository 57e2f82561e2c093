"""The monitor's stop disables a drive on a third-party CANopen stack, even if the drive ignores NMT."""

from __future__ import annotations

import pytest

from tests.drives.test_third_parties import OnDurand
from tests.monitor.healthy import watched
from tsa_ctrl.safety.supervisor import Request
from tsa_ctrl.virtual.lockstep import End
from tsa_ctrl.virtual.simulation import VirtualMonitor

pytest.importorskip("durand")


@pytest.mark.parametrize("hears_nmt", [True, False])
def test_a_drive_on_durand_gives_no_torque_after_the_stop(hears_nmt: bool) -> None:
    master = OnDurand()
    master.start_up()
    numbers = {"node_id": 3, "encoder_id": None, "silence": 0.05}
    monitor = VirtualMonitor(master.wire, watched(**numbers, period=0.002, nodes=(3,)))
    master.enable(0.3)
    drive = master.durand.drive
    assert drive.get(0x6077) == 300
    assert monitor.monitor.stop is None
    if not hears_nmt:
        master.durand.remove_subscription(0)
    intruder = End(master.wire)
    master.wire.send(intruder, 0x7E5, b"\x04\x01" + bytes(6))
    master.cycle(Request.ENABLE, 0.3, cycles=25)
    assert monitor.monitor.stop is not None
    assert monitor.monitor.stop.id == "lss"
    assert (drive.get(0x6041), drive.get(0x6077)) == (0x0250, 0)
    assert monitor.report.confirmed
