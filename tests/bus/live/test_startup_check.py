"""Test the startup check: all nodes must answer at the configured rate before any torque is sent."""

from __future__ import annotations

import pytest

from tests.bus.nodes import Responder, one_axis_rig
from tsa_ctrl.bus.live.rig import check_startup
from tsa_ctrl.errors import BusError


def test_nodes_that_answer_each_sync_pass_and_get_no_command() -> None:
    rig, bus, _ = one_axis_rig()
    check_startup(rig, 0.001, 50)
    sent = [can_id for can_id, _ in bus.sent]
    assert (sent.count(0x080), sent.count(0x201)) == (50, 0)
    assert sent.count(0x77F) == 3  # the host heartbeat continues every 20 ms


@pytest.mark.parametrize(
    ("silent", "name"), [(0x181, "drive node 1"), (0x1A0, "joint encoder node 32"), (0x1C0, "torque sensor node 64")]
)
def test_node_that_does_not_answer_is_named(silent: int, name: str) -> None:
    nodes = Responder()
    nodes.silent = {silent}
    rig, _, _ = one_axis_rig(nodes)
    with pytest.raises(BusError, match=f"axis 'knee' {name}: answered 0 of 50 SYNCs"):
        check_startup(rig, 0.001, 50)


def test_node_that_answers_twice_is_refused() -> None:
    rig, bus, nodes = one_axis_rig()
    bus.answer = lambda frame: nodes.frames() * 2 if frame[0] == 0x080 else []
    with pytest.raises(BusError, match="more PDOs than 50 SYNCs requested; another node may have the same id"):
        check_startup(rig, 0.001, 50)


def test_node_that_stops_at_the_end_is_refused() -> None:
    rig, bus, nodes = one_axis_rig()
    answered = []

    def answer(frame: tuple[int, bytes]) -> list[tuple[int, bytes]]:
        if frame[0] != 0x080:
            return []
        answered.append(frame)
        return nodes.frames() if len(answered) < 45 else []

    bus.answer = answer
    with pytest.raises(BusError, match="answered 44 of 50"):
        check_startup(rig, 0.001, 50)


def test_what_was_missed_before_is_forgiven() -> None:
    rig, bus, nodes = one_axis_rig()
    nodes.silent = {0x181}
    for _ in range(300):
        rig.sync()
        rig.collect(bus.clock.now + 0.0006)
    nodes.silent = set()
    rig.start()
    check_startup(rig, 0.001, 50)
