"""The mailbox between loop and socket server."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tsa_ctrl.ipc.mailbox import AXIS, GENERAL, SLOTS, Command, Mailbox


@pytest.fixture
def mailbox() -> Iterator[Mailbox]:
    box = Mailbox.create(axes=2, parameters=3)
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


def test_other_end_reads_the_snapshot(mailbox: Mailbox) -> None:
    """What the loop publishes is what another mapping of the memory reads."""
    other = Mailbox(mailbox.descriptor, 2, 3)
    general = tuple(float(n) for n in range(len(GENERAL)))
    axes = [tuple(float(100 * axis + n) for n in range(len(AXIS) + 3)) for axis in range(2)]
    mailbox.publish(general, axes)
    mailbox.publish_text(b'["hello"]')
    assert other.status() == (general, axes)
    assert other.text()[1] == b'["hello"]'
    mailbox.lateness[7] += 1
    assert other.lateness[7] == 1
    mailbox.publish_text(b"[]")
    assert other.text()[1] == b"[]"
