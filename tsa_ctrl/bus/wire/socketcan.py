"""Access raw SocketCAN (Linux, AF_CAN) with one precompiled struct, without threads and without a user-space queue."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import socket
import struct
import time
from collections.abc import Iterable
from select import select

from tsa_ctrl.bus.wire.bus import FLUSH_LIMIT, BusFault, Counters, Frame
from tsa_ctrl.errors import BusError
from tsa_ctrl.system.sleep import Alarm, sleep_until

FRAME = struct.Struct("=IB3x8s")  # struct can_frame: can_id, len, padding, data
_MOST = 64  # maximum number of frames taken by one call


class _Vector(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))  # struct iovec


class _Header(ctypes.Structure):  # struct msghdr
    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_length", ctypes.c_uint32),
        ("vectors", ctypes.POINTER(_Vector)),
        ("vector_count", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_length", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )


class _Message(ctypes.Structure):  # struct mmsghdr
    _fields_ = (("header", _Header), ("received", ctypes.c_uint))


_recvmmsg = ctypes.CDLL(None, use_errno=True).recvmmsg
_recvmmsg.argtypes = (ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p)


class Batch:
    """Receive many frames of one raw CAN socket with one kernel call (recvmmsg(2)), without waiting.

    Python's socket module does not provide this call.
    """

    def __init__(self, raw: socket.socket) -> None:
        self._fd = raw.fileno()
        self._frames = bytearray(_MOST * FRAME.size)
        self._view = memoryview(self._frames)
        first = ctypes.addressof(ctypes.c_char.from_buffer(self._frames))
        self._vectors = (_Vector * _MOST)(*(_Vector(first + n * FRAME.size, FRAME.size) for n in range(_MOST)))
        self._messages = (_Message * _MOST)()
        for message, vector in zip(self._messages, self._vectors, strict=True):
            message.header.vectors, message.header.vector_count = ctypes.pointer(vector), 1
        self._address = ctypes.addressof(self._messages)

    def take(self, most: int) -> tuple[list[tuple[int, bytes]], int]:
        """Return at most `most` frames and the kernel's error number; it is 0 without an error and for EAGAIN."""
        frames: list[tuple[int, bytes]] = []
        while most > 0:
            wanted = most if most < _MOST else _MOST
            count = _recvmmsg(self._fd, self._address, wanted, socket.MSG_DONTWAIT, None)
            if count < 0:
                number = ctypes.get_errno()
                return frames, 0 if number == errno.EAGAIN else number
            for can_id, length, data in FRAME.iter_unpack(self._view[: count * FRAME.size]):
                frames.append((can_id, data[:length]))
            if count < wanted:
                break
            most -= count
        return frames, 0


_pack, _unpack = FRAME.pack, FRAME.unpack
FILTER = struct.Struct("=II")  # struct can_filter: can_id, can_mask
_ID_MASK = 0xC00007FF  # only standard data frames with exactly this identifier
_CAN_RAW_ERR_FILTER = 2  # of linux/can/raw.h
_ALL_ERRORS = 0x1FFFFFFF  # CAN_ERR_MASK
_MAX_FILTERS = 512  # CAN_RAW_FILTER_MAX
_SIOCGIFFLAGS = 0x8913
_IFF_UP = 0x1
_TRUESIZE = 1024  # bytes charged to the socket for one queued CAN frame, rounded up
_TICK = 0.01  # s; if the time-out is this much later than the next event, the kernel sets no timer

_NOTHING: list[int] = []
_DROPPED = frozenset({errno.ENOBUFS, errno.EAGAIN, errno.EWOULDBLOCK})
_FAULTS = {
    errno.ENETDOWN: BusFault.INTERFACE_DOWN,
    errno.ENODEV: BusFault.INTERFACE_GONE,
    errno.ENXIO: BusFault.INTERFACE_GONE,
}


