"""The mailbox between loop and socket server."""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Iterator

import pytest

from tsa_ctrl.ipc.mailbox import SLOTS, AxisStatus, Command, General, Mailbox


@pytest.fixture
def mailbox() -> Iterator[Mailbox]:
    box = Mailbox(axes=2, parameters=3)
    yield box
    box.close()


def test_commands_come_in_order_one_at_a_time(mailbox: Mailbox) -> None:
    """What was put first is taken first, and each once."""
    commands = [Command(n % 2, n, n * 0.5) for n in range(5)]
    tickets = [mailbox.put(command) for command in commands]
    assert tickets == [0, 1, 2, 3, 4]
    assert [mailbox.take() for _ in range(6)] == [*commands, None]


def test_queue_is_bounded(mailbox: Mailbox) -> None:
    """A full queue refuses; after one is taken there is room for one."""
    assert all(mailbox.put(Command(0, 0, 0.0)) is not None for _ in range(SLOTS))
    assert mailbox.put(Command(0, 0, 0.0)) is None
    mailbox.take()
    assert mailbox.put(Command(0, 1, 1.0)) == SLOTS
    assert mailbox.put(Command(0, 0, 0.0)) is None


def test_ticket_tells_when_a_command_is_taken(mailbox: Mailbox) -> None:
    """A command counts as taken once the loop has it."""
    ticket = mailbox.put(Command(1, 2, 3.0))
    assert ticket is not None
    assert not mailbox.taken(ticket)
    mailbox.take()
    assert mailbox.taken(ticket)


def test_stop_is_not_queued(mailbox: Mailbox) -> None:
    """A stop gets through however many commands wait."""
    while mailbox.put(Command(0, 0, 0.0)) is not None:
        pass
    mailbox.request_stop()
    assert mailbox.stop_requested


GENERAL = General(*(float(n) for n in range(len(General._fields))))
AXES = [
    (AxisStatus(*(float(100 * axis + n) for n in range(len(AxisStatus._fields)))), (1.0 + axis, 2.0, 3.0))
    for axis in range(2)
]


def other_end(mailbox: Mailbox) -> Mailbox:
    return Mailbox(2, 3, os.dup(mailbox.descriptor))


def test_other_end_reads_the_snapshot(mailbox: Mailbox) -> None:
    """What the loop publishes is what another mapping of the memory reads."""
    other = other_end(mailbox)
    mailbox.publish(GENERAL, AXES)
    mailbox.publish_text(b'["hello"]')
    assert other.status() == (GENERAL, AXES)
    assert other.text()[1] == b'["hello"]'
    mailbox.lateness[7] += 1
    assert other.lateness[7] == 1
    mailbox.publish_text(b"[]")
    assert other.text()[1] == b"[]"


def test_before_the_first_status_there_are_zeros(mailbox: Mailbox) -> None:
    general, axes = other_end(mailbox).status()
    assert general == General()
    assert axes == [(AxisStatus(), (0.0, 0.0, 0.0))] * 2


def test_a_torn_status_is_never_returned(mailbox: Mailbox) -> None:
    """But the last that was whole, however the memory looks: a loop may be stopped in the middle of writing."""
    other = other_end(mailbox)
    for _ in range(2):
        mailbox.publish(GENERAL, AXES)
    mailbox.publish_text(b"[]")
    assert (other.status(), other.text()[1]) == ((GENERAL, AXES), b"[]")
    for at in range(0, len(mailbox._memory.bytes), 8):
        mailbox._memory.bytes[at] ^= 0x80
    assert (other.status(), other.text()[1]) == ((GENERAL, AXES), b"[]")


def test_a_set_point_replaces_the_one_before_and_is_given_once(mailbox: Mailbox) -> None:
    """A later 0 never waits behind."""
    other = other_end(mailbox)
    for n in range(64):
        other.want(1, 0.5 + n, 10.0 + n)
    other.want(1, 0.0, 99.0)
    assert [mailbox.wanted(1), mailbox.wanted(1), mailbox.wanted(0)] == [(0.0, 99.0), None, None]


def test_a_withdrawal_is_of_all_axes(mailbox: Mailbox) -> None:
    other = other_end(mailbox)
    other.want(0, 0.5, 10.0)
    other.withdraw()
    assert [mailbox.wanted(0), mailbox.wanted(1)] == [(0.0, -math.inf)] * 2


def test_a_command_whose_place_is_not_whole_yet_waits(mailbox: Mailbox) -> None:
    other = other_end(mailbox)
    other.put(Command(1, 2, 3.0))
    at = mailbox._memory.bytes.find(struct.pack("=d", 3.0))
    mailbox._memory.bytes[at + 7] ^= 0xFF
    assert mailbox.take() is None
    mailbox._memory.bytes[at + 7] ^= 0xFF
    assert mailbox.take() == Command(1, 2, 3.0)


def test_a_server_that_follows_another_goes_on_with_its_tickets(mailbox: Mailbox) -> None:
    assert other_end(mailbox).put(Command(0, 0, 0.0)) == 0
    assert other_end(mailbox).put(Command(0, 1, 1.0)) == 1
    assert [mailbox.take() for _ in range(3)] == [Command(0, 0, 0.0), Command(0, 1, 1.0), None]
