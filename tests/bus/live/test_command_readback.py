"""Test the detection of commands that a drive did not receive, from its stored value and the sent commands."""

from __future__ import annotations

import itertools
import random
from collections.abc import Iterator

import pytest

from tsa_ctrl.bus.live.read_back import CommandReadback

CYCLES = 2000


def play(
    readback: CommandReadback, commands: Iterator[int], hears: int, lag: int = 1, wait: int = 0, trembles: int = 0
) -> float:
    """Return the share of commands counted as lost.

    The drive receives every `hears`-th command, and its stored value follows `lag` cycles later. This value is read
    every 20 or 21 cycles. The answer comes after `wait` cycles and may be up to `trembles` cycles older.
    """
    late = random.Random(1)
    before = readback.asked, readback.outdated
    shown = [0] * (lag + 1 + trembles)
    due, asked = 20.6, -1
    for cycle in range(CYCLES):
        command = next(commands)
        readback.sent.append(command)
        shown = [*shown[1:], command if cycle % hears == 0 else shown[-1]]
        if asked < 0 and cycle >= due:
            readback.ask()
            asked, due = cycle, due + 20.6
        if 0 <= asked <= cycle - wait:
            readback.answered(shown[trembles - late.randint(0, trembles)])
            asked = -1
    answers, outdated = readback.asked - before[0], readback.outdated - before[1]
    assert answers > 90
    return outdated / answers


@pytest.mark.parametrize(("lag", "trembles"), [(0, 0), (1, 0), (5, 0), (1, 1), (1, 2)])
@pytest.mark.parametrize("wait", [0, 3])
def test_a_drive_that_hears_all_is_never_accused_however_late_it_shows_them(lag: int, trembles: int, wait: int) -> None:
    """A drive whose SDO server runs in a separate task may report a command that is one or two cycles old."""
    assert play(CommandReadback(), itertools.count(), 1, lag, wait, trembles) == 0.0


@pytest.mark.parametrize(("hears", "share"), [(2, 0.0), (3, 0.0), (5, 0.4), (20, 0.85)])
def test_of_a_drive_that_hears_each_nth_command_the_others_count(hears: int, share: float) -> None:
    """An answer counts as a loss if its command is more than two cycles old.

    This holds from startup and after a time without loss.
    """
    assert play(CommandReadback(), itertools.count(), hears) == pytest.approx(share, abs=0.1)
    readback, commands = CommandReadback(), itertools.count()
    play(readback, commands, 1)
    assert play(readback, commands, hears) == pytest.approx(share, abs=0.1)


def test_what_a_drive_holds_before_it_heard_anything_is_no_measure_of_it() -> None:
    """Requests that are answered before the first command arrives do not count as lost commands."""
    readback, commands = CommandReadback(), itertools.chain([0], itertools.count())
    for _ in range(3):
        readback.sent.append(next(commands))
        readback.ask()
        readback.answered(0)
    assert play(readback, commands, 1, lag=3) == 0.0


def test_a_command_that_rests_or_trembles_shows_nothing() -> None:
    assert play(CommandReadback(), itertools.repeat(70), 20) == 0.0
    assert play(CommandReadback(), itertools.cycle((70, 71)), 20) == 0.0
