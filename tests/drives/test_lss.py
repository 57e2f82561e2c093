"""`tsa drive set-node-id` sets the id of a single unconfigured node by LSS, and rejects a bus with two of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.drives.rig import Foreign, refused
from tsa_ctrl.bus.drive import lss

UNSET = "node_id_unset = true"


@pytest.mark.slow
def test_a_drive_without_an_id_is_given_one_that_it_keeps(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, UNSET, "serial_number = 77")
    found = lss.set_node_id(foreign.wire.host, 5)
    assert (found.node_id, found.identity["serial number"]) == (None, 77)
    assert foreign.node.node_id == 5
    assert foreign.node.lss is not None
    assert foreign.node.lss.stored == 5
    assert foreign.node.storage.saves == 0
    assert {can_id for can_id, _ in foreign.sent()} == {0x7E5}
    assert foreign.node.values[0x1014, 0] == 0x85


def test_a_bus_without_such_a_node_is_told(tmp_path: Path) -> None:
    with refused("no node answers to LSS; check power, wiring and bit rate"):
        lss.find(Foreign(tmp_path).wire.host)


def test_two_nodes_are_refused_before_either_takes_the_id(tmp_path: Path) -> None:
    axes = "".join(
        f"[[axis]]\nname = '{name}'\nmotion.kind = 'still'\ndrive.{UNSET}\n"
        f"drive.serial_number = {serial}\nencoder.present = false\ntorque_sensor.present = false\n"
        for serial, name in enumerate("ab", 1)
    )
    foreign = Foreign(tmp_path, text=axes)
    with refused("more than one node answers to LSS; leave only this drive on the bus"):
        lss.set_node_id(foreign.wire.host, 5)
    assert [frame for frame in foreign.sent() if frame[1][0] in (0x11, 0x17)] == []


def test_a_bus_that_somebody_leads_is_left_alone(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, UNSET)
    foreign.wire.at(foreign.wire.now + 0.01, lambda now: foreign.wire.host.arrived(0x080, b""))
    with refused("other nodes are active (heard 0x080)", "leave only this drive on the bus"):
        lss.set_node_id(foreign.wire.host, 5)
    assert foreign.sent() == []
