"""Compare the loop's recovery with a small model for random sequences of events.

The model has two states: whether a fault is latched, and whether the drive can be reset. Torque returns only after a
request that is made after the fault. An earlier request or a repaired drive alone does not restore it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from unittest import mock

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from tests.daemon.machine import BARE, CONSTANT, FAULT, Drive, Machine
from tsa_ctrl.ipc.mailbox import RECOVER, Command

START = 500  # cycles until there is torque
SOON = 40  # cycles within which a fault is latched or a request is taken
LONG = 700  # cycles within which a reset succeeds and torque returns
GIVEN_UP = 2700  # cycles until a failed reset is abandoned: `reset_timeout` and half a second
ACTION = st.sampled_from(["fail", "recover", "break", "mend"])


class Stubborn(Drive):
    """A drive that can be broken so that no reset succeeds."""

    broken = False

    def _obey(self, controlword: int, target: int) -> None:
        super()._obey(controlword, target)
        if self.broken and self.statusword != FAULT and controlword & 0x80:
            self.statusword, self.error_code, self.torque = FAULT, 0x2310, 0


def play(story: list[str]) -> tuple[list[int], list[int]]:
    """Return the torque command of each cycle, and the cycle in which each event of the story begins."""
    no_rest = mock.patch("tsa_ctrl.safety.release.REST", 0.0)  # the model does not limit the rate of requests
    with no_rest, tempfile.TemporaryDirectory(prefix="recovery-") as folder:
        machine = Machine(Path(folder), CONSTANT, BARE, drive=Stubborn())
        drive = machine.drive
        assert isinstance(drive, Stubborn)
        acts: dict[str, Callable[[], object]] = {
            "fail": drive.fail,
            "recover": lambda: machine.mailbox.put(Command(0, RECOVER, 0.0)),
            "break": lambda: setattr(drive, "broken", True),
            "mend": lambda: setattr(drive, "broken", False),
            "end": machine.mailbox.request_stop,
        }
        beat, begins, broken = START, [], False
        for act in [*story, "end"]:
            drive.at_sync[beat] = partial(_do, acts[act])
            begins.append(beat)
            broken = act == "break" or (broken and act != "mend")
            beat += SOON if act != "recover" else GIVEN_UP if broken else LONG
        machine.run()
        machine.close()
        return drive.torques, begins


def _do(act: Callable[[], object]) -> None:
    act()


def check(story: list[str]) -> None:
    """Play the story and compare the torque after each event with the model."""
    torques, begins = play(story)
    assert torques[START - 2] > 0
    latched = broken = False
    for act, begin, end in zip(story, begins, begins[1:], strict=False):
        was = latched
        if act == "fail":
            latched = True
        elif act == "recover":
            latched = latched and broken
        elif act in ("break", "mend"):
            broken = act == "break"
        if latched:
            assert not any(torques[begin - (1 if was else -2) : end - 1]), (story, act)
        elif not was:
            assert all(torques[begin - 1 : end - 1]), (story, act)
        else:
            assert torques[end - 2] > 0, (story, act)


@pytest.mark.slow
@settings(max_examples=12, deadline=None, database=None, derandomize=True, phases=(Phase.generate, Phase.shrink))
@given(st.lists(ACTION, min_size=2, max_size=7))
def test_torque_comes_back_by_a_request_after_the_fault_alone(story: list[str]) -> None:
    check(story)


@pytest.mark.parametrize(
    "story",
    [
        ["recover", "fail", "mend"],  # request before the fault
        ["break", "fail", "recover", "mend", "mend"],  # repaired, but without a new request
        ["break", "fail", "recover", "mend", "recover"],
        ["fail", "fail", "recover", "fail", "recover"],
    ],
)
def test_stories_that_must_be_among_them(story: list[str]) -> None:
    check(story)