class SocketCan:
    """Implement `Bus` on a SocketCAN interface.

    At most `send_queue` frames wait in the kernel. Further frames are dropped and counted, so that no stale torque is
    sent after a bus has recovered.

    Raises:
        BusError: the interface is missing or down.
    """

    def __init__(self, channel: str, send_queue: int = 32) -> None:
        self.name = channel
        self.counters = Counters()
        self.fault: BusFault | None = None
        try:
            self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        except OSError as error:
            raise BusError(
                f"[bus] channel '{channel}': this kernel has no SocketCAN ({error.strerror}); "
                "load the kernel module can_raw, or choose another [bus] interface"
            ) from None
        try:
            self._open(channel, send_queue)
        except BaseException:
            self._socket.close()
            raise
        self._fd = self._socket.fileno()
        self._buffer = bytearray(FRAME.size)
        self._send = self._socket.send
        self._recv_into = self._socket.recv_into
        self._readers = [self._fd]
        self._batch = Batch(self._socket)
        self._bell: socket.socket | None = None  # receives only the last answer of a cycle
        self._heard: Batch | None = None
        self._bells = self._readers
        self._alarm: Alarm | None = None  # becomes readable when a cycle need not wait longer
        self._alarmed = False

    def _open(self, channel: str, send_queue: int) -> None:
        raw = self._socket
        raw.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, _ALL_ERRORS)
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, send_queue * _TRUESIZE // 2)  # the kernel doubles it
        try:
            raw.bind((channel,))
        except OSError:
            names = sorted(name for _, name in socket.if_nameindex() if "can" in name)
            found = f"CAN interfaces here: {', '.join(names)}" if names else "this machine has no CAN interface"
            raise BusError(
                f"[bus] channel '{channel}': no such CAN interface; {found}; plug the adapter in or correct the name"
            ) from None
        request = struct.pack("16sH14x", channel.encode(), 0)
        flags = struct.unpack_from("H", fcntl.ioctl(raw, _SIOCGIFFLAGS, request), 16)[0]
        if not flags & _IFF_UP:
            raise BusError(
                f"[bus] channel '{channel}': the interface is down; set it up: ip link set {channel} up "
                "(with the bit rate of a real adapter: up type can bitrate 1000000)"
            )
        raw.setblocking(False)

    def clock(self) -> float:
        return time.monotonic()

    def send(self, can_id: int, data: bytes) -> bool:
        try:
            self._send(_pack(can_id, len(data), data))
        except OSError as error:
            self.counters.dropped += 1
            self._note(error.errno)
            return False
        self.counters.sent += 1
        return True

    def recv(self, timeout: float) -> Frame | None:
        try:
            # select() has a resolution of microseconds, poll() only of milliseconds
            if timeout > 0.0 and not select(self._readers, _NOTHING, _NOTHING, timeout)[0]:
                return None
            self._recv_into(self._buffer)
        except OSError as error:
            self._note(error.errno)
            return None
        can_id, length, data = _unpack(self._buffer)
        return can_id, data[:length]

    def gather(self, until: float, most: int) -> list[Frame]:
        if self._heard is not None:
            self._heard.take(most)  # discarded, errors too, because the other socket has received them as well
        sleep_until(round(until * 1e9))
        return self._take(most)

    def listen_for(self, can_id: int) -> None:
        if self._bell is None:
            self._bell = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
            self._bell.setblocking(False)
        self._bell.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, FILTER.pack(can_id, _ID_MASK))
        if self._heard is None:
            self._bell.bind((self.name,))
            self._heard = Batch(self._bell)
            self._bells = [self._bell.fileno()]
            with contextlib.suppress(OSError):
                self._alarm = Alarm()
                self._bells_and_alarm = [*self._bells, self._alarm.fd]

    def expect(self, until: float) -> None:
        if self._alarm is not None:
            self._alarm.set(max(1, round(until * 1e9)))
            self._alarmed = True

    def answers(self, timeout: float, most: int) -> list[Frame]:
        if self._alarmed:
            self._alarmed = False
            select(self._bells_and_alarm, _NOTHING, _NOTHING, max(0.0, timeout) + _TICK)
        else:
            select(self._bells, _NOTHING, _NOTHING, max(0.0, timeout))
        return self._take(most)

    def _take(self, most: int) -> list[Frame]:
        frames, error = self._batch.take(most)
        if error:
            self._note(error)
        return frames

    def _note(self, number: int | None) -> None:
        """Latch a fault of the bus; a full queue (send) or an empty queue (recv) is not a fault."""
        if number not in _DROPPED and self.fault is None:
            self.fault = _FAULTS.get(number or 0, BusFault.ADAPTER)

    def accept(self, can_ids: Iterable[int] | None) -> None:
        wanted = None if can_ids is None else sorted(set(can_ids))
        if wanted is None or len(wanted) > _MAX_FILTERS:
            filters = FILTER.pack(0, 0)
        else:
            filters = b"".join(FILTER.pack(can_id, _ID_MASK) for can_id in wanted)
        self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, filters)

    def flush(self) -> int:
        return len(self.gather(0.0, FLUSH_LIMIT))

    def clear_fault(self) -> None:
        self.fault = None

    def fileno(self) -> int:
        return self._fd

    def close(self) -> None:
        self._socket.close()
        if self._bell is not None:
            self._bell.close()
        if self._alarm is not None:
            self._alarm.close()
            self._alarm = None
