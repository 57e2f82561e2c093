"""Test the mailbox between loop and socket server."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator

import pytest

from tsa_ctrl.ipc.mailbox import (
    SLOTS,
    STAGE,
    TEXT,
    AxisStatus,
    Command,
    General,
    Mailbox,
    Parameters,
    Reading,
)


@pytest.fixture
def mailbox() -> Iterator[Mailbox]:
    box = Mailbox(axes=2, parameters=3)
    yield box
    box.close()


def test_queue_is_bounded_except_for_a_stop(mailbox: Mailbox) -> None:
    """A full queue rejects commands but accepts a stop. After the loop takes one, there is space for one more.

    A ticket counts as taken once the loop has taken its command.
    """
    assert [mailbox.put(Command(0, 0, 0.0)) for _ in range(SLOTS)] == list(range(SLOTS))
    assert mailbox.put(Command(0, 0, 0.0)) is None
    mailbox.request_stop()
    assert mailbox.stop_requested
    assert not mailbox.taken(0)
    mailbox.take()
    assert mailbox.taken(0)
    assert mailbox.put(Command(0, 1, 1.0)) == SLOTS
    assert mailbox.put(Command(0, 0, 0.0)) is None


GENERAL = General(*(float(n) for n in range(len(General._fields))))
AXES = [
    (AxisStatus(*(float(100 * axis + n) for n in range(len(AxisStatus._fields)))), (1.0 + axis, 2.0, 3.0))
    for axis in range(2)
]


def other_end(mailbox: Mailbox) -> Mailbox:
    return Mailbox(2, 3, os.dup(mailbox.descriptor))


def test_other_end_reads_the_newest_snapshot(mailbox: Mailbox) -> None:
    """Before the first status, a second mapping of the shared memory reads zeros."""
    other = other_end(mailbox)
    assert other.status() == (General(), [(AxisStatus(), (0.0, 0.0, 0.0))] * 2)
    mailbox.publish(GENERAL, AXES)
    for text in (b'["hello"]', b"[]"):
        mailbox.publish_text(text)
        assert other.text()[1] == text
    assert other.status() == (GENERAL, AXES)


def test_a_server_that_follows_another_goes_on_with_its_tickets(mailbox: Mailbox) -> None:
    assert other_end(mailbox).put(Command(0, 0, 0.0)) == 0
    assert other_end(mailbox).put(Command(0, 1, 1.0)) == 1
    assert [mailbox.take() for _ in range(3)] == [Command(0, 0, 0.0), Command(0, 1, 1.0), None]


READINGS = [Reading(*(1000.0 * axis + n for n in range(len(Reading._fields)))) for axis in range(2)]


@pytest.mark.parametrize("one", [1, 2])
@pytest.mark.parametrize("next_one", [1, 2])
def test_nothing_lies_where_something_else_does(mailbox: Mailbox, one: int, next_one: int) -> None:
    """All fields are written to the last byte and then read at the other end, so an overlap would change a value.

    Fields with two buffers are written once or twice, so that each buffer is tested next to its neighbours.
    """
    other = other_end(mailbox)
    values: Parameters = (9.0, 8.0, 7.0)
    status = [(axis, values) for axis, _ in AXES]
    waits, told = "w" * 1000, "t" * (STAGE - 8)  # the text of a stage is cut
    begun = time.monotonic()
    commands = [Command(n % 2, n, -0.5 * n) for n in range(SLOTS)]
    for n in range(one):
        mailbox.publish_text(b"e" * TEXT)
        mailbox.publish(GENERAL, status)
        other.want(1, 2.5, 3.5)
        other.tell(float(n), told)
    for n in range(next_one):
        mailbox.publish_stage(float(n), waits)
        other.want(0, 1.5, 2.5)
        mailbox.measure(float(n), 12, 13, READINGS)
    for n in range(len(mailbox.lateness)):
        mailbox.lateness[n], mailbox.work[n] = 1 + n, 1_000_000 + n
    other.replace(3)
    other.alive()
    for command in commands:
        other.put(command)
    assert not mailbox.stop_requested
    assert begun <= mailbox.heard <= time.monotonic()
    other.request_stop()
    assert mailbox.stop_requested
    assert begun <= mailbox.heard <= time.monotonic()
    assert mailbox.replaced == 3
    assert list(other.lateness) == [1 + n for n in range(len(other.lateness))]
    assert list(other.work) == [1_000_000 + n for n in range(len(other.work))]
    assert other.status() == (GENERAL, status)
    assert other.text() == (one, b"e" * TEXT)
    assert other.stage() == (next_one - 1.0, waits[: STAGE - 8])
    assert other.measured() == (next_one - 1.0, 12, 13, READINGS)
    assert mailbox.told() == (one - 1.0, told)
    assert [mailbox.wanted(axis) for axis in range(2)] == [(1.5, 2.5), (2.5, 3.5)]
    other.withdraw()
    assert [mailbox.wanted(axis) for axis in range(2)] == [(0.0, -math.inf)] * 2
    assert [mailbox.take() for _ in commands] == commands
    assert other.taken(SLOTS - 1)
    assert not other.taken(SLOTS)


def test_a_closed_box_gives_its_memory_back() -> None:
    box = Mailbox(1, 0)
    descriptor = box.descriptor
    box.close()
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(descriptor)
