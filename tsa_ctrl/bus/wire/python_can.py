"""Use any python-can bus (virtual, udp_multicast, slcan, ...) as a `Bus`, for adapters without SocketCAN support."""

from __future__ import annotations

import os
import socket
import time
from collections import deque
from collections.abc import Iterable, Mapping
from contextlib import suppress

import can

from tsa_ctrl.bus.wire.bus import ERROR_FLAG, EXTENDED_FLAG, FLUSH_LIMIT, REMOTE_FLAG, BusFault, BusInProcess, Frame
from tsa_ctrl.errors import BusError

Option = str | int | float | bool

_IP_MULTICAST_ALL, _IPV6_MULTICAST_ALL = 49, 29  # linux/in.h, linux/in6.h
_ECHOING = frozenset({"udp_multicast"})  # interfaces that cannot suppress their own frames
# Options for a loop at a fixed rate, unless [bus] options contain them. A read of slcan without frames blocks for its
# `timeout`. Its default of 1 ms is a whole period. Without `tcp_tune` the kernel delays small frames of socketcand
# until the last one is acknowledged. The frames of udp_multicast never leave this machine.
_DEFAULTS: dict[str, dict[str, Option]] = {
    "slcan": {"timeout": 1e-4},
    "socketcand": {"tcp_tune": True},
    "udp_multicast": {"fd": False, "hop_limit": 0},
}
_MAX_ECHOES = 64  # sent frames whose echo may still arrive


class PythonCan(BusInProcess):
    """A `Bus` over `can.Bus(interface=..., channel=..., **options)`; raises BusError if it cannot be opened."""

    def __init__(self, interface: str, channel: str, bitrate: int, options: Mapping[str, Option] | None = None) -> None:
        super().__init__(f"{interface}:{channel}")
        self._echoes: deque[Frame] | None = deque(maxlen=_MAX_ECHOES) if interface in _ECHOING else None
        self._bus = opened(interface, channel, bitrate, options)

    def send(self, can_id: int, data: bytes) -> bool:
        message = can.Message(arbitration_id=can_id, is_extended_id=False, data=data, check=False)
        if self._echoes is not None:
            self._echoes.append((can_id, data))
        try:
            self._bus.send(message, timeout=0.0)
        except can.CanOperationError:
            self.counters.dropped += 1
            return False
        except (can.CanError, OSError):
            self.counters.dropped += 1
            self.fault = self.fault or BusFault.ADAPTER
            return False
        self.counters.sent += 1
        return True

    def recv(self, timeout: float) -> Frame | None:
        frame = self._receive(timeout)
        if self._echoes is None:
            return frame
        deadline = time.monotonic() + timeout
        while frame is not None and frame in self._echoes:
            self._echoes.remove(frame)
            frame = self._receive(deadline - time.monotonic())
        return frame

    def gather(self, until: float, most: int) -> list[Frame]:
        time.sleep(max(0.0, until - time.monotonic()))
        frames: list[Frame] = []
        while len(frames) < most and (frame := self.recv(0.0)) is not None:
            frames.append(frame)
        return frames

    def listen_for(self, can_id: int) -> None:
        """Do nothing: python-can cannot wait for one identifier, so `answers` waits for any frame."""

    def answers(self, timeout: float, most: int) -> list[Frame]:
        frame = self.recv(timeout)
        return [] if frame is None else [frame]

    def _receive(self, timeout: float) -> Frame | None:
        try:
            message = self._bus.recv(max(0.0, timeout))
        except (can.CanError, OSError):
            self.fault = self.fault or BusFault.ADAPTER
            return None
        if message is None:
            return None
        can_id = message.arbitration_id
        if message.is_error_frame:
            can_id |= ERROR_FLAG
        elif message.is_remote_frame:
            can_id |= REMOTE_FLAG
        elif message.is_extended_id:
            can_id |= EXTENDED_FLAG
        return can_id, bytes(message.data)

    def accept(self, can_ids: Iterable[int] | None) -> None:
        if can_ids is None:
            self._bus.set_filters(None)
        else:
            self._bus.set_filters(
                [{"can_id": can_id, "can_mask": 0x7FF, "extended": False} for can_id in sorted(set(can_ids))]
            )

    def fileno(self) -> int:
        try:
            return int(self._bus.fileno())
        except NotImplementedError:
            return -1

    def close(self) -> None:
        with suppress(can.CanError, OSError):  # an unplugged adapter cannot be told to close its channel
            self._bus.shutdown()


def opened(interface: str, channel: str, bitrate: int, options: Mapping[str, Option] | None = None) -> can.BusABC:
    """Return an open bus with options for a fixed rate; raise BusError with a one-line message if that fails."""
    arguments: dict[str, Option] = {} if interface == "udp_multicast" else {"bitrate": bitrate}
    arguments |= {**_DEFAULTS.get(interface, {}), **(options or {})}
    try:
        bus: can.BusABC = can.Bus(interface=interface, channel=channel, **arguments)
    except Exception as error:  # each driver raises its own errors, such as NameError without the maker's library
        reason = " ".join(str(error).split()) or type(error).__name__
        raise BusError(
            f"[bus] interface '{interface}' channel '{channel}': cannot be opened ({reason}); "
            "check interface, channel and options in python-can's documentation of this interface"
        ) from None
    if interface == "udp_multicast":
        _hear_own_group_only(bus.fileno())
    return bus


def _hear_own_group_only(descriptor: int) -> None:
    """Receive only the socket's own group. By default, Linux delivers all groups that any process has joined.

    Frames that arrived before this option was set may be of any group and are discarded.
    """
    with socket.socket(fileno=os.dup(descriptor)) as same:
        if same.family == socket.AF_INET6:
            same.setsockopt(socket.IPPROTO_IPV6, _IPV6_MULTICAST_ALL, 0)
        else:
            same.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
        with suppress(BlockingIOError):
            for _ in range(FLUSH_LIMIT):
                same.recv(1, socket.MSG_DONTWAIT)
