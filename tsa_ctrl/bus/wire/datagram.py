"""Carry frames between processes over local sockets: a substitute for a CAN interface that needs no privileges.

It is meant for demos and benches; a test of the kernel's CAN requires a vcan. Each participant sends to every other one
over a connection that preserves frame boundaries (SOCK_SEQPACKET). A SOCK_DGRAM socket would hold only
net.unix.max_dgram_qlen frames, often 10. The names are abstract, so that no files remain.

Limits: the bus has no arbitration, bit rate, error frame, bus-off, acknowledgement or kernel filter. The frames of each
sender keep their order, and frames of several senders mix. A frame without a receiver counts as sent. A participant
that does not read loses frames. All participants are processes of one user in one network namespace.
"""

from __future__ import annotations

import os
import re
import select
import socket
import time
from collections import deque
from collections.abc import Iterable
from contextlib import suppress

from tsa_ctrl.bus.wire.bus import BusInProcess, Frame
from tsa_ctrl.bus.wire.socketcan import FRAME
from tsa_ctrl.errors import BusError
from tsa_ctrl.system.sleep import sleep_until

_KIND = (socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
MOST_PARTICIPANTS = 16  # each costs a sender one system call per frame
_NAME = re.compile(r"[A-Za-z0-9._-]{1,64}")  # a socket name has 107 bytes, including the user and a number


class DatagramBus(BusInProcess):
    """Implement `Bus` over local sockets; `send_queue` frames may wait per receiver. Raises BusError."""

    def __init__(self, channel: str, send_queue: int = 32) -> None:
        where = f"[bus] channel '{channel}'"
        if not _NAME.fullmatch(channel):
            raise BusError(f"{where}: invalid name of a datagram bus; use 1 to 64 letters, digits, '.', '_' or '-'")
        super().__init__(f"datagram:{channel}")
        self._received: deque[Frame] = deque()
        self._accepted: frozenset[int] | None = None
        self._last = -1  # identifier that `answers` waits for
        self._send_buffer = send_queue * 512  # bytes; the kernel doubles it and charges 1 kB for a waiting frame
        self._poll = select.epoll()
        self.fileno = self._poll.fileno
        self._senders: dict[int, socket.socket] = {}  # by descriptor: sockets that receive frames
        self._receivers: dict[str, socket.socket | None] = {
            f"\0tsa-can/{os.geteuid()}/{channel}/{number}": None for number in range(MOST_PARTICIPANTS)
        }  # by name: sockets that send frames
        self._listener = socket.socket(*_KIND)
        for own in self._receivers:
            with suppress(OSError):  # another participant has this name
                self._listener.bind(own)
                break
        else:
            self.close()
            raise BusError(
                f"{where}: this bus already has {MOST_PARTICIPANTS} participants; stop one, or use another name"
            )
        del self._receivers[own]
        self._listener.listen(MOST_PARTICIPANTS)
        self._poll.register(self._listener, select.EPOLLIN)
        self._connect()

    def _connect(self) -> None:
        """Connect to each participant that is not connected yet."""
        for name, receiver in self._receivers.items():
            with suppress(BlockingIOError):
                if receiver is not None:
                    with suppress(ConnectionError):
                        receiver.recv(1)  # raises BlockingIOError unless the participant has ended
                    receiver.close()
                new = socket.socket(*_KIND)
                new.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, self._send_buffer)
                joined = new.connect_ex(name) == 0
                self._receivers[name] = new if joined else None
                if not joined:
                    new.close()

    def _admit(self) -> None:
        """Accept connections from new participants, and connect to them."""
        with suppress(BlockingIOError):
            while True:
                sender, _ = self._listener.accept()
                sender.setblocking(False)
                self._senders[sender.fileno()] = sender
                self._poll.register(sender, select.EPOLLIN)
                self._connect()

    def send(self, can_id: int, data: bytes) -> bool:
        self._admit()
        frame, full, sent, ended = FRAME.pack(can_id, len(data), data), False, False, False
        for receiver in filter(None, self._receivers.values()):
            try:
                sent = receiver.send(frame) > 0
            except BlockingIOError:
                full = True
            except OSError:
                ended = True
        if ended:
            self._connect()
        dropped = full and not sent
        self.counters.dropped += dropped
        self.counters.sent += not dropped
        return not dropped

    def _take(self, timeout: float) -> None:
        """Wait at most `timeout` s for frames, and read those that have arrived."""
        for descriptor, _ in self._poll.poll(timeout):
            sender = self._senders.get(descriptor)
            if sender is None:
                self._admit()
                self._take(0.0)
                continue
            with suppress(BlockingIOError):
                while frame := sender.recv(FRAME.size):
                    can_id, length, data = FRAME.unpack(frame)
                    if self._accepted is None or can_id in self._accepted:
                        self._received.append((can_id, data[:length]))
                self._senders.pop(descriptor).close()  # the participant has ended

    def _wait(self, timeout: float, wanted: int | None) -> None:
        """Wait at most `timeout` s for a frame with this identifier, or for any frame if it is None."""
        end = time.monotonic() + timeout
        while timeout >= 0.0 and not any(wanted in (None, can_id) for can_id, _ in self._received):
            self._take(timeout)
            timeout = end - time.monotonic()

    def recv(self, timeout: float) -> Frame | None:
        self._wait(timeout, None)
        return self._received.popleft() if self._received else None

    def gather(self, until: float, most: int) -> list[Frame]:
        sleep_until(round(until * 1e9))
        self._take(0.0)
        return [self._received.popleft() for _ in range(min(most, len(self._received)))]

    def listen_for(self, can_id: int) -> None:
        self._last = can_id

    def answers(self, timeout: float, most: int) -> list[Frame]:
        self._wait(timeout, self._last)
        return self.gather(0.0, most)

    def accept(self, can_ids: Iterable[int] | None) -> None:
        self._accepted = None if can_ids is None else frozenset(can_ids)

    def close(self) -> None:
        self._poll.close()
        for each in (self._listener, *self._senders.values(), *filter(None, self._receivers.values())):
            each.close()
