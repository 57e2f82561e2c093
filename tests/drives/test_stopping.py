"""A stop request during bring-up ends it at once and leaves no watchdog armed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.drives.rig import PERIOD, Foreign
from tsa_ctrl.bus.drive.bring_up import bring_up
from tsa_ctrl.bus.settings import AxisNodes, DriveSettings
from tsa_ctrl.errors import StoppedError

RPDO, NMT, SYNC = 0x201, 0x000, 0x080
AT_ONCE = 0.1  # s of bus time


def stopped_at(foreign: Foreign, when: Callable[[str], bool], **drive: object) -> float:
    """Request a stop during bring-up, 20 ms after the stage that `when` selects.

    Return the time (s) from the request until bring-up has ended.
    """
    asked = [float("inf")]

    def tell(stage: str) -> None:
        if when(stage):
            asked[0] = min(asked[0], foreign.wire.now + 0.02)

    axis = AxisNodes(name="knee", drive=DriveSettings(node_id=1, **drive))  # type: ignore[arg-type]
    with pytest.raises(StoppedError, match=r"^tsa stop$"):
        bring_up(
            foreign.wire.host,
            foreign.settings,
            [axis],
            [foreign.profile],
            PERIOD,
            tell=tell,
            stopped=lambda: "tsa stop" if foreign.wire.now >= asked[0] else None,
        )
    return foreign.wire.now - asked[0]


def test_a_slow_boot_is_not_waited_for(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "boot_time = 30.0")
    foreign.wait(31.0)
    foreign.wire.sent.clear()
    took = stopped_at(foreign, lambda stage: stage.startswith("waiting for the boot-up"), boot_timeout=60.0)
    assert took < 4 * 0.5  # the last requests to a silent node: three time-outs of 0.5 s
    assert foreign.sent(RPDO, SYNC) == []
    assert foreign.sent(NMT)[0] == (NMT, b"\x82\x01")
    assert foreign.sent(NMT)[-1][1][0] in (0x02, 0x80)


def test_a_drive_that_was_half_configured_is_left_unarmed(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path, "watches_always = true", "answer_time = 0.004")
    assert stopped_at(foreign, lambda stage: stage.startswith("configuring")) < AT_ONCE
    assert foreign.sent(RPDO, SYNC) == []
    assert foreign.sent(NMT)[-1] == (NMT, b"\x80\x01")
    assert foreign.node.values[0x1016, 1] & 0xFFFF == 0
    foreign.wait(1.0)
    assert foreign.drive.machine.state.name == "SWITCH_ON_DISABLED"
    foreign.start()


def test_before_anything_was_sent_nothing_is(tmp_path: Path) -> None:
    foreign = Foreign(tmp_path)
    assert stopped_at(foreign, lambda stage: stage.startswith("listening")) < AT_ONCE
    assert foreign.sent() == []
