"""Too many missed commands within a second end the torque. Another module counts them."""

from __future__ import annotations

from tsa_ctrl.bus.live.read_back import CommandReadback
from tsa_ctrl.safety.causes import Cause, Finding
from tsa_ctrl.safety.lost_commands import LostCommands


def play(check: LostCommands, readback: CommandReadback, every: int, cycles: int = 2000) -> int | None:
    """Return the cycle of 1 ms in which lost commands are detected, or None if they are not.

    One command is missed in every `every` cycles.
    """
    for cycle in range(1, cycles):
        readback.asked += 1
        readback.outdated += cycle % every == 0
        if check.update(cycle * 1e-3) is not None:
            return cycle
    return None


def test_as_many_as_are_too_many_within_a_second_are_found_and_one_fewer_is_not() -> None:
    readback = CommandReadback()
    check = LostCommands(readback, "drive node 1")
    readback.begin(5)
    assert play(check, readback, 250) == 1250
    check.reset()
    assert play(check, readback, 251) is None


def test_a_reset_forgets_what_was_and_what_came_meanwhile() -> None:
    readback = CommandReadback()
    readback.begin(3)
    check = LostCommands(readback, "drive node 1")
    play(check, readback, 10, 21)
    readback.outdated += 100
    check.reset()
    assert play(check, readback, 10, 21) is None


def test_it_says_which_drive_how_often_and_what_to_do() -> None:
    readback = CommandReadback()
    readback.begin(1)
    check = LostCommands(readback, "drive node 1")
    readback.asked, readback.outdated = 48, 9
    said = check.update(0.0)
    detail = "drive node 1 held an older command 9 of 48 times that 0x6071 was read back, 1 within a second"
    assert said == Finding(Cause.COMMANDS_MISSED, detail)
